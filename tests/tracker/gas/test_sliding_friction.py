"""The friction of the plate against slides of known friction, which end within their paths or later, or not seen."""

import numpy as np
import pytest

import synthcam
import tracker
from tracker.gas.free_paths import FreePath
from tracker.gas.sliding_friction import measure_sliding_friction
from tracker.gas.velocities import HalfVelocities
from tracker.measurement.positions import BallTrack

FPS, NOISE_M, FRICTION, LOSS = 250.0, 1e-5, 0.21, 0.08  # LOSS: m/s^2, of a ball that rolls


def make_path(number, slides_s, seed, frames=40, kink=0.0, friction=FRICTION, noise=NOISE_M, loss=LOSS):
    """A ball that slides for so long, at any angle to its path, and then rolls.

    kink: change of its velocity in the middle, m/s.
    """
    rng, time = np.random.default_rng([seed, number]), np.arange(frames) / FPS
    start, turn = rng.normal(0, 0.4, 2), rng.uniform(0, 2 * np.pi)
    pull = friction * 9.81 * np.array([np.cos(turn), np.sin(turn)])
    slid, rolled = np.minimum(time, slides_s)[:, None], np.maximum(time - slides_s, 0)[:, None]
    end = start + pull * slides_s
    position = start * slid + pull * slid**2 / 2 + end * rolled
    position = position - loss * end / np.hypot(*end) * rolled**2 / 2
    position = position + kink * np.maximum(time - time[frames // 2], 0)[:, None] + rng.normal(0, noise, (frames, 2))
    cov = np.broadcast_to(np.eye(2) * noise**2, (frames, 2, 2))
    frame, none = np.arange(frames), np.zeros((frames + 2, 2))
    ball = BallTrack(particle=number, frame=frame, start=time, position=position, cov=cov, exposure=0.0)
    velocities = HalfVelocities(none, none, *np.zeros((3, frames + 2)))
    path = FreePath(number, frame, ball.time, -1, -1, 0.0, float(time[-1]), velocities, np.zeros(frames + 2))
    return ball, path


def measure(pairs, noise=NOISE_M, rolling=None):
    balls, paths = zip(*pairs, strict=True)
    return measure_sliding_friction(balls, paths, noise, rolling)


@pytest.mark.parametrize(("longest_s", "kinks"), [(0.1, 0), (0.5, 0), (0.05, 0), (0.1, 2)])
def test_the_friction_has_an_error_that_holds(longest_s, kinks):
    """Slides end within paths of 160 ms, after them, or within a few frames. Some paths hide a hit."""
    z = []
    for seed in range(20):
        lasts = np.random.default_rng(seed).uniform(0, longest_s, 10)
        found = measure([make_path(k, s, seed, kink=0.003 * (k < kinks)) for k, s in enumerate(lasts)])
        z.append((found["mu_k"] - FRICTION) / found["mu_k_std"])
        assert found["mu_k_std"] < 0.1 * FRICTION
    assert abs(np.mean(z)) < 3 / np.sqrt(len(z))
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.3


@pytest.mark.parametrize(
    ("friction", "frames", "noise"), [(0.05, 40, 1e-5), (0.05, 12, 3e-5), (0.5, 40, 1e-5), (0.5, 12, 1e-4)]
)
def test_low_and_high_friction_have_errors_that_hold(friction, frames, noise):
    """Each time ten long paths and thirty others. Short paths of 44 ms show the acceleration to 0.1 or 0.4 m/s^2."""
    z = []
    for seed in range(30, 45):
        lasts = np.random.default_rng(seed).uniform(0, 0.1, 40)
        pairs = [make_path(k, s, seed, 40 if k < 10 else frames, 0.0, friction, noise) for k, s in enumerate(lasts)]
        found = measure(pairs, noise)
        z.append((found["mu_k"] - friction) / found["mu_k_std"])
    assert abs(np.mean(z)) < 3 / np.sqrt(len(z))
    assert 0.45 < np.sqrt(np.mean(np.square(z))) < 1.55


def test_paths_count_by_their_error_relative_to_the_friction():
    """Short paths show accelerations to 0.1 or to 0.4 m/s^2, of slides with 0.5 and 4.9 m/s^2."""
    low = [make_path(k, 0.1, 1, 12, 0.0, 0.05, 3e-5) for k in range(20)]
    high = [make_path(k, 0.1, 1, 12, 0.0, 0.5, 1e-4) for k in range(20)]
    assert np.isnan(measure(low, 3e-5)["mu_k"])
    assert measure(high, 1e-4)["mu_k"] == pytest.approx(0.5, rel=0.05)


def test_the_loss_of_rolling_that_the_film_shows_is_expected():
    """A soft floor, whose loss is far larger than that of a cloth."""
    law = {
        "rolling_speed": 0.5,
        "rolling_loss": 1.2,
        "rolling_drag": 0.0,
        "rolling_loss_std": 0.01,
        "rolling_drag_std": 0.0,
    }
    z = []
    for seed in range(50, 60):
        lasts = np.random.default_rng(seed).uniform(0.02, 0.1, 10)
        found = measure([make_path(k, s, seed, loss=1.2) for k, s in enumerate(lasts)], rolling=law)
        z.append((found["mu_k"] - FRICTION) / found["mu_k_std"])
    assert abs(np.mean(z)) < 3 / np.sqrt(len(z))
    assert np.sqrt(np.mean(np.square(z))) < 1.6


def test_balls_that_roll_and_too_few_that_slide_show_no_friction():
    assert np.isnan(measure([make_path(k, 0.0, 1) for k in range(20)])["mu_k"])
    assert np.isnan(measure([make_path(k, 0.1 * (k < 2), 1) for k in range(20)])["mu_k"])
    assert np.isfinite(measure([make_path(k, 0.1 * (k < 3), 1) for k in range(20)])["mu_k"])


def test_a_break_shows_the_friction_of_its_cloth():
    """No contact of it can be measured. The balls slide after the break and after the cushions."""
    clip = synthcam.Scene.read("break").draw(seed=1)
    true = clip.tracks[["frame", "particle"]].copy()
    noise = np.random.default_rng(1).normal(0, 0.05, (2, len(true)))
    true["x"], true["y"] = clip.tracks["x_mean_px"] + noise[0], clip.tracks["y_mean_px"] + noise[1]
    gas = tracker.observe_gas(tracker.measure(true.assign(x_std=0.05, y_std=0.05), clip.camera_json))
    value, std = gas.values["mu_k"], gas.values["mu_k_std"]
    assert abs(value - clip.model.sliding_friction) < 3 * std < 0.05 * value
