"""Trajectories at any time, and the legs they are made of."""

import numpy as np
import pytest

from synthcam.dynamics.kinematics import contact_velocity, rolling_state, rolling_velocity
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.dynamics.trajectory import RollLeg, SlideLeg
from synthcam.model import Model

R = Model().ball.radius


@pytest.fixture(scope="module")
def motion():
    return solve(Model(), Launch.pair(Model().bodies("ab"), 0.1, 0.4, 0.2, 0.5, (0, 0)), 0.0, 0.3)


def test_any_times_in_any_order(motion):
    times = np.array([0.25, 0.0, 0.1, 0.1, 0.3, 0.11])
    states = motion.at(times)
    assert states.shape == (2, 6, 9)
    for k, t in enumerate(times):
        np.testing.assert_array_equal(states[:, k], motion.at(t)[:, 0])
    assert motion.at([]).shape == (2, 0, 9)
    assert motion.at([0]).dtype == float


def test_legs_begin_in_their_state():
    """The search for contacts takes the state of a leg without the work of `now`."""
    legs = [leg for own in solve_some() for leg in own if isinstance(leg, (RollLeg, SlideLeg)) and leg.time == leg.t0]
    assert {type(leg) for leg in legs} == {RollLeg, SlideLeg}
    for leg in legs:
        assert leg.now(leg.time) == leg.state


def solve_some():
    for angle, spin in ((0.0, (0.0, 0.0, 0.0)), (0.5, (0.0, 0.0, 0.0)), (2.0, (0.1, -0.2, 0.3))):
        launch = Launch.pair(Model().bodies("ab"), 0.1, 0.4, 0.2, angle, (0, 0), spin)
        yield from solve(Model(), launch, 0.0, 0.3).legs


def test_means_up_to_a_sudden_end():
    """With spin about the vertical, friction fades shortly before the slide ends; against a sum over small parts."""
    model = Model().replace({"drilling_spin.a": 2e-5})
    motion = solve(model, Launch.pair(model.bodies("ab"), 0.1, 0.4, 0.3, 0.5, (0, 0)), 0.0, 0.3)
    for ball in (0, 1):
        end = motion.first("slide_end", ball).t
        for a, b in ((end - 3e-3, end + 1e-3), (end - 4e-3, end), (end - 4.2e-3, end - 2e-4)):
            near = np.minimum(end - np.geomspace(1e-8, 4e-3, 60), b)
            cuts = np.unique(np.concatenate([[a, b], near[near > a], [min(end, b)]]))
            parts = motion.average(np.stack([cuts[:-1], cuts[1:]], axis=1), lambda s: s[..., :2])
            whole = motion.average(np.array([[a, b]]), lambda s: s[..., :2])[ball, 0]
            np.testing.assert_allclose(whole, np.diff(cuts) @ parts[ball] / (b - a), rtol=0, atol=1e-12)


def test_on_an_event_it_is_just_after(motion):
    hit = motion.first("contact")
    np.testing.assert_array_equal(motion.at(hit.t)[[hit.i, hit.j], 0], hit.after)
    np.testing.assert_allclose(motion.at(np.nextafter(hit.t, 0))[[hit.i, hit.j], 0], hit.before, rtol=1e-12, atol=1e-12)
    assert motion.motion(hit.t).tolist() == [["slide"], ["slide"]]
    for ball in (0, 1):
        end = motion.first("slide_end", ball)
        np.testing.assert_array_equal(motion.at(end.t)[ball, 0], end.after[0])
        assert motion.motion([end.t - 1e-9, end.t])[ball].tolist() == ["slide", "roll"]
    assert motion.motion(0.0).tolist() == [["rest"], ["roll"]]


def test_position_has_no_jumps_and_velocity_is_its_slope(motion):
    times = np.linspace(0, 0.3, 30001)
    states = motion.at(times)
    slope = (states[:, 2:, :2] - states[:, :-2, :2]) / (times[2:] - times[:-2])[:, None]
    inside = np.ones(len(times) - 2, bool)
    for e in motion.events:
        inside &= np.abs(times[1:-1] - e.t) > 2e-5
    np.testing.assert_allclose(slope[:, inside], states[:, 1:-1, 3:5][:, inside], rtol=0, atol=1e-9)


