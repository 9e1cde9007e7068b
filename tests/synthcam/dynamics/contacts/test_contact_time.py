"""First contacts of balls on known legs, against geometry."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synthcam.dynamics.contacts.calendar import EventCalendar
from synthcam.dynamics.trajectory import RestLeg, RollLeg, SlideLeg

R = 1.19e-3


def first_contact(legs, radius, t, horizon):
    calendar = EventCalendar(radius, (), horizon)
    calendar.renew(legs, range(len(legs)), t, math.inf)
    due = calendar.pop(horizon)
    return due and (due[0], due[3], due[4])


def rest(x, y=0.0):
    return RestLeg(0.0, math.inf, (x, y, R, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def roll(x, y, vx, vy):
    return RollLeg(0.0, math.inf, 0.0, (x, y, R, vx, vy, 0.0, -vy / R, vx / R, 0.0), R, 0.0, 0.0)


@given(st.floats(-0.9, 0.9), st.floats(0.01, 0.6), st.floats(1e-6, 0.1), st.floats(0, 6.3))
def test_a_straight_line_meets_a_ball_at_rest(b, speed, away, heading):
    d = np.array([np.cos(heading), np.sin(heading)])
    start = -(away + 2 * R * np.sqrt(1 - b * b)) * d + 2 * R * b * np.array([-d[1], d[0]])
    legs = [rest(0.0), roll(*start.tolist(), *(speed * d).tolist())]
    found = first_contact(legs, [R, R], 0.0, 20.0)
    assert found is not None
    assert found[0] == pytest.approx(away / speed, rel=1e-11, abs=1e-14 / speed)
    assert found[1:] == (0, 1)
    assert first_contact(legs, [R, R], 0.0, 0.99 * away / speed) is None


def test_the_first_of_several_pairs():
    legs = [rest(0.0), roll(-0.02, 0.0, 0.1, 0.0), roll(0.015, 0.0, -0.2, 0.0), rest(1.0)]
    when, *pair = first_contact(legs, [R] * 4, 0.0, 1.0)
    assert pair == [0, 2]
    assert when == pytest.approx((0.015 - 2 * R) / 0.2, rel=1e-12)
    assert first_contact([rest(0.0), rest(0.0)], [R, R], 0.0, 1.0) is None  # nobody moves


def test_two_parabolas_that_come_near_and_part():
    """Sliding balls thrown at each other that friction turns back: they touch, or not, as the parabola says."""

    def sliding(x, v, u):
        state = (x, 0.0, R, v, 0.0, 0.0, 0.0, (v - u) / R, 0.0)
        return SlideLeg(0.0, 1.0, 0.0, state, R, 2.0, 0.4)

    def legs(gap):
        return [sliding(0.0, 0.1, 1.0), sliding(2 * R + gap, -0.1, -1.0)]

    deepest = 2 * (0.1**2 / (2 * 2.0))  # how much nearer they come: each stops after v^2/2a
    assert first_contact(legs(deepest * (1 + 1e-9)), [R, R], 0.0, 0.2) is None
    when, *_ = first_contact(legs(deepest * (1 - 1e-4)), [R, R], 0.0, 0.2)
    assert when == pytest.approx(0.05 * (1 - 1e-2), rel=1e-9)


@pytest.mark.parametrize("vx", [0.1, -0.1])
def test_balls_that_touch(vx):
    found = first_contact([rest(0.0), roll(-2 * R, 0.0, vx, 0.0)], [R, R], 0.0, 1.0)
    assert found == ((0.0, 0, 1) if vx > 0 else None)


def test_an_overlap_is_said():
    with pytest.raises(ValueError, match=r"balls overlap by 0\.000238 m at 0 s"):
        first_contact([rest(0.0), roll(-1.8 * R, 0.0, -0.1, 0.0)], [R, R], 0.0, 1.0)


def test_a_motion_without_numbers_is_refused():
    """It compares with nothing: a search of a fit led astray never came to an end."""
    legs = [rest(0.0), roll(-0.02, math.nan, 0.1, 0.0)]
    with pytest.raises(ValueError, match=r"cannot be followed beyond 0\.1 s"):
        first_contact(legs, [R, R], 0.1, 1.0)
