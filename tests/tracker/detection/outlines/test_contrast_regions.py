"""Regions of several discs, and what is none."""

import numpy as np
import pytest

from tracker.detection.outlines.contrast_regions import find_touching_discs, split_region

ROWS, COLUMNS = np.mgrid[:90, :120].astype(float)


def discs(*places, radius=10.0):
    return np.any([np.hypot(COLUMNS - x, ROWS - y) < radius for x, y in places], axis=0)


BAR = (np.abs(ROWS - 40) < 10) & (np.abs(COLUMNS - 60) < 50)
HAND = discs((40, 40), radius=20) | (
    (np.abs(ROWS - 40) % 12 < 3) & (np.abs(COLUMNS - 70) < 25) & (np.abs(ROWS - 40) < 20)
)


@pytest.mark.parametrize(("own", "places"), [
    (discs((30, 30), (50, 30)), [(30, 30), (50, 30)]),
    (discs((30, 30), (47, 30)), [(30, 30), (47, 30)]),  # one hides a part of the other
    (discs((30, 30), (50, 30), (40, 47.3)), [(30, 30), (50, 30), (40, 47)]),
    (discs((30, 30), (49, 36), (65, 24), (84, 30)), [(30, 30), (49, 36), (65, 24), (84, 30)]),
    (discs((30, 30)), []), (BAR, []), (HAND, []),
    (discs((30, 40), radius=18) | discs((60, 40), radius=11), []),  # of two sizes
    (discs((30, 30), (42, 30)), []),  # more than half hidden
    (discs((30, 30), (50, 30)) | ((np.abs(ROWS - 30) < 8) & (np.abs(COLUMNS - 40) < 10)), []),  # a waist too wide
    (discs((30, 30), (50, 30)) | ((np.abs(ROWS - 30) < 4) & (np.abs(COLUMNS - 70) < 40)), []),  # an arm
])  # fmt: skip
def test_discs_that_touch_are_told_from_other_shapes(own, places):
    radius, found = find_touching_discs(own)
    assert len(found) == len(places)
    assert all(min(np.hypot(x - a, y - b) for a, b in found) < 1.5 for x, y in places)
    assert not places or abs(radius - 10) < 1


def test_a_part_is_measured_in_its_own_box():
    """A region as wide as the picture may have a thousand parts, which took most of the time as masks of that size."""
    ball = discs((70, 50))
    own = ball | (ROWS == 0)  # a faint line, too
    apart = np.where(ball, 60.0, 2.0)
    (part,) = split_region(apart, own, (1000, 500), 0, 1.0, 5.0)
    assert part.middle == pytest.approx([1070, 550], abs=0.01)
    assert part.area == ball.sum()
    assert part.contrast == 60.0
    assert part.mask.shape == (21, 21)
    picture = np.zeros((700, 1200), np.uint8)
    part.fill(picture)
    assert np.array_equal(picture[500:590, 1000:1120], ball)
