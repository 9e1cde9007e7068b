"""Cuts of tracks at contacts: a kink is found, and all commands leave out the same positions."""

import numpy as np
import pytest

from tracker.measurement.local.stretches import cut_stretch
from tracker.measurement.positions import BallTrack
from tracker.measurement.stretch_cuts import CUTTER, measure_largest_noise, measure_path_noise

FPS, NOISE = 50, 2e-4


def bounce(at, angle=np.pi, frames=60, slide=0.0):
    """A ball that turns by `angle` at the time `at`; slide: its acceleration until then, m/s^2."""
    rng, time = np.random.default_rng(1), np.arange(frames) / FPS
    turned = 1.2 * np.array([np.cos(angle), np.sin(angle)])
    path = np.outer(np.minimum(time, at), [1.2, 0]) + np.outer(np.maximum(time - at, 0), turned)
    early, late = np.minimum(time, at), np.maximum(time - at, 0)
    path = path + np.outer(early**2 / 2 + early * late, [0, slide]) + rng.normal(0, NOISE, path.shape)
    return BallTrack(0, np.arange(frames), time, path, np.tile(np.eye(2) * NOISE**2, (frames, 1, 1)), 0.0)


@pytest.mark.parametrize(("angle", "slide", "found"), [(np.pi, 0.0, 1), (0.3, 0.0, 1), (0.0, 0.0, 0), (0.0, 2.5, 0)])
def test_a_kink_is_what_neither_friction_nor_noise_makes(angle, slide, found):
    ball = bounce(0.61, angle, slide=slide)
    noise = measure_path_noise([(ball.frame, ball.position)])
    assert noise == pytest.approx(NOISE, rel=0.3)
    kinks = CUTTER.find_kinks(ball.time, CUTTER.measure_kinks(ball.time, ball.position, noise))
    assert len(kinks) == found
    assert np.abs(kinks - 0.61).max(initial=0.0) <= 1 / FPS
    parts = list(CUTTER.cut(ball.time, ball.frame, np.append(kinks, 0.2), 1 / FPS))
    assert len(parts) == found + 2
    assert np.abs(ball.time[np.concatenate(parts)][:, None] - np.append(kinks, 0.2)).min() >= 1.5 / FPS - 1e-12


@pytest.mark.parametrize("frames", [8, 10, 12, 14])
def test_a_kink_is_found_in_a_path_so_short_that_all_its_windows_hold_it(frames):
    """Half of the path lies on either side."""
    at = (frames - 1) / 2 / FPS
    ball = bounce(at, frames=frames)
    kinks = CUTTER.find_kinks(ball.time, CUTTER.measure_kinks(ball.time, ball.position, NOISE))
    assert kinks == pytest.approx([at], abs=1 / FPS)


def test_a_path_that_bends_all_along_has_no_kink():
    """A body that turns about another at 12 rad/s, 6 cm away, has 8.6 m/s^2 everywhere."""
    time = np.arange(60) / FPS
    path = 0.06 * np.column_stack([np.cos(12 * time), np.sin(12 * time)])
    path = path + np.random.default_rng(1).normal(0, NOISE, path.shape)
    assert len(CUTTER.find_kinks(time, CUTTER.measure_kinks(time, path, NOISE))) == 0


@pytest.mark.parametrize("after", [False, True])
def test_the_local_estimate_follows_a_ball_to_the_next_contact_only(after):
    """From a hit at .2 s on, or back from one at 1 s, to the bounce at .61 s."""
    ball = bounce(0.61)
    hit = 0.2 if after else 1.0
    stretch = cut_stretch(ball, 2, after, 0.8, (hit, hit), 1 / FPS)
    assert 0.02 < np.abs(stretch.time - 0.61).min() < 0.06
    assert ((stretch.time < 0.61) == after).all()
    assert 1 <= stretch.near.sum() <= 2


def test_noise_of_a_ball_that_moves_is_no_kink_though_it_is_still_at_rest():
    """A codec repeats a ball at rest, and errs by forty times more as soon as it moves."""
    rng, time = np.random.default_rng(2), np.arange(260) / 240
    way, noise = np.maximum(time - 200 / 240, 0), np.where(np.arange(260) < 200, 1e-5, 4e-4)
    position = np.outer(way, [1.0, 0.2]) + noise[:, None] * rng.normal(size=(260, 2))
    ball = BallTrack(1, np.arange(260), time, position, np.tile(np.eye(2) * 1e-10, (260, 1, 1)), 0.0)
    assert cut_stretch(ball, 1, True, 0.5, (200 / 240, 200 / 240), 1 / 240).time[-1] > time[-4]


@pytest.mark.parametrize("count", [3, 4, 9, 12, 13, 60])
def test_the_largest_noise_is_that_of_the_noisiest_part(count):
    """Also where frames are missing, and where a ball rests: there positions that repeat show none."""
    rng = np.random.default_rng(count)
    frame = np.cumsum(rng.choice([1, 1, 1, 2], count))
    position = np.outer(frame, [1e-3, 2e-3]) + rng.normal(0, np.linspace(1e-6, 9e-6, count)[:, None], (count, 2))
    position[:20] = position[0] if count == 60 else position[:20]
    parts = [slice(k, k + 12) for k in range(0, max(count - 11, 1), 6)]
    each = [measure_path_noise([(frame[part], position[part])]) for part in parts]
    assert measure_largest_noise(frame, position) == pytest.approx(np.fmax.reduce(each), rel=1e-12, nan_ok=True)
    if count == 60:
        assert 3e-6 < measure_largest_noise(frame, position) < 3e-5
