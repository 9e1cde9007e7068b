"""Slides, rolls and flights without closed form, against scipy's integrator on the raw equations."""

import dataclasses

import numpy as np
import pytest
from everything import BENT, TIGHT, R, roll_by_hand, slide_by_hand
from scipy.integrate import solve_ivp

from synthcam.dynamics.forces import BallStates, find_ending_slip
from synthcam.dynamics.kinematics import contact_velocity, roll, rolling_state, rolling_velocity, slide
from synthcam.dynamics.propagate import PhaseIntegrator, propagate, propagate_back
from synthcam.effects.plate_tilt import PlateTilt
from synthcam.effects.plate_waviness import PlateWaviness
from synthcam.effects.stribeck import Stribeck
from synthcam.model import Model

START = np.array(
    [
        [0.001, -0.002, R, 0.25, 0.1, 0.0, 120.0, -60.0, 40.0],
        [0.003, 0.004, R, -0.1, 0.3, 0.0, -20.0, 90.0, -70.0],
        [-0.002, 0.001, R, 0.02, 0.01, 0.0, 5.0, -6.0, 0.0],
    ]
)
BALLS = Model().bodies("bbb")
TWO = Model().bodies("bb")
ROLLS = np.stack(
    [
        rolling_state(np.array([0.001, 0.002]), np.array([0.2, -0.1]), 7.0, R),
        rolling_state(np.array([-0.003, 0.0]), np.array([-0.05, 0.4]), 0.0, R),
    ]
)
BEGIN = np.array([0.1, 0.3])


def slides(model, states, bodies):
    """All slides at once."""
    floor = (
        find_ending_slip(model, states, bodies)
        if model.laws.has_effect_on("drilling")
        else np.full(len(states), np.inf)
    )
    ((_, way),) = propagate(BallStates(model, bodies, states, floor), np.full(len(states), np.inf))
    return way


def rolls(model, start, until):
    """Follow one ball from time 0: the pieces of its path, each with its end, and the last state."""
    now, pieces = np.zeros(1), []
    while now < until:
        ((_, way),) = propagate(BallStates.without_drilling(model, TWO[:1], start), until - now)
        pieces.append(way.motion.shift(now))
        start, now = way.final_states, now + way.durations
        if way.ended[0]:
            break
    return pieces, now[0], start


@pytest.fixture(scope="module")
def bent():
    return slides(BENT, START, BALLS)


@pytest.mark.parametrize("k", [0, 1, 2])
def test_a_slide_with_everything_bent(bent, k):
    run = slide_by_hand(START[k], [0.0, 1.0])
    assert bent.durations[k] == pytest.approx(run.t[-1], abs=3e-8)
    times = np.tile(np.linspace(0, run.t[-1] - 2e-6, 60), (3, 1))  # before the uniform end
    ours = bent.motion.at(np.minimum(times, bent.durations[:, None]))[k]
    np.testing.assert_allclose(ours[:, [0, 1, 3, 4]], run.sol(times[k])[:4].T, rtol=0, atol=2e-9)
    np.testing.assert_allclose(ours[:, [6, 7, 8]] * R, run.sol(times[k])[4:].T * R, rtol=0, atol=1e-8)
    early = times[k] < bent.durations[k] - 1e-4
    np.testing.assert_allclose(ours[early][:, [0, 1, 3, 4]], run.sol(times[k][early])[:4].T, rtol=0, atol=1e-11)
    np.testing.assert_allclose(bent.final_states[k, [0, 1, 3, 4]], run.y[:4, -1], rtol=0, atol=5e-8)
    np.testing.assert_allclose(contact_velocity(bent.final_states[k], R), 0, rtol=0, atol=1e-12)


def test_a_slide_is_smooth_over_its_tail(bent):
    """State and velocity are continuous where the closing formula takes over."""
    back = np.geomspace(1e-9, 1e-3, 400)[::-1]
    states = bent.motion.at(bent.durations[:, None] - back)
    steepness = np.abs(np.diff(states[..., 3:5], axis=1)).max(axis=2) / -np.diff(back)
    assert np.all(steepness.max(axis=1) < 1.5 * steepness[:, 0])


def test_together_is_one_by_one(bent):
    for k in range(3):
        alone = slides(BENT, START[k : k + 1], BALLS[k : k + 1])
        times = np.linspace(0, 1, 20) * alone.durations[:, None]
        together = bent.motion.at(np.tile(times, (3, 1)).clip(0, bent.durations[:, None]))[k]
        np.testing.assert_allclose(alone.motion.at(times)[0], together, rtol=1e-11, atol=1e-13)


def test_a_slide_unbent_is_the_parabola():
    slowing = 0.232 * 9.81
    found = slides(Model(), START, BALLS)
    lasts = np.hypot(*contact_velocity(START, R).T) / (3.5 * slowing)
    np.testing.assert_allclose(found.durations, lasts, rtol=1e-13)
    times = np.linspace(0, 1, 33) * lasts[:, None]
    np.testing.assert_allclose(
        found.motion.at(times), slide(START, R, np.full(3, slowing), times), rtol=1e-11, atol=1e-14
    )
    np.testing.assert_allclose(rolling_velocity(found.final_states, R), rolling_velocity(START, R), rtol=1e-13)


