"""Single wrong places are taken out before anything is read from the tracks; noise, jumps and contacts are not."""

import dataclasses

import numpy as np
import pytest

from discrepancy.find import find
from discrepancy.spike import spikes, without_spikes
from discrepancy_clips import STD, collisions, only
from synthcam.model import Model

CLIPS = collisions(Model(), 8, 3)


def moved(clip, rows, by):
    xy = clip.xy.copy()
    xy[rows] += by
    return dataclasses.replace(clip, xy=xy)


@pytest.mark.parametrize("by", [[20, 0], [0, -20], [1e3, 1e3]])
def test_a_place_far_off_its_path_is_a_spike(by):
    for clip in CLIPS:
        rows = [
            int(np.flatnonzero((clip.ball == ball) & (clip.frame == frame))[0]) for ball, frame in ((0, 6), (1, 70))
        ]
        assert spikes(moved(clip, rows, STD * np.array(by))) == set(rows)


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_noise_has_none(rho):
    assert not any(spikes(clip) for clip in collisions(Model(), 12, 4, rho))


def test_errors_that_are_claimed_to_vary_make_none():
    rng = np.random.default_rng(2)
    for clip in CLIPS:
        claimed = clip.covariance * rng.uniform(0.9, 1.1, (len(clip.frame), 1, 1))
        assert not spikes(dataclasses.replace(clip, covariance=claimed))


def test_a_jump_is_none():
    """As where a frame is lost: all that follows stands elsewhere."""
    for clip in CLIPS:
        late = np.flatnonzero((clip.ball == 1) & (clip.frame >= 70))
        assert spikes(moved(clip, late, 50 * STD)) == set()


def test_what_is_left_is_the_clip_without_them_and_it_is_said():
    row = int(np.flatnonzero((CLIPS[2].ball == 1) & (CLIPS[2].frame == 70))[0])
    kept, (said,) = without_spikes([*CLIPS[:2], moved(CLIPS[2], [row], 30 * STD)])
    assert kept[:2] == CLIPS[:2]
    assert np.array_equal(kept[2].xy, np.delete(CLIPS[2].xy, row, axis=0))
    assert np.array_equal(kept[2].covariance, np.delete(CLIPS[2].covariance, row, axis=0))
    assert said == "clip 2: 1 of 160 places, in frame 70, far off the path through those before and after"


def test_three_wrong_places_make_no_discovery(monkeypatch):
    only(monkeypatch)
    wrong = [moved(c, [40 + 11 * k], 300 * STD) for k, c in enumerate(CLIPS[:3])]
    found = find([*wrong, *CLIPS[3:]], Model())
    assert found.verdict == "none"
    assert found.noise.scale == pytest.approx(1, abs=0.1)
    assert [line.partition(",")[0] for line in found.left_out] == [f"clip {k}: 1 of 160 places" for k in range(3)]
