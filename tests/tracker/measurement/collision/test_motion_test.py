"""The free fit of a misfit: errors where only the laws of the hit are broken, none where those of the motion are."""

import numpy as np
import pytest

from benchmarks.tracker.misfits import QUANTITIES, measure_clip


@pytest.mark.parametrize(("number", "holds"), [(30, True), (60, False)])
def test_a_free_fit_has_errors_only_if_its_own_laws_of_motion_hold(number, holds):
    """Clip 30: the friction of the two balls differs. Clip 60: friction grows with the slip speed, by chi^2/dof 1.3."""
    (row,) = measure_clip(number, 30, 1)
    z = np.array([row[name] for name in QUANTITIES])
    assert row["status"] == "misfit"
    assert row["chi2_free"] < 1.4
    if holds:
        assert np.abs(z).max() < 4
    else:
        assert np.isnan(z).all()
