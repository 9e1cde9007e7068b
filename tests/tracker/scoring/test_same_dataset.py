"""The truth of another dataset is refused; a poor detector is not."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

import synthcam
from synthcam_shared.errors import InputError
from tracker.scoring.score import check_same_dataset


@pytest.mark.parametrize(
    ("paired", "false", "rmse", "refused"),
    [(0, 174, float("nan"), True), (2, 400, 0.3, True), (9, 300, 0.3, False), (0, 0, float("nan"), False),
     (24, 149, 1.8, True), (149, 24, 1.8, False), (24, 149, 0.9, False)],
)  # fmt: skip
def test_hardly_any_position_near_a_true_one(paired, false, rmse, refused):
    verdict = SimpleNamespace(localisation={"n": paired, "false": false, "rmse_px": rmse})
    if not refused:
        check_same_dataset(verdict, Path("results"), Path("truth"))
        return
    with pytest.raises(InputError, match=rf"{paired} of {paired + false} positions .* the dataset that was tracked"):
        check_same_dataset(verdict, Path("results"), Path("truth"))


def pair_within_gate(found, true, gate=5.0):
    """Counts and rms of the positions of two films that lie within the gate, one to one in each frame."""
    squares, false = [], 0
    for frame, balls in found.groupby("frame"):
        here, there = (t[["glint_x_px", "glint_y_px"]].to_numpy() for t in (balls, true[true.frame == frame]))
        away = np.hypot(*np.moveaxis(here[:, None] - there, -1, 0))
        rows, columns = linear_sum_assignment(np.minimum(away, gate))
        near = away[rows, columns] < gate
        squares += list(away[rows, columns][near] ** 2)
        false += len(here) - near.sum()
    return {"n": len(squares), "false": int(false), "rmse_px": float(np.sqrt(np.mean(squares) / 2))}


def test_the_truth_of_another_seed_is_refused():
    """Both films show two balls that meet in the middle of the picture, so that some positions agree by chance."""
    sections = {"camera": {"size": [320, 240]}, "timing": {"frames": 60, "contact_frame": 25}}
    scene = synthcam.Scene.read("painter_behringer", **sections)
    one, other = (scene.draw(seed=seed) for seed in (1, 5))
    verdict = SimpleNamespace(localisation=pair_within_gate(one.tracks, other.tracks))
    assert verdict.localisation["n"] > 0.02 * verdict.localisation["false"]
    with pytest.raises(InputError, match="expected the dataset that was tracked"):
        check_same_dataset(verdict, Path("results"), Path("truth"))