def test_a_push_that_friction_cannot_end_is_refused():
    with pytest.raises(ValueError, match="does not end the slide"):
        slides(Model(sliding_friction=0.01, effects=(PlateTilt(x=0.09),)), START, BALLS)


@pytest.mark.parametrize("share", [0.01, 0.3, 0.6])
def test_a_slide_is_followed_until_its_goal(share):
    run = slide_by_hand(START[0], [0.0, 1.0])
    goal = share * run.t[-1]
    ((_, step),) = propagate(BallStates(BENT, BALLS[:1], START[:1], np.array([np.inf])), np.array([goal]))
    assert step.durations[0] >= goal
    times = np.linspace(0, goal, 50)
    np.testing.assert_allclose(step.motion.at(times[None])[0, :, [0, 1, 3, 4]], run.sol(times)[:4], rtol=0, atol=1e-10)


def test_a_slide_that_ends_before_its_goal_after_all():
    """Friction that grows as the slip falls ends a slide in half of the time that its start promises."""
    model = Model(effects=(Stribeck(rise=5.0, slip=0.15),))
    whole = slides(model, START[:1], BALLS[:1])
    goal, ended = 1.01 * whole.durations, False
    state, now = START[:1], np.zeros(1)
    first = np.hypot(*contact_velocity(state, R)[0])
    assert first / (3.5 * 9.81 * model.laws("friction", 0.232, {"slip_speed": first})) > 1.5 * goal
    while not ended:
        ((_, step),) = propagate(BallStates.without_drilling(model, BALLS[:1], state), goal - now)
        state, now, ended = step.final_states, now + step.durations, step.ended[0]
    assert now == pytest.approx(whole.durations, rel=1e-9)
    np.testing.assert_allclose(state, whole.final_states, rtol=1e-9, atol=1e-12)


def test_waves_beyond_the_goal_cost_nothing(monkeypatch):
    """A slide of metres over waves of millimetres, which is seen for its first millimetres."""
    nodes, evaluate = [], PlateWaviness.push
    monkeypatch.setattr(PlateWaviness, "push", lambda *args: nodes.append(args[2].shape[1]) or evaluate(*args))
    state = START[:1] * np.array([1, 1, 1, 1, 1, 1, 300, 300, 0])
    balls = BallStates.without_drilling(Model(effects=(PlateWaviness(a=2e-6, wavelength=6e-3),)), BALLS[:1], state)
    ((_, step),) = propagate(balls, np.array([0.01]))
    assert step.durations == [0.01]
    assert np.hypot(*contact_velocity(step.final_states, R)[0]) > 10
    assert sum(nodes) < 1000


