"""The rolling loss against the closed form of v' = -(decel + drag v), with slides, balls that stop, and kinks."""

from dataclasses import replace

import numpy as np
import pytest

import synthcam
import tracker
from tracker.gas.free_paths import FreePath
from tracker.gas.rolling_loss import MIN_PATHS, measure_rolling_loss
from tracker.gas.velocities import HalfVelocities
from tracker.measurement.positions import BallTrack

FPS, NOISE_M = 250.0, 8e-6
DRAG, DECEL = 0.2, 0.1  # 1/s and m/s^2


def roll(speed, time):
    """The way of a ball, m, that slows by v' = -(decel + drag v) until it rests."""
    stops = np.log1p(DRAG * speed / DECEL) / DRAG
    t = np.minimum(time, stops)
    return (speed + DECEL / DRAG) * (1 - np.exp(-DRAG * t)) / DRAG - DECEL / DRAG * t


def make_path(number, speed, seed, frames=60, kink=0.0):
    """A ball that rolls at an angle; kink: change of its velocity across its path in the middle, m/s."""
    rng, time = np.random.default_rng([seed, number]), np.arange(frames) / FPS
    angle = rng.uniform(0, 2 * np.pi)
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    way = roll(speed, time)[:, None] * along + kink * np.maximum(time - time[frames // 2], 0)[:, None] * across
    position = way + rng.normal(0, NOISE_M, (frames, 2))
    cov = np.broadcast_to(np.eye(2) * NOISE_M**2, (frames, 2, 2))
    frame = np.arange(frames)
    ball = BallTrack(particle=number, frame=frame, start=time, position=position, cov=cov, exposure=0.0)
    none = np.zeros((frames + 2, 2))
    velocities = HalfVelocities(none, none, *np.zeros((3, frames + 2)))
    path = FreePath(number, frame, ball.time, -1, -1, 0.0, float(time[-1]), velocities, np.zeros(frames + 2))
    return ball, path


def measure(pairs):
    balls, paths = zip(*pairs, strict=True)
    return measure_rolling_loss(balls, paths, NOISE_M)


def test_loss_and_its_growth_with_the_speed_have_errors_that_hold():
    z = []
    for seed in range(60):
        found = measure([make_path(k, speed, seed) for k, speed in enumerate(np.linspace(0.1, 0.6, 12))])
        truth = DECEL + DRAG * found["rolling_speed"]
        z.append((found["rolling_loss"] - truth) / found["rolling_loss_std"])
        z.append((found["rolling_drag"] - DRAG) / found["rolling_drag_std"])
        assert found["rolling_loss_std"] < 0.02 * truth
    assert abs(np.mean(z)) < 3 / np.sqrt(len(z))
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.2


def test_balls_that_stop_or_rest_or_are_hit_unseen_do_not_count():
    rolling = [make_path(k, speed, 1) for k, speed in enumerate(np.linspace(0.2, 0.6, 10))]
    others = [make_path(10, 0.015, 1), make_path(11, 0.025, 1), make_path(12, 0.0, 1), make_path(13, 0.3, 1, kink=0.05)]
    assert measure([*rolling, *others]) == measure(rolling)


def test_positions_count_only_while_the_ball_rolls():
    pairs = [make_path(k, speed, 2) for k, speed in enumerate(np.linspace(0.2, 0.6, 10))]
    slid = []
    for ball, path in pairs:
        early = np.maximum(0.08 - ball.time, 0)[:, None] ** 2 * np.array([1.0, 0.5])  # a friction of 2 m/s^2
        slid.append((replace(ball, position=ball.position + early), replace(path, rolls_from=0.081)))
    found = measure(slid)
    assert abs(found["rolling_loss"] - DECEL - DRAG * found["rolling_speed"]) < 3 * found["rolling_loss_std"]
    assert measure([(ball, replace(path, rolls_from=0.0)) for ball, path in slid]) != found


def test_few_paths_give_no_drag_and_fewer_no_loss():
    pairs = [make_path(k, speed, 3) for k, speed in enumerate(np.linspace(0.2, 0.6, MIN_PATHS))]
    found = measure(pairs)
    assert np.isnan(found["rolling_drag"])
    assert abs(found["rolling_loss"] - DECEL - DRAG * found["rolling_speed"]) < 3 * found["rolling_loss_std"]
    assert np.isnan(measure(pairs[1:])["rolling_loss"])


@pytest.mark.parametrize("scene", ["crowd", "pucks"])
def test_a_crowd_shows_the_loss_after_slides_and_on_air(scene):
    clip = synthcam.Scene.read(scene, timing={"frames": 100}).draw(seed=1)
    rng = np.random.default_rng(1)
    x, y = (clip.tracks[f"{axis}_mean_px"] + 0.05 * rng.standard_normal(len(clip.tracks)) for axis in "xy")
    table = clip.tracks[["frame", "particle"]].assign(x=x, y=y, x_std=0.05, y_std=0.05, cov_xy=0.0)
    gas = tracker.observe_gas(tracker.measure(table[clip.tracks.visible], clip.camera_json))
    drag, decel = (clip.model.rolling_drag, clip.model.rolling_decel) if scene == "crowd" else (0.05, 0.02)
    truth = decel + drag * gas.values["rolling_speed"]
    assert abs(gas.values["rolling_loss"] - truth) < 3 * gas.values["rolling_loss_std"] < 0.1 * truth


def test_paths_that_disagree_show_no_loss():
    """Some of the balls slide under a friction that no fit of their own path shows."""
    pairs = [make_path(k, speed, 4) for k, speed in enumerate(np.linspace(0.2, 0.6, 10))]
    for k in range(0, 10, 3):
        ball, path = pairs[k]
        way = ball.position[-1] - ball.position[0]
        slides = -0.2 * ball.time[:, None] ** 2 / 2 * way / np.hypot(*way)
        pairs[k] = replace(ball, position=ball.position + slides), path
    assert all(np.isnan(value) for value in measure(pairs).values())
