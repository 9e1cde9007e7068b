"""The truth of another dataset is refused; a poor detector is not."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from synthcam_shared.errors import InputError
from tracker.scoring.score import check_same_dataset


@pytest.mark.parametrize(
    ("paired", "false", "refused"), [(0, 174, True), (2, 400, True), (9, 300, False), (0, 0, False)]
)
def test_hardly_any_position_near_a_true_one(paired, false, refused):
    verdict = SimpleNamespace(localisation={"n": paired, "false": false})
    if not refused:
        check_same_dataset(verdict, Path("results"), Path("truth"))
        return
    with pytest.raises(InputError, match=rf"{paired} of {paired + false} positions .* the dataset that was tracked"):
        check_same_dataset(verdict, Path("results"), Path("truth"))