@pytest.mark.parametrize("t", [-1e-9, 0.3001, np.nan, np.inf, [0.1, 1.0]])
def test_outside_it_refuses(motion, t):
    with pytest.raises(ValueError, match="outside the trajectory"):
        motion.at(t)
    with pytest.raises(ValueError, match="outside the trajectory"):
        motion.motion(t)


def test_first(motion):
    hit = motion.first("contact")
    assert motion.first("contact", after=hit.t + 1e-9) is None
    assert motion.first("contact", ball=0) is hit
    assert motion.first("slide_end", 1).i == 1
    assert [e.t for e in motion.events] == sorted(e.t for e in motion.events)


def test_the_contact_velocity_is_that_of_the_lowest_point():
    state = np.array([0, 0, R, 0.3, -0.1, 0, 10.0, 20.0, 30.0])
    lowest = state[3:6] + np.cross(state[6:9], [0, 0, -R])
    np.testing.assert_allclose(contact_velocity(state, R), lowest[:2], rtol=1e-14)
    rolls = rolling_state(np.zeros(2), rolling_velocity(state, R), 0.0, R)
    np.testing.assert_allclose(rolls[3:6] + np.cross(rolls[6:9], [0, 0, -R]), 0, rtol=0, atol=1e-15)
    invariant = (5 * state[3:6] + 2 * R * np.cross(state[6:9], [0, 0, -1]) * -1) / 7
    np.testing.assert_allclose(rolling_velocity(state, R), invariant[:2], rtol=1e-13)


def test_a_slide_is_a_parabola_in_long_arithmetic():
    state = np.array([0.01, 0.02, R, 0.3, -0.1, 0, 10.0, 20.0, 30.0])
    leg = SlideLeg(0.5, 0.6, 0.5, tuple(state), R, 2.3, 0.4)
    t = np.linspace(0, 0.03, 5).astype(np.longdouble)
    u = np.array([0.3 - R * 20, -0.1 + R * 10], np.longdouble)
    a = -2.3 * u / np.sqrt(u @ u)
    states = leg.at(0.5 + t.astype(float))
    place = np.array([0.01, 0.02]) + np.outer(t, [0.3, -0.1]) + np.outer(t**2, a) / 2
    spin = np.array([10.0, 20.0]) + 2.5 / R * np.outer(t, [a[1], -a[0]])  # I dw/dt = -R z x F
    np.testing.assert_allclose(states[:, :2], place.astype(float), rtol=0, atol=1e-16)
    np.testing.assert_allclose(states[:, 6:8], spin.astype(float), rtol=1e-12)
    np.testing.assert_array_equal(states[:, [2, 5, 8]], [[R, 0, 30.0]] * 5)


@pytest.mark.parametrize("drag", [0.0, 1e-12, 1e-6, 0.0199, 0.0201, 0.135, 5.0])
def test_a_roll_in_long_arithmetic(drag):
    state = rolling_state(np.array([0.01, 0.0]), np.array([0.3, 0.0]), 0.0, R)
    leg = RollLeg(0.0, 1.0, 0.0, tuple(state), R, drag, 0.01)
    t = np.linspace(0, 0.5, 7)
    k, s = np.longdouble(drag or 1e-30), t.astype(np.longdouble)
    if drag < 1e-4:  # three terms of the series are exact
        v = 0.3 - (k * 0.3 + 0.01) * s + k * (k * 0.3 + 0.01) * s**2 / 2
        x = 0.3 * s - (k * 0.3 + 0.01) * s**2 / 2 + k * (k * 0.3 + 0.01) * s**3 / 6
    else:
        v = (0.3 + 0.01 / k) * np.exp(-k * s) - 0.01 / k
        x = (0.3 + 0.01 / k) * -np.expm1(-k * s) / k - 0.01 / k * s
    np.testing.assert_allclose(leg.at(t)[:, 3], v.astype(float), rtol=3e-15)
    np.testing.assert_allclose(leg.at(t)[:, 0], 0.01 + x.astype(float), rtol=3e-15)
