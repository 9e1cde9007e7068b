"""Touching discs whose waist is filled, fitted as a group, and shapes that are none."""

import numpy as np
import pytest

from tracker.detection.outlines.disc_group import fit_disc_group

ROWS, COLUMNS = np.mgrid[:90, :120].astype(float)
TWO, RING = [(30, 30), (50, 30)], [(30, 30), (50, 30), (40, 47.3)]
CHAIN = [(30, 30), (49, 36), (65, 24), (84, 30)]


def discs(*places, radius=10.0):
    return np.any([np.hypot(COLUMNS - x, ROWS - y) < radius for x, y in places], axis=0)


def box(x, y, half_width, half_height):
    return (np.abs(COLUMNS - x) < half_width) & (np.abs(ROWS - y) < half_height)


def streak(x, length):
    """A disc that moved by `length` px during the exposure."""
    return np.hypot(COLUMNS - np.clip(COLUMNS, x, x + length), ROWS - 30) < 10


def faded_streak(length, radius=10.0, least=4):
    """The pixels that a moving disc covers for more than `least` of the `length` px that it moves."""
    half = np.sqrt(np.clip(radius**2 - (ROWS - 30) ** 2, 0, None))
    return np.minimum(COLUMNS + half, 50 + length / 2) - np.maximum(COLUMNS - half, 50 - length / 2) > least


def fit(own, corner=(99, 199), picture=(1000, 1000)):
    """Centres within the region of the discs that are fitted to it."""
    found = fit_disc_group(np.pad(own.astype(np.uint8), 1), corner, 10.0, picture)
    return [one.position - np.add(corner, 1) for one in found]


@pytest.mark.parametrize(("own", "places"), [
    (discs(*TWO), TWO), (discs(*RING), RING), (discs(*CHAIN), CHAIN),
    (discs(*TWO) | (box(40, 36, 10, 4)), TWO),  # the waist is filled on one side
    (discs(*TWO) | box(40, 30, 10, 8), TWO),  # or mostly on both
    (discs(*RING, radius=11.5), RING),  # all outlines are smeared
    (discs(*TWO) | box(35, 21, 5, 3), TWO),  # something sticks to one
])  # fmt: skip
def test_touching_discs_are_found_without_a_waist(own, places):
    found = fit(own)
    assert len(found) == len(places)
    assert all(min(np.hypot(x - a, y - b) for a, b in found) < 1.5 for x, y in places)


@pytest.mark.parametrize("own", [
    discs((30, 30)), discs((40, 40), radius=15), streak(30, 20), streak(30, 34),
    faded_streak(26), faded_streak(40, radius=9.5),
    box(60, 40, 20, 10), box(60, 40, 26, 10),
    box(60, 40, 18, 18), discs((30, 40), radius=18) | discs((60, 40), radius=11), discs((30, 30), (42, 30)),
    discs(*TWO) | box(70, 30, 40, 4),  # an arm
])  # fmt: skip
def test_other_shapes_are_no_group(own):
    assert fit(own) == []


def test_the_rim_of_the_picture_is_no_outline():
    """A quarter of both discs lies outside the picture."""
    own = discs(*TWO)[25:]
    found = fit(own, corner=(-1, -1), picture=own.shape)
    assert sorted(np.round(found).tolist()) == [[30, 5], [50, 5]]
