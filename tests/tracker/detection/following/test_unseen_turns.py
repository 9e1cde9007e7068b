"""Balls that leave the picture, and others that enter it at the same place, on paths made here."""

import numpy as np
import pytest
from tracker_film import CAMERA
from tracker_paths import scattered

from tracker.camera.camera import Camera
from tracker.detection.following.unseen_turns import find_unseen_turns
from tracker.detection.link import link_detections

SIZE = 400  # px, of the picture
IN_PIXELS = Camera.from_dict({key: value for key, value in CAMERA.items() if key != "scale"} | {"size": [SIZE, SIZE]})


def visit(seed, side):
    """Paths (40, 3, 2): a disc leaves by a side at 8 to 15 px a frame, another enters there, and a third rolls on."""
    rng, time, rim, entry = np.random.default_rng(seed), np.arange(40.0), SIZE - 14, 18
    height, (out, back) = rng.uniform(120, 280), rng.uniform(8, 15, 2)
    left = np.where(time < 15, rim - rng.uniform(0, out) - out * (14 - time), np.nan)
    entered = np.where(time >= entry, rim - rng.uniform(0, back) - back * (time - entry), np.nan)
    paths = np.stack([
        np.column_stack([left, 0 * time + height]),
        np.column_stack([entered, 0 * time + height + rng.uniform(-15, 15)]),
        np.column_stack([40 + 3 * time, 40 + time]),
    ], axis=1)  # fmt: skip
    paths[np.isnan(paths[..., 0])] = np.nan
    if side in ("left", "top"):
        paths = SIZE - 1 - paths
    return paths[..., ::-1] if side in ("top", "bottom") else paths


@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
def test_a_ball_that_leaves_and_one_that_enters_are_in_doubt_where_they_are_joined(side):
    for seed in range(8):
        found, truth = scattered(np.random.default_rng(seed), visit(seed, side), noise=0.3)
        links = link_detections(found, IN_PIXELS, 40.0)
        one, other = (links.ids[truth == ball] for ball in (0, 1))
        assert one[-1] != other[0] or links.doubtful[truth == 1][0]
        assert links.doubtful.sum() <= 1


def test_a_side_at_which_a_ball_is_seen_to_bounce_is_a_wall():
    """One disc of 40 px is hidden as it turns at the rim, and another is seen to turn there, or is hit there."""
    time = np.arange(30.0)
    x = 385 - 10 * np.abs(time - 12)
    hidden = np.column_stack([np.where(np.abs(time - 12) < 2, np.nan, x), 0 * time + 100])
    bounces, rests = np.column_stack([x - 12, 0 * time + 300]), np.column_stack([0 * time + 390, 0 * time + 335])
    turns = {}
    for name, others in {"none": [], "wall": [bounces], "hit": [bounces, rests]}.items():
        found, truth = scattered(np.random.default_rng(0), np.stack([hidden, *others], axis=1))
        rows = find_unseen_turns(found.frame, truth, found.xy, (SIZE, SIZE), 40.0)
        turns[name] = [(truth[row], found.frame[row]) for row in rows]
    assert turns == {"none": [(0, 14)], "wall": [], "hit": [(0, 14)]}


def test_gaps_without_a_turn_and_turns_inside_are_no_doubt():
    """A disc rests at the rim, one rolls along it, and one turns in the middle; each is lost for three frames."""
    time = np.arange(30.0)
    paths = np.stack([
        np.column_stack([0 * time + 385, 0 * time + 50]),
        np.column_stack([50 + 8 * time, 0 * time + 385]),
        np.column_stack([200 - 8 * np.abs(time - 11.5), 0 * time + 200]),
    ], axis=1)  # fmt: skip
    paths[10:13] = np.nan
    paths = np.append(paths, np.full((30, 1, 2), 300.0), axis=1)
    found, truth = scattered(np.random.default_rng(0), paths, noise=0.5)
    assert len(find_unseen_turns(found.frame, truth, found.xy, (SIZE, SIZE), 40.0)) == 0
