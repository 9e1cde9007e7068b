"""Places of another ball, to which a track jumps and back, are taken out; hits and gaps are not."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import CAMERA, collisions

from discrepancy.data.track_checks import remove_strays
from synthcam.model import Model
from tracker.detection.link import Tracks

CLIPS = collisions(Model(), 6, 5)


def tracks_of(clip):
    pixels = CAMERA.project(np.concatenate([clip.xy, np.full((len(clip.xy), 1), CAMERA.radius)], axis=1))
    n = len(pixels)
    unseen, words = np.full(n, np.nan), np.full(n, "")
    cov = np.tile(1e-4 * np.eye(2), (n, 1, 1))
    return Tracks(clip.frame, clip.ball, *pixels.T.copy(), cov, unseen, words, unseen, unseen)


def test_a_hit_is_no_stray():
    for clip in CLIPS:
        tracks = tracks_of(clip)
        assert remove_strays(tracks, CAMERA)[0] is tracks


def test_nor_is_what_a_tracker_has_lost():
    for clip in CLIPS:
        tracks = tracks_of(clip.select(np.flatnonzero(clip.frame % 7 != 3)))
        assert remove_strays(tracks, CAMERA)[1] == []


@pytest.mark.parametrize("count", [1, 3, 8])
@pytest.mark.parametrize("far", [1.2, 2.5])
def test_another_ball_is_taken_out_and_no_more(count, far):
    for clip in CLIPS:
        tracks, first = tracks_of(clip), int(clip.launch[2] * clip.fps) + 12
        taken = (tracks.particle == 1) & (tracks.frame >= first) & (tracks.frame < first + count)
        moved = dataclasses.replace(tracks, x=tracks.x + far * CAMERA.diameter_px * taken)
        left, frames = remove_strays(moved, CAMERA)
        assert frames == list(range(first, first + count))
        np.testing.assert_array_equal(left.xy, tracks.xy[~taken])


def test_a_ball_that_is_changed_for_good_is_left():
    tracks = tracks_of(CLIPS[0])
    late = (tracks.particle == 1) & (tracks.frame >= 50)
    moved = dataclasses.replace(tracks, x=tracks.x + 3 * CAMERA.diameter_px * late)
    assert remove_strays(moved, CAMERA)[1] == []
