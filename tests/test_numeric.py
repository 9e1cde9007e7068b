"""Legs without closed form against scipy's integrator on the raw equations."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from synthcam.effect import Effect, parameter
from synthcam.model import Model
from synthcam.numeric import numeric_roll, numeric_slide
from synthcam.trajectory import Slide, contact_velocity, rolling_state, rolling_velocity

R = Model().ball.radius
G = 9.81


@dataclass(frozen=True)
class Everything(Effect):
    """Bends every law of motion, and each by position or speed."""

    size: float = parameter("1", scale=1)

    def friction(self, mu, slip_speed, slip):
        return mu * (1 + self.size * (0.3 * np.exp(-slip_speed / 0.1) + 0.1 * slip[..., 0] * slip[..., 1]))

    def normal_load(self, load, position):
        return load * (1 + self.size * 5 * position[..., 0])

    def push(self, acceleration, position, velocity):
        return acceleration + self.size * (0.5 * np.sin(300 * position) - 0.02 * velocity)

    def rolling(self, loss, speed, position):
        return loss + self.size * (0.1 * speed**2 + 0.005 * np.sin(200 * position[..., 1]))


BENT = Model(effects=(Everything(size=1.0),))
START = np.array([0.001, -0.002, R, 0.25, 0.1, 0.0, 120.0, -60.0, 40.0])


def slide_by_hand(times, start=START):
    def right(_, y):
        v, u = y[2:4], np.array([y[2] - R * y[5], y[3] + R * y[4]])
        s = np.hypot(*u)
        hat = u / s
        mu = 0.232 * (1 + 0.3 * np.exp(-s / 0.1) + 0.1 * hat[0] * hat[1])
        f = -mu * G * (1 + 5 * y[0]) * hat
        return [*v, *(f + 0.5 * np.sin(300 * y[:2]) - 0.02 * v), 2.5 / R * f[1], -2.5 / R * f[0]]

    def slip(_, y):
        return np.hypot(y[2] - R * y[5], y[3] + R * y[4]) - 1e-7

    slip.terminal = True
    y = start[[0, 1, 3, 4, 6, 7]]
    return solve_ivp(right, (times[0], times[-1]), y, "DOP853", events=slip, rtol=1e-12, atol=1e-14, dense_output=True)


def test_a_slide_with_everything_bent():
    leg = numeric_slide(BENT, START, 0.5)
    run = slide_by_hand([0.5, 1.0])
    assert leg.t1 == pytest.approx(run.t[-1], abs=3e-8)
    times = np.linspace(0.5, run.t[-1], 60)
    ours = leg.at(times)
    np.testing.assert_allclose(ours[:, [0, 1, 3, 4]], run.sol(times)[:4].T, rtol=0, atol=2e-9)
    np.testing.assert_allclose(ours[:, [6, 7]] * R, run.sol(times)[4:].T * R, rtol=0, atol=1e-8)
    early = times < leg.t1 - 1e-4
    np.testing.assert_allclose(ours[early][:, [0, 1, 3, 4]], run.sol(times[early])[:4].T, rtol=0, atol=1e-11)
    np.testing.assert_array_equal(ours[:, 8], 40)
    np.testing.assert_allclose(contact_velocity(leg.at(np.array([leg.t1]))[0], R), 0, rtol=0, atol=1e-12)


def test_a_slide_is_smooth_over_its_tail():
    """Where the closing formula takes over, state and velocity go on without a step."""
    leg = numeric_slide(BENT, START, 0.0)
    times = leg.t1 - np.geomspace(1e-9, 1e-3, 400)[::-1]
    v = leg.at(times)[:, 3:5]
    steepness = np.abs(np.diff(v, axis=0)).max(axis=1) / np.diff(times)
    assert steepness.max() < 1.5 * steepness[0]


def test_a_slide_unbent_is_the_parabola():
    u = np.hypot(*contact_velocity(START, R))
    slowing = 0.232 * G
    parabola = Slide(0.0, u / (3.5 * slowing), START, R, slowing)
    leg = numeric_slide(Model(), START, 0.0)
    assert leg.t1 == pytest.approx(parabola.t1, rel=1e-13)
    times = np.linspace(0, parabola.t1, 33)
    np.testing.assert_allclose(leg.at(times), parabola.at(times), rtol=1e-11, atol=1e-14)
    end = rolling_velocity(leg.at(times[-1:]), R)[0]
    np.testing.assert_allclose(end, rolling_velocity(START, R), rtol=1e-13)


@pytest.mark.parametrize("until", [0.8, -0.4])
def test_a_roll_with_everything_bent_both_ways_in_time(until):
    start = rolling_state(np.array([0.001, 0.002]), np.array([0.2, -0.1]), 7.0, R)

    def right(_, y):
        v = y[2:]
        s = np.hypot(*v)
        loss = 0.135 * s + 0.0103 + 0.1 * s * s + 0.005 * np.sin(200 * y[1])
        return [*v, *(5 / 7 * (0.5 * np.sin(300 * y[:2]) - 0.02 * v) - loss / s * v)]

    run = solve_ivp(right, (0.1, until), [*start[:2], *start[3:5]], "DOP853", rtol=1e-12, atol=1e-14, dense_output=True)
    leg = numeric_roll(BENT, start, 0.1, until)
    assert leg.t0 <= min(0.1, until)
    assert leg.t1 >= max(0.1, until)
    times = np.linspace(0.1, until, 60)
    np.testing.assert_allclose(leg.at(times)[:, [0, 1, 3, 4]], run.sol(times).T, rtol=0, atol=1e-11)
    np.testing.assert_allclose(contact_velocity(leg.at(times), R), 0, rtol=0, atol=1e-15)


def test_a_roll_stops_on_the_dot():
    start = rolling_state(np.zeros(2), np.array([0.03, 0.04]), 0.0, R)
    leg = numeric_roll(Model(), start, 0.0, 20.0)
    assert leg.t1 == pytest.approx(np.log1p(0.135 * 0.05 / 0.0103) / 0.135, abs=1e-11)
    np.testing.assert_allclose(leg.at(np.array([leg.t1]))[0, 3:], 0, rtol=0, atol=1e-15)
    late = leg.at(leg.t1 - np.geomspace(1e-8, 1e-3, 50))
    np.testing.assert_allclose(np.hypot(*late[:, 3:5].T), 0.0103 * np.geomspace(1e-8, 1e-3, 50), rtol=2e-4)


def test_a_roll_slower_than_the_slowest():
    start = rolling_state(np.zeros(2), np.array([5e-8, 0.0]), 0.0, R)
    leg = numeric_roll(BENT, start, 0.0, 1.0)
    assert np.isfinite(leg.at(np.array([0.0, leg.t1]))).all()


def test_no_acceleration_beats_the_bound():
    for leg in (
        numeric_slide(BENT, START, 0.0),
        numeric_roll(BENT, rolling_state(START[:2], START[3:5], 0.0, R), 0, 1),
    ):
        times = np.linspace(leg.t0, leg.t1, 5000)
        v = leg.at(times)[:, 3:5]
        a = np.linalg.norm(np.diff(v, axis=0), axis=1) / np.diff(times)
        assert a.max() <= leg.bound(leg.t0)