@pytest.mark.parametrize("goal", [0.05, 0.12, 0.3])
def test_a_slide_that_friction_cannot_end_has_a_motion_until_a_goal(goal):
    """Balls that slip along a slope on which the push exceeds friction, against scipy."""
    steep, states, now = Model(sliding_friction=0.01, effects=(PlateTilt(x=0.09),)), START.copy(), np.zeros(3)
    push = PlateTilt(x=0.09).push(np.zeros(2), 9.81)
    while (live := np.flatnonzero(now < goal)).size:
        balls = BallStates.without_drilling(steep, BALLS[live], states[live])
        for units, step in propagate(balls, goal - now[live]):
            states[live[units]] = step.final_states
            now[live[units]] += step.durations

    def right(_, y):
        friction = -0.01 * 9.81 * y[4:] / np.hypot(*y[4:])
        return [*y[2:4], *(friction + push), *(3.5 * friction + push)]

    for first, last in zip(START, states, strict=True):
        start = [*first[[0, 1, 3, 4]], *contact_velocity(first, R)]
        by_hand = solve_ivp(right, (0.0, goal), start, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
        np.testing.assert_allclose(last[[0, 1, 3, 4]], by_hand[:4], rtol=0, atol=1e-10)


def test_goals_of_some_slides_change_nothing_for_those_without():
    """Slides along a steep slope: friction cannot end the one with a goal, and ends those that slip uphill."""
    steep = Model(sliding_friction=0.01, effects=(PlateTilt(x=0.09),))
    states = np.zeros((3, 9))
    states[:, 2], states[:, 7] = R, np.array([-0.5, 0.5, 0.7]) / R
    alone = slides(steep, states[1:], BALLS[1:])
    steps = propagate(BallStates.without_drilling(steep, BALLS, states), np.array([0.1, np.inf, np.inf]))
    found = {int(unit): step[[row]] for units, step in steps for row, unit in enumerate(units)}
    assert found[0].durations == [0.1]
    for row, unit in enumerate((1, 2)):
        assert found[unit].ended
        np.testing.assert_allclose(found[unit].final_states[0], alone.final_states[row], rtol=1e-12, atol=1e-12)


@pytest.mark.filterwarnings("error")
def test_a_slide_without_a_goal_that_friction_cannot_end_says_so_beside_others():
    steep = Model(sliding_friction=0.01, effects=(PlateTilt(x=0.09),))
    with pytest.raises(ValueError, match="does not end the slide"):
        list(propagate(BallStates.without_drilling(steep, BALLS, START), np.array([0.1, np.inf, np.inf])))


@pytest.mark.parametrize(
    ("states", "each", "name"),
    [
        (START[:2] + np.array([[0.0] * 9, [0.5, *[0.0] * 8]]), 2, "two balls that push each other"),
        (ROLLS[:1], 1, "a roll"),
        (ROLLS[:1] + np.array([0, 0, 0.01, 0, 0, 0.1, 0, 0, 0]), 1, "a flight"),
        (START[:1], 1, "a slide"),
    ],
)
def test_a_motion_without_a_step_is_called_by_its_name(states, each, name, monkeypatch):
    run = PhaseIntegrator.run

    def fail(self):
        step = run(self)
        return dataclasses.replace(step, valid=np.zeros_like(step.valid))

    monkeypatch.setattr(PhaseIntegrator, "run", fail)
    model = Model(effects=(PlateTilt(x=1e-3),))
    balls = BallStates(model, BALLS[: len(states)], states, np.full(len(states), np.inf), each)
    with pytest.raises(ValueError, match=f"^{name} could not be followed"):
        list(propagate(balls, np.array([0.01])))


def pieced(pieces, times):
    """States (m, 9) of one ball at times (m,)."""
    out = np.full((len(times), 9), np.nan)
    for led in pieces:
        a, b = sorted((led.begins[0], led.begins[0] + led.durations[0]))
        here = (times >= a - 1e-15) & (times <= b + 1e-15)
        out[here] = led.at(times[None, here])[0]
    return out


@pytest.mark.parametrize("until", [0.8, -0.4])
@pytest.mark.parametrize("k", [0, 1])
def test_a_roll_with_everything_bent_both_ways_in_time(until, k):
    if until > 0:
        pieces, ends, _ = rolls(BENT, ROLLS[k : k + 1], until)
        assert ends == pytest.approx(until, abs=1e-15)
    else:
        pieces = [
            led
            for _, led in propagate_back(
                BallStates.without_drilling(BENT, TWO[:1], ROLLS[k : k + 1]), np.zeros(1), np.array([until])
            )
        ]
    times = np.linspace(0, 1, 60) * until
    states, run = pieced(pieces, times), roll_by_hand(ROLLS[k], 0.0, until)
    np.testing.assert_allclose(states[:, [0, 1, 3, 4]], run.sol(times).T, rtol=0, atol=1e-11)
    np.testing.assert_allclose(contact_velocity(states, R), 0, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(states[:, 8], ROLLS[k, 8])


def test_a_roll_unbent_is_the_closed_form():
    times = np.linspace(0, 3, 40)
    for k in (0, 1):
        found = pieced(rolls(Model(), ROLLS[k : k + 1], 3.0)[0], times)
        np.testing.assert_allclose(found, roll(ROLLS[k], R, 0.135, 0.0103, times), rtol=1e-12, atol=1e-14)


def test_a_roll_stops_on_the_dot():
    start = rolling_state(np.zeros((1, 2)), np.array([[0.03, 0.04]]), 0.0, R)
    pieces, stop, last = rolls(Model(), start, 20.0)
    assert stop == pytest.approx(np.log1p(0.135 * 0.05 / 0.0103) / 0.135, abs=1e-11)
    np.testing.assert_allclose(last[0, 3:], 0, rtol=0, atol=1e-15)
    back_then = np.geomspace(1e-8, 1e-3, 50)
    late = pieced(pieces, stop - back_then)
    np.testing.assert_allclose(np.hypot(*late[:, 3:5].T), 0.0103 * back_then, rtol=2e-4)
    left = 0.0103 * back_then[:, None] ** 2 / 2 * [0.6, 0.8]
    np.testing.assert_allclose(last[0, :2] - late[:, :2], left, rtol=2e-4, atol=1e-16)


def test_a_roll_slower_than_the_slowest():
    start = rolling_state(np.zeros((1, 2)), np.array([[5e-8, 0.0]]), 0.0, R)
    _, _, last = rolls(BENT, start, 1.0)
    assert np.isfinite(last).all()


def test_a_flight_is_pushed_in_full_and_loses_nothing():
    start = ROLLS.copy()
    start[:, 5] = 9.81 * 0.025
    ((_, way),) = propagate(BallStates.without_drilling(BENT, TWO, start), np.full(2, np.inf))
    np.testing.assert_allclose(way.durations, 0.05, rtol=1e-14)

    def right(_, y):
        return [*y[2:], *(0.5 * np.sin(300 * y[:2]) - 0.02 * y[2:])]

    for k in (0, 1):
        run = solve_ivp(right, (0, 0.05), start[k][[0, 1, 3, 4]], **TIGHT)
        times = np.tile(np.linspace(0, 0.05, 9), (2, 1))
        found = way.motion.at(times)[k][:, [0, 1, 3, 4]]
        np.testing.assert_allclose(found, run.sol(times[k]).T, rtol=0, atol=1e-12)
