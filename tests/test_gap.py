"""The gap is shown on collisions that no fit has seen."""

import numpy as np
import pytest

from discrepancy.measured import split
from discrepancy_clips import searched

EFFECTS = ("velocity_restitution", "rolling_quadratic")


def test_clips_kept_out_are_in_no_fit():
    found = searched("velocity_restitution")
    fitted, kept = ({c.clip for c in clips} for clips in (found.clips, found.kept_out))
    assert not fitted & kept
    assert (len(fitted), len(kept)) == (6, 2)
    for fit, clips in ((found.search.best, found.clips), (found.shown.after, found.kept_out)):
        assert [len(r) for r in fit.residuals] == [2 * len(c.frame) for c in clips]
    for shown, model in ((found.shown.before, found.search.base.model), (found.shown.after, found.model)):
        assert shown.names == ()
        assert shown.model == model


def test_kept_out_clips_cover_the_speeds():
    found = searched("nothing")
    _, kept = split(sorted(found.clips + found.kept_out, key=lambda c: c.clip))
    speeds = sorted(c.launch[3] for c in found.clips + found.kept_out)
    assert [speeds.index(c.launch[3]) for c in sorted(kept, key=lambda c: c.launch[3])] == [2, 6]


@pytest.mark.parametrize("hidden", EFFECTS)
def test_the_gap_closes(hidden):
    shown = searched(hidden).shown
    gap, points = shown.gap, shown.after.points
    scatter = np.sqrt(2 / points) + np.sqrt(2 / 2000)  # of chi^2 a point, and of the noise that was read off
    assert gap.before > gap.floor + 20 * scatter
    assert abs(gap.after - gap.floor) < 4 * scatter
    assert gap.closure == pytest.approx((gap.before - gap.after) / (gap.before - gap.floor))
    assert abs(gap.closure - 1) < 4 * scatter / (gap.before - gap.floor)
    assert gap.before_um > gap.after_um == pytest.approx(gap.floor_um, rel=0.05)


@pytest.mark.parametrize("rho", [0.0, 0.5])
def test_with_nothing_hidden_there_is_no_gap(rho):
    gap = searched("nothing", rho).shown.gap
    assert gap.before == gap.after
    assert gap.after == pytest.approx(gap.floor, rel=0.12)
    assert gap.floor_um == pytest.approx(1.6, rel=0.1)


def test_the_floor_is_what_six_numbers_a_clip_leave_of_noise():
    found = searched("nothing")
    assert found.shown.gap.floor == pytest.approx(1 - 6 / np.mean([2 * len(c.frame) for c in found.kept_out]))
