"""Slides without closed form against scipy's integrator on the raw equations."""

import numpy as np
import pytest
from everything import BENT, R, slide_by_hand

from synthcam.dynamics.kinematics import contact_velocity, rolling_velocity, slide
from synthcam.dynamics.sliding import slides
from synthcam.effects.plate_tilt import PlateTilt
from synthcam.model import Model

START = np.array(
    [
        [0.001, -0.002, R, 0.25, 0.1, 0.0, 120.0, -60.0, 40.0],
        [0.003, 0.004, R, -0.1, 0.3, 0.0, -20.0, 90.0, -70.0],
        [-0.002, 0.001, R, 0.02, 0.01, 0.0, 5.0, -6.0, 0.0],
    ]
)
BALLS = Model().bodies("bbb")


@pytest.fixture(scope="module")
def bent():
    return slides(BENT, START, BALLS)


@pytest.mark.parametrize("k", [0, 1, 2])
def test_a_slide_with_everything_bent(bent, k):
    run = slide_by_hand(START[k], [0.0, 1.0])
    assert bent.lasts[k] == pytest.approx(run.t[-1], abs=3e-8)
    times = np.tile(np.linspace(0, run.t[-1] - 2e-6, 60), (3, 1))  # before the uniform end
    ours = bent.states(np.minimum(times, bent.lasts[:, None]))[k]
    np.testing.assert_allclose(ours[:, [0, 1, 3, 4]], run.sol(times[k])[:4].T, rtol=0, atol=2e-9)
    np.testing.assert_allclose(ours[:, [6, 7, 8]] * R, run.sol(times[k])[4:].T * R, rtol=0, atol=1e-8)
    early = times[k] < bent.lasts[k] - 1e-4
    np.testing.assert_allclose(ours[early][:, [0, 1, 3, 4]], run.sol(times[k][early])[:4].T, rtol=0, atol=1e-11)
    np.testing.assert_allclose(bent.ends()[k, [0, 1, 3, 4]], run.y[:4, -1], rtol=0, atol=5e-8)
    np.testing.assert_allclose(contact_velocity(bent.ends()[k], R), 0, rtol=0, atol=1e-12)


def test_a_slide_is_smooth_over_its_tail(bent):
    """Where the closing formula takes over, state and velocity go on without a step."""
    back = np.geomspace(1e-9, 1e-3, 400)[::-1]
    states = bent.states(bent.lasts[:, None] - back)
    steepness = np.abs(np.diff(states[..., 3:5], axis=1)).max(axis=2) / -np.diff(back)
    assert np.all(steepness.max(axis=1) < 1.5 * steepness[:, 0])


def test_together_is_one_by_one(bent):
    for k in range(3):
        alone = slides(BENT, START[k : k + 1], BALLS[k : k + 1])
        times = np.linspace(0, 1, 20) * alone.lasts[:, None]
        together = bent.states(np.tile(times, (3, 1)).clip(0, bent.lasts[:, None]))[k]
        np.testing.assert_allclose(alone.states(times)[0], together, rtol=1e-11, atol=1e-13)


def test_a_slide_unbent_is_the_parabola():
    slowing = 0.232 * 9.81
    found = slides(Model(), START, BALLS)
    lasts = np.hypot(*contact_velocity(START, R).T) / (3.5 * slowing)
    np.testing.assert_allclose(found.lasts, lasts, rtol=1e-13)
    times = np.linspace(0, 1, 33) * lasts[:, None]
    np.testing.assert_allclose(found.states(times), slide(START, R, np.full(3, slowing), times), rtol=1e-11, atol=1e-14)
    np.testing.assert_allclose(rolling_velocity(found.ends(), R), rolling_velocity(START, R), rtol=1e-13)


def test_a_push_that_friction_cannot_end_is_refused():
    with pytest.raises(ValueError, match="does not end the slide"):
        slides(Model(sliding_friction=0.01, effects=(PlateTilt(x=0.09),)), START, BALLS)
