"""Whole motions against the paper's equations, closed forms, and another integrator."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from synthcam.dynamics.kinematics import contact_velocity, rolling_state, rolling_velocity
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.effects.hop import Hop
from synthcam.effects.magnetic_attraction import MagneticAttraction
from synthcam.effects.plate_tilt import PlateTilt
from synthcam.effects.rolling_quadratic import RollingQuadratic
from synthcam.model import Model

R = Model().ball.radius
PAIR, ALONE = Model().bodies("ab"), Model().bodies("b")
G = 9.81
exact = pytest.approx
angle = st.floats(0, 2 * np.pi)
speed = st.floats(0.05, 0.6)
models = st.builds(
    Model,
    restitution=st.floats(0.5, 1),
    sliding_friction=st.floats(0.1, 0.4),
    spin_transfer=st.floats(0, 0.45),
    rolling_drag=st.just(0) | st.floats(1e-9, 0.3),
    rolling_decel=st.just(0) | st.floats(1e-9, 0.03),
)


def rolling(x, y, vx, vy):
    return rolling_state(np.array([x, y], float), np.array([vx, vy], float), 0.0, R)


def energy(states):
    return (states[..., 3:6] ** 2).sum((0, -1)) / 2 + 0.2 * R**2 * (states[..., 6:9] ** 2).sum((0, -1))


@given(models, speed, angle)
def test_head_on_is_the_papers(model, v0, heading):
    r, c, mu = model.restitution, model.spin_transfer, model.sliding_friction
    motion = solve(model, Launch.pair(PAIR, 0.1, v0, 0.0, heading, (0.001, -0.002)), 0.0, 0.4)
    d = np.array([np.cos(heading), np.sin(heading)])
    ratio = 5 / 2  # m R^2 / I
    v1f = v0 / (2 * (1 + ratio)) * ((1 + r) * ratio - 2 * c)
    v2f = v0 / (2 * (1 + ratio)) * (2 + (1 - r) * ratio - 2 * c)
    tau1 = ((1 + r) / 2 + c) / ((1 + ratio) * mu * G) * v0
    tau2 = ((1 + r) / 2 - c) / ((1 + ratio) * mu * G) * v0
    for ball, (final, tau) in enumerate(((v1f, tau1), (v2f, tau2))):
        end = motion.first("slide_end", ball)
        assert end.after[0, 3:5] @ d == exact(final, rel=1e-12)
        assert end.t - 0.1 == exact(tau, rel=1e-12, abs=1e-16)  # 0.1's own last bit
    spin = motion.first("contact").after[:, 6:8] @ np.array([-d[1], d[0]]) * R / v0
    np.testing.assert_allclose(spin, [-c, 1 - c], rtol=0, atol=1e-12)


@given(models, speed, st.floats(-0.9, 0.9), angle)
def test_what_friction_at_the_plate_cannot_change(model, v0, b, heading):
    motion = solve(model, Launch.pair(PAIR, 0.1, v0, b, heading, (0, 0)), 0.0, 0.2)
    hit = motion.first("contact")
    push = np.zeros(2)
    for ball in (0, 1):
        end = motion.first("slide_end", ball)
        np.testing.assert_allclose(end.after[0, 3:5], rolling_velocity(hit.after[ball], R), rtol=0, atol=1e-12 * v0)
        np.testing.assert_allclose(contact_velocity(end.after[0], R), 0, rtol=0, atol=1e-12 * v0)
        np.testing.assert_allclose(end.before[0], end.after[0], rtol=0, atol=1e-11 * v0 / R)
        times = np.linspace(hit.t, end.t, 7)
        inside = motion.at(times)[ball]
        np.testing.assert_allclose(rolling_velocity(inside, R), end.after[[0] * 7, 3:5], rtol=0, atol=1e-12 * v0)
        u = contact_velocity(hit.after[ball], R)
        push += model.sliding_friction * G * (end.t - hit.t) * u / np.hypot(*u)
    finals = sum(motion.first("slide_end", ball).after[0, 3:5] for ball in (0, 1))
    start = v0 * np.array([np.cos(heading), np.sin(heading)])
    np.testing.assert_allclose(finals, start - push, rtol=0, atol=1e-12 * v0)


@given(models, speed, st.floats(-0.9, 0.9))
@settings(max_examples=30)
def test_energy_never_rises(model, v0, b):
    motion = solve(model, Launch.pair(PAIR, 0.1, v0, b, 0.0, (0, 0)), 0.0, 0.3)
    times = np.sort([*np.linspace(0, 0.3, 300), *(e.t for e in motion.events if e.t <= 0.3)])
    assert np.all(np.diff(energy(motion.at(times))) <= 1e-13 * v0**2)


@given(st.floats(-0.999, 0.999), speed, angle, st.floats(1e-4, 0.05))
def test_the_instant_of_contact_on_straight_lines(b, v, heading, away):
    model = Model(rolling_drag=0, rolling_decel=0)
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    start = -away - 2 * R * np.sqrt(1 - b * b)
    launch = Launch(0.0, np.stack([rolling(0, 0, 0, 0), rolling(*turn @ [start, 2 * R * b], *turn @ [v, 0])]), PAIR)
    hit = solve(model, launch, 0.0, 2.0).first("contact")
    assert hit.t == exact(away / v, rel=1e-12, abs=1e-12 * R / v / np.sqrt(1 - b * b))
    assert np.hypot(*(hit.before[0] - hit.before[1])[:2]) == exact(2 * R, rel=1e-11)


@pytest.mark.parametrize(("offset", "hits"), [(1 - 1e-9, True), (1 + 1e-9, False), (1.5, False), (-1 + 1e-9, True)])
@pytest.mark.parametrize("drag", [0.0, 0.135])
def test_a_graze_and_a_near_miss(offset, hits, drag):
    launch = Launch(0.0, np.stack([rolling(0, 0, 0, 0), rolling(-0.02, 2 * R * offset, 0.3, 0)]), PAIR)
    motion = solve(Model(rolling_drag=drag, rolling_decel=0), launch, 0.0, 0.3)
    assert (motion.first("contact") is not None) == hits


@given(speed, speed, st.floats(0.1, 3.0), st.floats(-0.5, 0.5))
def test_two_that_move_meet_where_the_quadratic_says(v1, v2, crossing, b):
    rel = np.array([v2 - v1 * np.cos(crossing), -v1 * np.sin(crossing)])
    w = np.hypot(*rel)
    d = rel / w
    start = -(0.004 + 2 * R) * d + 2 * R * b * np.array([-d[1], d[0]])
    one = rolling(0, 0, v1 * np.cos(crossing), v1 * np.sin(crossing))
    launch = Launch(0.0, np.stack([one, rolling(*start, v2, 0)]), PAIR)
    hit = solve(Model(rolling_drag=0, rolling_decel=0), launch, 0.0, 1.0).first("contact")
    away = 0.004 + 2 * R - 2 * R * np.sqrt(1 - b * b)
    if w < 0.02:
        return
    assert hit.t == exact(away / w, rel=1e-11)
    assert hit.i == (1 if v1 > v2 else 0) or v1 == v2  # the slower is the target


def test_contact_of_a_ball_that_slows_down():
    launch = Launch(0.0, np.stack([rolling(0, 0, 0, 0), rolling(-0.02 - 2 * R, 0, 0.3, 0)]), PAIR)
    hit = solve(Model(rolling_decel=0, rolling_drag=2.0), launch, 0.0, 1.0).first("contact")
    assert hit.t == exact(-np.log(1 - 2.0 * 0.02 / 0.3) / 2.0, rel=1e-12)
    hit = solve(Model(rolling_decel=0.5, rolling_drag=0.0), launch, 0.0, 1.0).first("contact")
    assert hit.t == exact((0.3 - np.sqrt(0.09 - 2 * 0.5 * 0.02)) / 0.5, rel=1e-12)
    assert solve(Model(rolling_decel=3, rolling_drag=0), launch, 0.0, 1.0).first("contact") is None


def test_the_launch_says_what_the_contract_says():
    v0, b, heading, place = 0.3, -0.4, 1.1, np.array([0.01, 0.02])
    motion = solve(Model(), Launch.pair(PAIR, 0.1, v0, b, heading, place), 0.0, 0.2)
    hit = motion.first("contact")
    d = np.array([np.cos(heading), np.sin(heading)])
    apart = hit.before[1, :2] - hit.before[0, :2]
    assert hit.t == exact(0.1, abs=1e-15)
    assert (d[0] * apart[1] - d[1] * apart[0]) / (2 * R) == exact(b, rel=1e-12)
    np.testing.assert_allclose(hit.n, -apart / (2 * R), rtol=0, atol=1e-12)
    np.testing.assert_allclose(hit.before[:, :2].mean(0), place, rtol=0, atol=1e-15)
    np.testing.assert_allclose(hit.before[:, 3:5], [[0, 0], v0 * d], rtol=0, atol=1e-12)
    past = solve(Model(), Launch(0.0, motion.at(0.0)[:, 0], PAIR), 0.0, 0.2)
    times = np.linspace(0, 0.2, 40)
    np.testing.assert_allclose(past.at(times), motion.at(times), rtol=1e-8, atol=1e-8)
    assert past.first("contact").t == exact(hit.t, rel=1e-11)


@pytest.mark.parametrize(("drag", "decel"), [(0.135, 0.0103), (0.0, 0.0103), (1e-9, 0.0103), (3.0, 0.5)])
def test_a_rolling_ball_stops_in_finite_time(drag, decel):
    motion = solve(Model(rolling_drag=drag, rolling_decel=decel), Launch.single(ALONE, 0, 0.1, 0.4, (0, 0)), 0, 20)
    stop = motion.first("stop")
    time = np.log1p(drag * 0.1 / decel) / drag if drag > 1e-6 else 0.1 / decel
    path = (0.1 - decel * time) / drag if drag > 1e-6 else 0.1**2 / (2 * decel)
    assert stop.t == exact(time, rel=1e-7 if drag == 1e-9 else 1e-12)
    assert np.hypot(*stop.after[0, :2]) == exact(path, rel=1e-7 if drag == 1e-9 else 1e-12)
    assert not motion.at(20.0)[0, 0, 3:].any()
    assert motion.motion([0, time / 2, time + 1e-9, 20]).tolist() == [["roll", "roll", "rest", "rest"]]


@pytest.mark.parametrize("effects", [(), (RollingQuadratic(K=1e-9),)])
def test_without_decel_it_never_stops(effects):
    launch = Launch.single(ALONE, 0, 0.1, 0.0, (0, 0))
    coasting = solve(Model(rolling_decel=0, effects=effects), launch, 0, 30)
    assert coasting.events == ()
    assert coasting.at(30.0)[0, 0, 3] == exact(0.1 * np.exp(-0.135 * 30), rel=1e-7)
    free = solve(Model(rolling_decel=0, rolling_drag=0, effects=effects), launch, 0, 30)
    assert free.at(30.0)[0, 0, [0, 3]] == exact([3.0, 0.1], rel=1e-7)


def test_one_after_the_other_in_a_row():
    """The middle ball, struck, slides 1 mm and strikes the third: momentum passes on, order is kept."""
    gap = 1e-3
    states = [rolling(0, 0, 0, 0), rolling(2 * R + gap, 0, 0, 0), rolling(-2 * R - gap, 0, 0.4, 0)]
    motion = solve(Model(), Launch(0.0, np.stack(states), Model().bodies("abb")), 0.0, 1.0)
    contacts = [(e.i, e.j) for e in motion.events if e.kind == "contact"]
    assert contacts[:2] == [(0, 2), (1, 0)]
    times = np.linspace(0, 1, 500)
    x = motion.at(times)[:, :, 0]
    assert np.all(x[0] - x[2] > 2 * R * (1 - 1e-9))
    assert np.all(x[1] - x[0] > 2 * R * (1 - 1e-9))
    assert np.all(np.diff(energy(motion.at(times))) <= 1e-15)
    pair = solve(Model(), Launch(0.0, np.stack([states[0], states[2]]), PAIR), 0.0, 1.0)
    early = times < motion.events[1].t
    np.testing.assert_array_equal(motion.at(times[early])[[0, 2]], pair.at(times[early]))


def test_a_lasting_contact_is_refused_not_looped_over():
    """In a touching row the struck ball stops against the striker, whose spin then presses on."""
    states = [rolling(0, 0, 0, 0), rolling(2 * R, 0, 0, 0), rolling(-0.01, 0, 0.4, 0)]
    launch = Launch(0.0, np.stack(states), Model().bodies("abb"))
    with pytest.raises(ValueError, match="stay in contact"):
        solve(Model(spin_transfer=0, restitution=1), launch, 0.0, 0.3)


def sliding_tilt(side):
    """Along the slope, head-on: uniform accelerations until the slide ends."""
    tilt, v0, mu = 1e-3, 0.3, Model().sliding_friction
    model = Model(effects=(PlateTilt(x=side * tilt),))
    motion = solve(model, Launch.pair(PAIR, 0.0, v0, 0.0, 0.0, (0, 0)), 0.0, 0.2)
    pull = side * G * np.sin(tilt)
    return motion, motion.first("contact").after, pull, mu


@pytest.mark.parametrize("side", [1, -1])
def test_tilt_along_the_slope_is_uniform(side):
    motion, after, pull, mu = sliding_tilt(side)
    for ball in (0, 1):
        u = contact_velocity(after[ball], R)[0]
        end = motion.first("slide_end", ball)
        tau = abs(u) / (3.5 * mu * G - np.sign(u) * pull)
        assert end.t == exact(tau, rel=1e-9)
        a = pull - np.sign(u) * mu * G
        assert end.after[0, 3] == exact(after[ball, 3] + a * tau, rel=1e-9)
        times = np.linspace(0, tau, 9)
        x = after[ball, 0] + after[ball, 3] * times + a * times**2 / 2
        np.testing.assert_allclose(motion.at(times)[ball, :, 0], x, rtol=0, atol=1e-12)


def test_a_tilted_plate_gives_a_roller_five_sevenths():
    model = Model(rolling_drag=0, rolling_decel=0, effects=(PlateTilt(x=2e-3, y=-1e-3),))
    motion = solve(model, Launch.single(ALONE, 0, 0.2, 0.3, (0, 0)), 0.0, 0.5)
    times = np.linspace(0, 0.5, 11)
    v = 0.2 * np.array([np.cos(0.3), np.sin(0.3)])
    a = 5 / 7 * G * np.sin([2e-3, -1e-3])
    np.testing.assert_allclose(
        motion.at(times)[0, :, :2], v * times[:, None] + a * times[:, None] ** 2 / 2, rtol=0, atol=1e-14
    )


def test_a_ball_that_stops_uphill_rolls_back():
    tilt, decel, v0 = 0.01, 0.02, 0.1
    model = Model(rolling_drag=0, rolling_decel=decel, effects=(PlateTilt(x=-tilt),))
    motion = solve(model, Launch.single(ALONE, 0.0, v0, 0.0, (0, 0)), 0.0, 4.0)
    fall = 5 / 7 * G * np.sin(tilt)
    top, height = v0 / (fall + decel), v0**2 / (2 * (fall + decel))
    assert [e.kind for e in motion.events] == ["stop", "start"]
    assert [e.t for e in motion.events] == exact([top, top], abs=1e-9)
    times = np.linspace(top, 4.0, 30)
    down = height - (fall - decel) * (times - top) ** 2 / 2
    np.testing.assert_allclose(motion.at(times)[0, :, 0], down, rtol=0, atol=2e-6)  # pushed off at 2e-7 m/s
    np.testing.assert_allclose(motion.at(top / 2)[0, 0, 0], 0.75 * height, rtol=1e-9)


@pytest.mark.parametrize("K", [0.05, 2.0])
def test_quadratic_loss_alone(K):
    model = Model(rolling_drag=0, rolling_decel=0, effects=(RollingQuadratic(K=K),))
    motion = solve(model, Launch.single(ALONE, 0.2, 0.3, 1.0, (0, 0)), 0.0, 3.0)
    t = np.linspace(0, 3, 20)
    states = motion.at(t)[0]
    np.testing.assert_allclose(np.hypot(*states[:, 3:5].T), 0.3 / (1 + K * 0.3 * (t - 0.2)), rtol=1e-12)
    path = np.log1p(K * 0.3 * (t - 0.2)) / K
    np.testing.assert_allclose(states[:, :2] @ [np.cos(1), np.sin(1)], path, rtol=0, atol=1e-13)


def by_hand(model, push, loss, state, t0, t1, until):
    """The raw equations of motion by scipy: (time, state) where the slide ends or at `until`."""

    def slide(_, y):
        u = np.array([y[2] - R * y[5], y[3] + R * y[4]])
        f = -model.sliding_friction * G * u / np.hypot(*u)
        return [y[2], y[3], *(f + push), 2.5 / R * f[1], -2.5 / R * f[0]]

    def slip(_, y):
        return np.hypot(y[2] - R * y[5], y[3] + R * y[4]) - 1e-8

    def roll(_, y):
        v = y[2:4]
        return [*v, *(5 / 7 * push - loss(np.hypot(*v)) * v / np.hypot(*v))]

    slip.terminal = True
    tight = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14}
    one = solve_ivp(slide, (t0, t1), state[[0, 1, 3, 4, 6, 7]], events=slip, **tight)
    y = one.y[:, -1]
    u = np.array([y[2] - R * y[5], y[3] + R * y[4]])
    two = solve_ivp(roll, (one.t[-1], until), [*y[:2], *(y[2:4] - 2 / 7 * u)], **tight)
    return one.t[-1], two.y[:, -1]


def test_tilt_and_quadratic_loss_in_an_oblique_collision():
    model = Model(effects=(PlateTilt(x=-0.9e-3, y=0.5e-3), RollingQuadratic(K=0.3)))
    motion = solve(model, Launch.pair(PAIR, 0.0, 0.4, 0.35, 2.0, (0, 0)), 0.0, 0.4)
    push = G * np.sin([-0.9e-3, 0.5e-3])
    for ball in (0, 1):
        start = motion.first("contact").after[ball]
        end, last = by_hand(model, push, lambda v: 0.135 * v + 0.0103 + 0.3 * v * v, start, 0.0, 0.3, 0.4)
        assert motion.first("slide_end", ball).t == exact(end, abs=3e-9)
        np.testing.assert_allclose(motion.at(0.4)[ball, 0, [0, 1, 3, 4]], last, rtol=0, atol=1e-9)


@pytest.mark.parametrize("strength", [1e-5, 1e-8, 1e-11])
def test_numerical_legs_become_the_closed_form(strength):
    launch = Launch(0.0, np.stack([rolling(0, 0, 0, 0), rolling(-0.01, 7e-4, 0.3, 0)]), PAIR)
    bent = Model(effects=(PlateTilt(x=strength), RollingQuadratic(K=strength)))
    base, near = solve(Model(), launch, 0.0, 12.0), solve(bent, launch, 0.0, 12.0)
    times = np.linspace(0, 1, 200)
    np.testing.assert_allclose(near.at(times)[..., :6], base.at(times)[..., :6], rtol=0, atol=10 * strength + 1e-14)
    assert [e.kind for e in near.events] == [e.kind for e in base.events]
    for a, b in zip(near.events, base.events, strict=True):
        if a.kind == "stop":  # at 5 s they lean on the tilt a thousandfold
            assert abs(a.t - b.t) < 4e3 * strength + 1e-9
        else:
            assert abs(a.t - b.t) < 0.1 * strength + 1e-12


def test_a_curved_roll_stops_when_scipy_says():
    tilt = np.array([-1e-3, 0.5e-3])
    motion = solve(Model(effects=(PlateTilt(*tilt),)), Launch.single(ALONE, 0.0, 0.05, 0.0, (0, 0)), 0.0, 6.0)

    def roll(_, y):
        s = np.hypot(*y[2:])
        return [*y[2:], *(5 / 7 * G * np.sin(tilt) - (0.135 * s + 0.0103) / s * y[2:])]

    def slow(_, y):
        return np.hypot(*y[2:]) - 1e-7

    slow.terminal = True
    run = solve_ivp(roll, (0, 6), [0, 0, 0.05, 0], method="DOP853", rtol=1e-12, atol=1e-15, events=slow)
    left = 1e-7 / (0.0103 - 5 / 7 * G * np.hypot(*np.sin(tilt)))
    stop = motion.first("stop")
    assert 0 < stop.t - run.t[-1] <= 1.01 * left
    np.testing.assert_allclose(stop.after[0, :2], run.y[:2, -1], rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ("model", "launch", "message"),
    [
        (Model(effects=(PlateTilt(x=2e-3),)), Launch.pair(PAIR, 0.1, 0.3, 0, 0, (0, 0)), "cannot rest"),
        (Model(effects=(PlateTilt(x=0.05),)), Launch.single(ALONE, 0.6, 0.1, 0, (0, 0)), "no past before"),
        (Model(sliding_friction=1e-3, effects=(PlateTilt(x=0.09),)), "sliding", "does not end"),
        (Model(sliding_friction=0.0), Launch.pair(PAIR, 0.1, 0.3, 0, 0, (0, 0)), "does not end the slide"),
        (Model(restitution=0.0), Launch.pair(PAIR, 0.1, 0.3, 0, 0, (0, 0)), "stay in contact"),
        (Model(restitution=0.05), Launch.pair(PAIR, 0.1, 0.3, 0, 0, (0, 0)), "stay in contact"),
        (Model(), Launch(0.0, np.stack([rolling(0, 0, 0, 0), rolling(R, 0, 0.1, 0)]), PAIR), "overlap"),
        (Model(), "flying past", "no past"),
    ],
)
def test_what_has_no_solution_says_so(model, launch, message):
    start = 0.0
    if isinstance(launch, str):
        state = rolling(0, 0, 0.3, 0)
        state[5 if "flying" in launch else 7] = 0.1 * ("flying" in launch)
        launch, start = Launch(0.0, state[None], ALONE), -0.1 if "past" in launch else 0.0
    with pytest.raises(ValueError, match=message):
        solve(model, launch, start, 0.7)


FIELD = MagneticAttraction(pull=0.01)


@pytest.mark.parametrize(
    ("model", "time", "start", "end", "message"),
    [
        (Model(), 1e300, 0.0, 0.4, "launch is at 1e\\+300 s: a motion is solved within 10000 s of 0"),
        (Model(), -np.inf, 0.0, 0.4, "launch is at -inf s"),
        (Model(), 0.1, 0.0, np.nan, "end is at nan s"),
        (Model(), 0.1, -1e5, 0.4, "start is at -100000 s"),
        (Model(), 100.0, 0.0, 0.4, "faster than 1000 m/s, 100 s earlier"),
        (Model(), 9000.0, 0.0, 0.4, "faster than 1000 m/s, 9000 s earlier"),
        (Model(effects=(PlateTilt(x=1e-4),)), 9000.0, 0.0, 0.4, "past of a ball does not end"),
        (Model(effects=(FIELD,)), -100.0, 0.0, 0.4, "push each other are followed for 60 s, not for 100.4 s"),
    ],
)
def test_the_far_past_and_future_are_refused(model, time, start, end, message):
    with pytest.raises(ValueError, match=message):
        solve(model, Launch.pair(PAIR, time, 0.3, 0.1, 0, (0, 0)), start, end)


def test_the_run_lasts_until_the_last_slide_ends():
    motion = solve(Model(), Launch.pair(PAIR, 0.1, 0.6, 0.2, 0.0, (0, 0)), 0.0, 0.11)
    assert motion.t1 == max(motion.first("slide_end", ball).t for ball in (0, 1)) > 0.11


def test_a_run_that_need_not_settle_ends_in_time_as_it_would_have_been_there():
    launch, times = Launch.pair(PAIR, 0.1, 0.6, 0.2, 0.0, (0, 0)), np.linspace(0, 0.3, 40)
    for friction in (0.05, 1e-4):
        model = Model(sliding_friction=friction)
        whole, part = solve(model, launch, 0.0, 0.3), solve(model, launch, 0.0, 0.3, finish_slides=False)
        assert part.t1 == 0.3 < whole.t1
        np.testing.assert_array_equal(part.at(times), whole.at(times))


def test_a_slow_catch_up_collides_again():
    """Head-on the striker overtakes the target where 5 r < 2."""
    for r, again in ((0.36, True), (0.42, False)):
        motion = solve(Model(restitution=r), Launch.pair(PAIR, 0.0, 0.3, 0, 0, (0, 0)), 0.0, 0.3)
        assert (len([e for e in motion.events if e.kind == "contact"]) > 1) == again


def test_a_ball_struck_in_flight_goes_on_from_where_it_is():
    """Found by random runs: pressed down in the air, it falls; it is not on the plate at once."""
    gap = 1e-3
    states = [rolling(0, 0, 0, 0), rolling(2 * R + gap, 0.5e-3, 0, 0), rolling(-2 * R - gap, 0, 0.5, 0)]
    states[1][4:8] = [-0.2, 0.0, 0.2 / R, 0.0]
    trio = Model().bodies("bbb")
    model = Model(effects=(Hop(share=1.0, bounce=0.6),), spin_transfer=0.35)
    motion = solve(model, Launch(0.0, np.stack(states), trio), 0.0, 0.3)
    times = np.unique(np.concatenate([np.linspace(0, 0.3, 3000), [e.t for e in motion.events]]))
    z = motion.at(times)[..., 2]
    assert np.all(z >= R * (1 - 1e-12))
    assert np.abs(np.diff(z, axis=1)).max() < 2e-4 * 0.3  # no leap
    struck = [e for e in motion.events if e.kind == "contact" and e.before[:, 2].max() > R + 1e-6]
    assert struck
    height = model.ball.mass * G * (z - R).sum(axis=0)
    assert np.all(np.diff(model.ball.mass * energy(motion.at(times)) + height) <= 1e-13 * model.ball.mass)
