"""Tracks that somebody has rounded or thinned are known by it; others are not."""

import dataclasses
import re

import numpy as np
import pytest
from discrepancy_clips import CAMERA, collisions
from scipy.ndimage import uniform_filter1d

from discrepancy.data.launch import T_C
from discrepancy.data.track_checks import detect_processing, remove_filtered_rows
from discrepancy.preparation import prepare_data
from discrepancy.search import search
from synthcam.model import Model
from synthcam_shared.errors import InputError

CLIPS = collisions(Model(), 8, 5)


def rounded(clip, step):
    """Its pixels, to a multiple of so many."""
    pixels = CAMERA.project(np.concatenate([clip.xy, np.full((len(clip.xy), 1), CAMERA.radius)], axis=1))
    return dataclasses.replace(clip, xy=CAMERA.unproject(step * np.round(pixels / step))[0])


def thinned(clip, least):
    """Keep only positions of a moving ball that are at least so far from the last one kept."""
    kept = []
    for ball in (0, 1):
        last = None
        for row in np.flatnonzero(clip.ball == ball):
            way = np.inf if last is None else np.hypot(*(clip.xy[row] - clip.xy[last]))
            if way >= least:
                kept.append(row)
                last = row
    return clip.select(np.array(kept))


def test_of_tracks_as_they_were_measured_nothing_is_said():
    assert detect_processing(CLIPS) == ()


@pytest.mark.parametrize("step", [0.05, 0.25, 1.0])
def test_a_grid_is_found_with_its_step(step):
    (said,) = detect_processing([rounded(c, step) for c in CLIPS])
    assert float(re.search(r"rounded to (\S+) px", str(said))[1]) == pytest.approx(step, rel=0.05)


def test_digits_far_beyond_the_errors_are_no_grid():
    assert detect_processing([rounded(c, 0.002) for c in CLIPS]) == ()


@pytest.mark.parametrize("least", [8e-4, 1.2e-3])
def test_a_least_step_is_found(least):
    (said,) = detect_processing([thinned(c, least) for c in CLIPS])
    assert float(re.search(r"less than (\S+) mm", str(said))[1]) == pytest.approx(1e3 * least, rel=0.1)


def test_frames_lost_at_random_are_no_rule():
    rng = np.random.default_rng(1)
    assert detect_processing([c.select(np.flatnonzero(rng.random(len(c.frame)) > 0.2)) for c in CLIPS]) == ()


def test_what_a_filter_may_move_has_no_part():
    """A window of 11 about a place that is left holds neither a hit, nor a gap, nor an end."""
    clip = CLIPS[0].select(np.flatnonzero(CLIPS[0].frame != 60))
    left = remove_filtered_rows(clip)
    assert len(left.frame) > 0
    for ball in (0, 1):
        frames = set(clip.frame[clip.ball == ball].tolist())
        for frame in left.frame[left.ball == ball].tolist():
            window = set(range(frame - 5, frame + 6))
            assert window <= frames
            assert abs(frame - clip.launch[T_C] * clip.fps) > 5


def smoothed():
    """Collisions whose tracks went through a moving mean of 3."""
    out = []
    for clip in collisions(Model(), 8, 3):
        xy = clip.xy.reshape(2, -1, 2)
        out.append(dataclasses.replace(clip, xy=uniform_filter1d(xy, 3, axis=1, mode="nearest").reshape(-1, 2)))
    return out


def near(clip, frames):
    """Only what is seen within so many frames of the contact."""
    return clip.select(np.flatnonzero(np.abs(clip.frame - clip.launch[T_C] * clip.fps) < frames))


def test_of_smoothed_tracks_nothing_is_named_and_it_is_said():
    """A filter washes out the hit: effects of the library would be named for it."""
    found = search(smoothed(), Model())
    assert found.data.is_smoothed
    assert found.verdict in ("none", "inadequate")
    assert not found.named
    assert found.law_summary is None
    assert "smoothed by a filter" in found.sentence()
    assert any("smoothed" in line for line in found.document()["processed"])


def test_a_smoothed_collision_of_which_too_little_is_left_has_no_part():
    """12 frames on either side, less 5 at either end: 2 are left."""
    clips = smoothed()
    data = prepare_data([*clips[:3], near(clips[3], 12), *clips[4:]], Model())
    assert [n for n in data.left_out if str(n).startswith(f"clip {clips[3].clip}: too few positions")]
    assert clips[3].clip not in {clip.clip for clip in (*data.clips, *data.held_out)}


def test_smoothed_collisions_all_too_short_are_refused():
    clips = smoothed()
    with pytest.raises(InputError, match=r"smoothed by a filter.*: 5 of 8 collisions keep enough.*expected 6"):
        search([*(near(c, 12) for c in clips[:3]), *clips[3:]], Model())
