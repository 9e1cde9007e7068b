"""The motion that unmistakable steps show, of paths made here."""

import numpy as np
import pytest
from tracker_paths import driven, glints, scattered

from tracker.detection.following import shown_motion
from tracker.detection.following.shown_motion import measure_motion


def test_the_push_of_driven_bodies_is_measured():
    rng = np.random.default_rng(5)
    paths = driven(rng)
    found, _ = scattered(rng, paths, noise=0.02)
    shown = measure_motion(found, 0.02)
    assert shown.acceleration == pytest.approx(float(np.std(np.diff(paths, 2, axis=0))), rel=0.15)
    assert (shown.fall, shown.position_error) == ((0.0, 0.0), 0.02)
    still, _ = scattered(rng, driven(rng, push=0.0, speed=0.0), noise=0.02)
    assert measure_motion(still, 0.02).acceleration < 0.02


def test_the_push_of_many_bodies_is_measured_in_few_frames(monkeypatch):
    """A thousand bodies on a lattice that are pushed alike: few frames have as many steps as 40 of a hundred."""
    rng, side, push, looked = np.random.default_rng(5), np.arange(32) * 30.0, 0.4, []
    lattice = np.stack(np.meshgrid(side, side), axis=-1).reshape(1, -1, 2)
    paths = lattice + np.cumsum(np.cumsum(push * rng.standard_normal((40, 1024, 2)), axis=0), axis=0) / 10
    found, _ = scattered(rng, paths, noise=0.02)
    steps = shown_motion._find_clear_steps
    monkeypatch.setattr(shown_motion, "_find_clear_steps", lambda *words: looked.append(words) or steps(*words))
    assert measure_motion(found, 0.02).acceleration == pytest.approx(push / 10, rel=0.15)
    assert 10 < len(looked) <= 30  # three of each frame; 114 if all were looked at


@pytest.mark.parametrize("noise", [0.02, 0.4])
def test_the_fall_of_bodies_and_the_error_of_their_positions_are_measured(noise):
    """Nine bodies on parabolas, whose positions are off by 0.4 px where 0.05 px are claimed."""
    rng, time = np.random.default_rng(2), np.arange(40.0)[:, None, None]
    start, v = 100.0 * np.stack(np.meshgrid(range(3), range(3)), axis=-1).reshape(1, 9, 2), rng.normal(0, 3, (1, 1, 2))
    paths = start + v * time + np.array([0.0, 1.5]) * time**2 / 2
    shown = measure_motion(scattered(rng, paths, noise=noise)[0], 0.05)
    assert shown.fall == pytest.approx((0.0, 1.5), abs=0.2)
    assert shown.position_error == pytest.approx(max(noise, 0.05), rel=0.15)
    assert shown.acceleration < 0.3


def test_uneven_steps_of_one_ball_count_as_an_acceleration():
    """Pictures of an even motion at times that are off by half a frame: speeds of 4 and 2.67 px a frame in turn."""
    frame = np.floor(np.arange(60) * 2.5).astype(int)
    found = glints(frame, np.column_stack([8.0 * np.arange(60), np.full(60, 50.0)]))
    change = (8 / 2 - 8 / 3) / 2.5  # along the way in every step: the rms along x; 0 is that along y
    assert change / np.sqrt(2) < measure_motion(found, 0.05).acceleration < change
