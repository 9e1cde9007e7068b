"""The closed forms are the same for one ball in plain floats, for arrays of numbers, and for states in rows."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synthcam.dynamics.contacts.impact import collide_pair, collide_pairs
from synthcam.dynamics.kinematics import (
    after_flight,
    after_rolling,
    after_sliding,
    fly,
    integrate_drag,
    roll,
    rolling_state,
    slide,
    stop_time,
)
from synthcam.dynamics.launch import launch_touching_pairs
from synthcam.model import Model

R = 1.19e-3
speed = st.floats(-1, 1)
states = st.tuples(*[speed] * 6).map(lambda v: np.array([v[0], v[1], R, v[2], 0.3, 0, v[3] / R, v[4] / R, v[5] / R]))
times = st.lists(st.floats(0, 0.3), min_size=1, max_size=4).map(np.array)


def close(ours, theirs):
    np.testing.assert_allclose(ours, theirs, rtol=1e-14, atol=1e-16)


@given(states, times)
def test_slides_and_flights(state, t):
    one = tuple(state.tolist())
    close([after_sliding(one, R, 2.3, x) for x in t.tolist()], slide(state, R, 2.3, t))
    close([after_flight(one, 9.81, x) for x in t.tolist()], fly(state, 9.81, t))


@given(speed, speed, times, st.sampled_from([0.0, 1e-9, 9e-4, 0.135, 3.0]), st.sampled_from([0.0, 0.01]))
def test_rolls(x, v, t, drag, decel):
    state = rolling_state(np.array([x, 0.1]), np.array([0.2, v]), 5.0, R)
    close([after_rolling(tuple(state.tolist()), R, drag, decel, x) for x in t.tolist()], roll(state, R, drag, decel, t))
    for s in (1e-6, 0.1, 2.0):
        assert stop_time(s, drag, decel) == pytest.approx(float(stop_time(np.array([s]), drag, decel)[0]), rel=1e-12)


@pytest.mark.parametrize("drag", [0.0, 1e-12, 9.9e-4, 1.01e-3, 0.135, 5.0])
@pytest.mark.parametrize("t", [1e-9, 1e-3, 0.3, 9.9, -2.0])
def test_coasting_in_long_arithmetic(drag, t):
    x, long = np.longdouble(drag) * np.longdouble(t), np.longdouble(t)
    if abs(x) > 1:
        decay = -np.expm1(-x) / np.longdouble(drag)
        expected = float(decay), float((long - decay) / np.longdouble(drag))
    else:  # (-x)^k/(k + 1)! and (-x)^k/(k + 2)!
        one = sum((-x) ** k / math.factorial(k + 1) for k in range(25))
        two = sum((-x) ** k / math.factorial(k + 2) for k in range(25))
        expected = float(long * one), float(long**2 * two)
    lost = 1e-15 * abs(t) / max(drag, 1e-3)  # of the integral, metres per unit of deceleration
    for found in (integrate_drag(drag, t), [v[0] for v in integrate_drag(drag, np.array([t]))]):
        assert found[0] == pytest.approx(expected[0], rel=1e-15)
        assert found[1] == pytest.approx(expected[1], rel=1e-14, abs=lost)


@given(st.floats(0.05, 0.6), st.floats(-0.95, 0.95), st.floats(0, 6.3))
def test_impacts(v0, b, heading):
    model = Model().replace({"hop.share": 0.7, "mass_mismatch.excess": 0.2, "velocity_restitution.e": 0.2})
    model = model.replace({"ball_friction.share": 0.5, "ball_friction.mu": 0.1})
    one, two = model.bodies("a"), model.bodies("b")
    target, striker = launch_touching_pairs(one, two, *(np.array([x]) for x in (v0, b, heading)), np.zeros((1, 2)))
    many = collide_pairs(model, target, striker, one, two)
    bodies = ((x.radius.item(), x.mass.item(), x.inertia.item()) for x in (one, two))
    single = collide_pair(model, tuple(target[0].tolist()), tuple(striker[0].tolist()), *bodies)
    assert all(type(x) is float for state in single[:3] for x in state)
    for ours, theirs in zip(single, (many.target[0], many.striker[0], many.n[0]), strict=False):
        np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-13)
    assert single[3:] == pytest.approx((many.impulse_n[0], many.impulse_t[0]), rel=1e-13, abs=1e-22)
