"""Rolls and flights without closed form against scipy's integrator on the raw equations."""

import numpy as np
import pytest
from everything import BENT, TIGHT, R, roll_by_hand
from scipy.integrate import solve_ivp

from synthcam.dynamics.kinematics import contact_velocity, roll, rolling_state
from synthcam.dynamics.rolling import flights, rolls
from synthcam.model import Model

TWO = Model().bodies("bb")
START = np.stack(
    [
        rolling_state(np.array([0.001, 0.002]), np.array([0.2, -0.1]), 7.0, R),
        rolling_state(np.array([-0.003, 0.0]), np.array([-0.05, 0.4]), 0.0, R),
    ]
)
BEGIN = np.array([0.1, 0.3])


@pytest.mark.parametrize("until", [0.8, -0.4])
def test_a_roll_with_everything_bent_both_ways_in_time(until):
    found = rolls(BENT, START, TWO, BEGIN, np.full(2, until))
    np.testing.assert_array_equal(found.until, until)
    times = BEGIN[:, None] + np.linspace(0, 1, 60) * (until - BEGIN)[:, None]
    states = found.states(times)
    for k in (0, 1):
        run = roll_by_hand(START[k], BEGIN[k], until)
        np.testing.assert_allclose(states[k][:, [0, 1, 3, 4]], run.sol(times[k]).T, rtol=0, atol=1e-11)
    np.testing.assert_allclose(contact_velocity(states, R), 0, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(states[0, :, 8], 7.0)


def test_a_roll_unbent_is_the_closed_form():
    times = BEGIN[:, None] + np.linspace(0, 3, 40)
    found = rolls(Model(), START, TWO, BEGIN, BEGIN + 3).states(times)
    np.testing.assert_allclose(found, roll(START, R, 0.135, 0.0103, times - BEGIN[:, None]), rtol=1e-12, atol=1e-14)


def test_a_roll_stops_on_the_dot():
    start = rolling_state(np.zeros((1, 2)), np.array([[0.03, 0.04]]), 0.0, R)
    found = rolls(Model(), start, TWO[:1], np.zeros(1), np.full(1, 20.0))
    stop = found.until[0]
    assert stop == pytest.approx(np.log1p(0.135 * 0.05 / 0.0103) / 0.135, abs=1e-11)
    np.testing.assert_allclose(found.states(np.array([[stop]]))[0, 0, 3:], 0, rtol=0, atol=1e-15)
    back = np.geomspace(1e-8, 1e-3, 50)
    late = found.states((stop - back)[None])[0]
    np.testing.assert_allclose(np.hypot(*late[:, 3:5].T), 0.0103 * back, rtol=2e-4)
    final = found.states(np.array([[stop]]))[0, 0, :2]
    left = 0.0103 * back[:, None] ** 2 / 2 * [0.6, 0.8]
    np.testing.assert_allclose(final - late[:, :2], left, rtol=2e-4, atol=1e-16)
    np.testing.assert_allclose(found.ends[:2, 0], final, rtol=1e-15)


def test_a_roll_slower_than_the_slowest():
    start = rolling_state(np.zeros((1, 2)), np.array([[5e-8, 0.0]]), 0.0, R)
    found = rolls(BENT, start, TWO[:1], np.zeros(1), np.ones(1))
    assert np.isfinite(found.states(np.array([[0.0, found.until[0]]]))).all()


def test_a_flight_is_pushed_in_full_and_loses_nothing():
    found = flights(BENT, START, TWO, BEGIN, BEGIN + 0.05)

    def right(_, y):
        return [*y[2:], *(0.5 * np.sin(300 * y[:2]) - 0.02 * y[2:])]

    for k in (0, 1):
        run = solve_ivp(right, (BEGIN[k], BEGIN[k] + 0.05), START[k][[0, 1, 3, 4]], **TIGHT)
        times = BEGIN[:, None] + np.linspace(0, 0.05, 9)
        np.testing.assert_allclose(found.plane(times)[:, k], run.sol(times[k]), rtol=0, atol=1e-12)
