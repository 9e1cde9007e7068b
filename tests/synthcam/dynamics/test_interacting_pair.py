"""Balls that push each other, against a plain integration of both by scipy, their energy book, and plain limits."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from synthcam.dynamics.batch import solve_collisions
from synthcam.dynamics.kinematics import rolling_state
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.effects.drilling_spin import DrillingSpin
from synthcam.model import Model
from synthcam.scene.ground_truth import make_true_scalars

R, DECEL, DRAG = 1.19e-3, 0.0103, 0.135
T_C = 0.1
LAUNCHED = np.array([[0.003, -0.002, T_C, 0.12, 0.7, -0.676]])


def launched(pull, v0, b, start=0.0, end=0.4, **others):
    model = Model().replace({"magnetic_attraction.pull": pull} | others)
    launch = Launch.pair(model.bodies("ab"), T_C, v0, b, 0.7, (0.003, -0.002))
    return model, launch, solve(model, launch, start, end)


def pull_on(pull, gap):
    """3 mu0 m^2/(2 pi r^4), towards `gap`."""
    r = np.hypot(*gap)
    return pull * (2 * R / r) ** 4 * gap / r


def forward(pull, states):
    """From a ball at rest and one that rolls, by hand to their contact: when, and x, y, vx, vy of both."""

    def loss(v, towards):
        speed = np.hypot(*v)
        way = v / speed if speed > 1e-9 else towards / np.hypot(*towards)  # just let go
        return (DRAG * speed + DECEL) * way

    def right(held):
        def rates(_, y):
            push = 5 / 7 * pull_on(pull, y[4:6] - y[:2])
            one = np.zeros(4) if held else np.concatenate([y[2:4], push - loss(y[2:4], push)])
            return np.concatenate([one, y[6:8], -push - loss(y[6:8], y[6:8])])

        return rates

    def pulled_off(_, y):
        return 5 / 7 * np.hypot(*pull_on(pull, y[4:6] - y[:2])) - DECEL

    def touch(_, y):
        return np.hypot(*(y[4:6] - y[:2])) - 2 * R

    pulled_off.terminal = touch.terminal = True
    how = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-16}
    first = solve_ivp(right(True), (0, 1), states[:, [0, 1, 3, 4]].ravel(), events=(pulled_off, touch), **how)
    if first.t_events[1].size:
        return first.t[-1], first.y[:, -1].reshape(2, 4), None
    then = solve_ivp(right(False), (first.t[-1], 1), first.y[:, -1], events=touch, max_step=1e-3, **how)
    return then.t[-1], then.y[:, -1].reshape(2, 4), first.t[-1]


@pytest.mark.parametrize(
    ("pull", "v0", "b"), [(0.03, 0.3, 0.0), (0.1, 0.3, 0.5), (0.4, 0.15, -0.7), (-0.2, 0.2, 0.4), (0.012, 0.3, 0.2)]
)
def test_the_approach_led_forward_by_scipy(pull, v0, b):
    _, launch, motion = launched(pull, v0, b)
    hit = motion.first("contact")
    when, states, onset = forward(pull, motion.at(0.0)[:, 0])
    assert when == pytest.approx(T_C, abs=1e-10)
    np.testing.assert_allclose(states[:, :2], launch.states[:, :2], rtol=0, atol=2e-11)
    np.testing.assert_allclose(states[:, :2], hit.before[:, :2], rtol=0, atol=2e-11)
    np.testing.assert_allclose(states[:, 2:], hit.before[:, 3:5], rtol=0, atol=1e-9)
    np.testing.assert_allclose(hit.before[1], launch.states[1], rtol=0, atol=1e-12)  # the striker is as stated
    starts = [e for e in motion.events if e.kind == "start"]
    assert len(starts) == (onset is not None)
    if onset is not None:
        assert starts[0].t == pytest.approx(onset, abs=1e-9)
        assert starts[0].i == 0
        assert np.hypot(*hit.before[0, 3:5]) > 1e-6
        towards = (hit.before[1] - hit.before[0])[:2] * np.sign(pull)
        assert hit.before[0, 3:5] @ towards > 0


def test_the_target_stays_where_friction_holds_it():
    """5/7 of the pull is under rolling_decel as long as the balls do not touch."""
    _, launch, motion = launched(0.0144, 0.3, 0.3)
    assert not [e for e in motion.events if e.kind == "start"]
    np.testing.assert_array_equal(motion.first("contact").before[0], launch.states[0])


def test_what_led_to_a_contact_does_not_hang_on_when_the_run_starts():
    whole, late, after = (launched(0.2, 0.2, 0.4, start)[2] for start in (0.0, T_C - 1e-3, T_C))
    times = np.linspace(T_C, 0.4, 20)
    for motion in (late, after):
        np.testing.assert_allclose(motion.at(times), whole.at(times), rtol=0, atol=1e-9)
        np.testing.assert_allclose(motion.at(times)[..., :3], whole.at(times)[..., :3], rtol=0, atol=1e-12)
    near = np.linspace(T_C - 1e-3, T_C, 5)
    np.testing.assert_allclose(late.at(near)[..., :3], whole.at(near)[..., :3], rtol=0, atol=1e-13)


def test_truth_tells_of_the_balls_relative_speed():
    model, launch, motion = launched(0.4, 0.15, 0.6)
    before = motion.first("contact").before
    row = make_true_scalars(model, launch, motion)
    assert row["v0"] == pytest.approx(np.hypot(*(before[1] - before[0])[3:5]), rel=1e-14)
    assert row["v0"] - 0.15 > 1e-4  # the target came to meet the striker
    assert row["r"] == pytest.approx(model.restitution, abs=1e-12)


@pytest.mark.parametrize("pull", [0.3, -0.3])
def test_the_energy_book(pull):
    """Without friction of sliding what the balls lose is their rolling loss; with it, nothing is ever gained."""
    model, _, motion = launched(pull, 0.2, 0.5)
    mass = model.ball.mass
    times = np.unique(np.concatenate([np.linspace(0, 0.4, 4000), [e.t for e in motion.events]]))
    states = motion.at(times)
    gap = np.hypot(*(states[1] - states[0])[:, :2].T)
    kinetic = mass * ((states[..., 3:6] ** 2).sum(-1) / 2 + 0.2 * R**2 * (states[..., 6:9] ** 2).sum(-1)).sum(axis=0)
    energy = kinetic - mass * pull * (2 * R) ** 4 / (3 * gap**3)
    assert np.diff(energy).max() < 1e-14 * energy[0]
    assert np.ptp(energy - kinetic) > 1e-3 * energy[0]  # the pull matters here
    spent = 0.0
    spans = np.array([0.0, *(e.t for e in motion.events if e.t < T_C), T_C])
    for a, b in itertools.pairwise(spans):
        nodes, weights = np.polynomial.legendre.leggauss(60)
        v = motion.at(np.clip((a + b) / 2 + (b - a) / 2 * nodes, a, b - 1e-15))[..., 3:5]
        speed = np.hypot(v[..., 0], v[..., 1])
        spent += 1.4 * mass * (b - a) / 2 * float(((DRAG * speed + DECEL) * speed * weights).sum())
    before = motion.first("contact").before
    last = 0.7 * mass * (before[:, 3:5] ** 2).sum() - mass * pull * 2 * R / 3
    assert energy[0] - last == pytest.approx(spent, rel=1e-9)


@pytest.mark.parametrize("pull", [1e-6, 1e-9])
def test_without_a_pull_the_closed_form_is_left(pull):
    times = np.linspace(0, 0.4, 81)
    near, base = (launched(p, 0.3, 0.4)[2].at(times) for p in (pull, 0.0))
    np.testing.assert_allclose(near[..., :2], base[..., :2], rtol=0, atol=0.1 * pull + 1e-13)


SPIN, TILT, HOP = {"drilling_spin.a": 2e-5}, {"plate_tilt.x": 1e-3}, {"hop.share": 1.0, "hop.bounce": 0.4}
CROWDS = [
    (0.3, 0.55, SPIN | TILT),
    (0.6, 0.55, SPIN | TILT | {"mass_mismatch.excess": 0.02}),
    (0.2, -0.8, SPIN | {"plate_tilt.y": -4e-4, "stribeck.rise": 0.3, "plate_waviness.a": 6e-7}),
    (0.4, 0.75, SPIN | TILT | HOP | {"adhesion.pull": 0.1}),
    (0.25, 0.3, HOP | TILT | {"eccentric_mass.c": 1e-6, "viscous_friction.k": 0.5}),
    (0.15, -0.5, {"air_drag.share": 1.0, "friction_anisotropy.c": 0.1, "ball_friction.share": 1.0}),
]


@pytest.mark.parametrize(
    ("v0", "b", "others"),
    [pytest.param(*case, marks=[pytest.mark.gate] * (2 <= k <= 4)) for k, case in enumerate(CROWDS)],
)
def test_without_a_pull_the_motion_with_other_effects_is_left(v0, b, others):
    """One solver goes over into the other: no jump, in places or in their derivative."""
    times = np.linspace(0, 0.4, 81)

    def run(pull):
        motion = launched(pull, v0, b, **others)[2]
        return motion.at(times)[..., :2], [e.t for e in motion.events if e.kind == "slide_end"]

    places, ends = run(0.0)
    for pull in (1e-12, 1e-9, -1e-6, 1e-6):
        near, then = run(pull)
        np.testing.assert_allclose(near, places, rtol=0, atol=0.1 * abs(pull) + 3e-11)
        np.testing.assert_allclose(then, ends, rtol=0, atol=0.1 * abs(pull) + 3e-9)
    step = 1e-4
    ahead, back = (run(step)[0] - places) / step, (places - run(-step)[0]) / step
    np.testing.assert_allclose(ahead, back, rtol=0, atol=3e-3 * np.abs(ahead).max())


def test_free_balls_at_rest_are_free():
    """States given at the start: a ball that rests is pulled off once the other is near enough, not before."""
    model = Model().replace({"magnetic_attraction.pull": 0.2})
    pair = model.bodies("ab")
    states = rolling_state(np.array([[0, 0], [-0.02, 0.5e-3]]), np.array([[0, 0], [0.2, 0]]), 0.0, pair.radius)
    motion = solve(model, Launch(0.0, states, pair), 0.0, 0.4)
    when, both, onset = forward(0.2, states)
    hit, start = motion.first("contact"), motion.first("start")
    assert (hit.t, start.t) == (pytest.approx(when, abs=1e-9), pytest.approx(onset, abs=1e-9))
    np.testing.assert_allclose(hit.before[:, :2], both[:, :2], rtol=0, atol=1e-10)
    # seen from its contact, the same run
    again = solve(model, Launch(hit.t, hit.before, pair), hit.t, 0.4)
    np.testing.assert_allclose(again.at(0.35)[..., :2], motion.at(0.35)[..., :2], rtol=0, atol=1e-9)


def test_a_ball_is_pulled_off_late_too():
    """Times so late that the last bit of the clock is 2 ps."""
    model = Model().replace({"magnetic_attraction.pull": 0.2})
    pair = model.bodies("ab")
    states = rolling_state(np.array([[0, 0], [-0.02, 0.5e-3]]), np.array([[0, 0], [0.2, 0]]), 0.0, pair.radius)
    early, late = (solve(model, Launch(t, states, pair), t, t + 0.4).first("start").t - t for t in (0.0, 9990.0))
    assert late == pytest.approx(early, abs=1e-9)


@pytest.mark.parametrize(
    ("b", "said"), [(0.9999, "pushed away"), (0.9996, "pushed away"), (0.99956, "stay in contact")]
)
def test_a_target_that_is_pushed_away_all_but_as_fast_as_it_is_chased_is_refused(b, said):
    model = Model().replace({"magnetic_attraction.pull": -0.3})
    with pytest.raises(ValueError, match=said):
        solve(model, Launch.pair(model.bodies("ab"), T_C, 0.1, b, 0.3, (0, 0)), 0.0, 0.4)
    with pytest.raises(ValueError, match=said):
        solve_collisions(model, np.array([[0, 0, T_C, 0.1, 0.3, b]]), 0.0, 0.4)


@pytest.mark.parametrize(
    ("pull", "v0"), [(0.1, 0.0063), pytest.param(0.3, 0.013, marks=pytest.mark.gate), (0.5, 0.0175)]
)
def test_a_striker_hardly_faster_than_the_pull_makes_it(pull, v0):
    """A start that is hard to find, against scipy's integration from well before the onset."""
    _, launch, motion = launched(pull, v0, 0.1, -0.4, T_C)
    when, states, onset = forward(pull, motion.at(-0.4)[:, 0])
    assert when - 0.4 == pytest.approx(T_C, abs=1e-7)
    assert motion.first("start").t == pytest.approx(onset - 0.4, abs=1e-8)
    np.testing.assert_allclose(states[:, :2], launch.states[:, :2], rtol=0, atol=1e-9)
    np.testing.assert_allclose(states[1, 2:], launch.states[1, 3:5], rtol=0, atol=1e-8)


def test_a_striker_that_the_pull_alone_outruns_is_refused():
    """Let go at rest where 5/7 of the pull is what holds them, the balls would meet faster than this one rolls."""
    pull, v0 = 0.3, 0.01
    gained = 5 / 7 * pull * 2 * R / 3  # of the square of each one's speed, from infinity
    lost = 2 * DECEL * R * (5 / 7 * pull / DECEL) ** 0.25  # at most
    assert v0**2 < gained - lost
    with pytest.raises(ValueError, match=r"at 0[.]01 m/s, is too slow"):
        launched(pull, v0, 0.0)


def test_two_that_roll_are_led_back_and_one_that_would_have_been_pulled_off_is_refused():
    model = Model().replace({"magnetic_attraction.pull": 0.1})
    pair = model.bodies("ab")
    places = np.array([[0, 0], [-0.012, 4e-3]])
    states = rolling_state(places, np.array([[0.05, 0.02], [0.1, -0.04]]), 0.0, pair.radius)
    motion = solve(model, Launch(T_C, states, pair), 0.0, T_C)
    again = solve(model, Launch(0.0, motion.at(0.0)[:, 0], pair), 0.0, T_C)
    times = np.linspace(0, T_C, 20)
    np.testing.assert_allclose(again.at(times)[..., :6], motion.at(times)[..., :6], rtol=0, atol=1e-11)
    np.testing.assert_allclose(again.at(T_C)[:, 0], states, rtol=0, atol=1e-8)
    with pytest.raises(ValueError, match="cannot rest before its launch"):
        solve(model, Launch(0.2, rolling_state(0.2 * places, np.zeros((2, 2)), 0.0, pair.radius), pair), 0.1, 0.2)
    gone = np.array([[0, 0], [0.02, 3e-3]])  # the one that rolls has passed the other, at 3 mm
    states = rolling_state(gone, np.array([[0, 0], [0.2, 0]]), 0.0, pair.radius)
    solve(model, Launch(0.2, states, pair), 0.19, 0.2)
    for start, at in ((0.0, gone), (0.19, gone * 0.15)):
        states = rolling_state(at, np.array([[0, 0], [0.2, 0]]), 0.0, pair.radius)
        with pytest.raises(ValueError, match="cannot rest before its launch"):
            solve(model, Launch(0.2, states, pair), start, 0.2)


@pytest.mark.parametrize("up", [1e-300, 1e-150, 1e-12])
def test_a_flight_however_short_is_followed(up):
    model = Model().replace({"magnetic_attraction.pull": 0.05})
    pair = model.bodies("ab")
    states = rolling_state(np.array([[0, 0], [0.01, 0]]), np.array([[0.1, 0], [0, 0]]), 0.0, pair.radius)
    plain = solve(model, Launch(0.0, states, pair), 0.0, 0.1)
    states[0, 5] = up
    motion = solve(model, Launch(0.0, states, pair), 0.0, 0.1)
    assert motion.events[0].kind == "land"
    assert motion.first("contact").t == pytest.approx(plain.first("contact").t, abs=1e-12)


def by_hand(pull, a, model):
    """Each ball drills and slides, slides or rolls, as `modes` tells: rates of (2, 9), raveled."""
    mu, g, law = model.sliding_friction, model.gravity, DrillingSpin(a)

    def rates(_, y, modes):
        y, out = y.reshape(2, 9), np.zeros((2, 9))
        for k, s in enumerate(y):
            push, out[k, :2] = pull_on(pull, y[1 - k, :2] - s[:2]), s[3:5]
            if modes[k] == "roll":
                speed = np.hypot(*s[3:5])
                out[k, 3:5] = 5 / 7 * push - (DRAG * speed + DECEL) * s[3:5] / speed
                continue
            u, spin = slip_of(s), s[8] * (modes[k] == "drill")
            slip = np.hypot(*u)
            fades = law.friction(mu, slip, spin)
            grip = fades * g * u / slip
            out[k, 3:5], out[k, 6:8] = push - grip, 2.5 / R * np.array([-grip[1], grip[0]])
            out[k, 8] = law.drilling(0.0, spin, slip, fades, g, R)
        return out.ravel()

    return rates


def slip_of(state):
    return state[3:5] + R * np.array([-state[7], state[6]])


@pytest.mark.parametrize(
    ("pull", "a"),
    [pytest.param(0.3, 5e-5, marks=pytest.mark.gate), (0.1, 2e-5), pytest.param(-0.2, 2e-6, marks=pytest.mark.gate)],
)
def test_a_slip_that_a_push_would_keep_creeping_ends(pull, a):
    """Friction F u/(u + c) fades while a ball spins, and the slip creeps: stiff equations, for scipy's Radau.

    The slide is over where friction is a tenth, or at twice the creeping slip; the rest ends as without a spin.
    """
    rates, how = by_hand(pull, a, Model()), {"method": "Radau", "rtol": 1e-10, "atol": 1e-13}
    _, _, motion = launched(pull, 0.12, -0.676, T_C, 0.5, **{"drilling_spin.a": a})
    t, y, modes, ends = T_C, motion.first("contact").after.ravel(), ["drill", "drill"], [np.nan, np.nan]
    grip, c = 3.5 * 0.232 * 9.81, 8 / (3 * np.pi) * a * np.abs(y.reshape(2, 9)[:, 8])
    late = c * np.sqrt(0.1**2 + 4 * (abs(pull) / (grip - abs(pull))) ** 2)
    while modes != ["roll", "roll"]:
        events = []
        for k in (0, 1):
            least = {"drill": late[k], "slide": 1e-9, "roll": -1.0}[modes[k]]
            events.append(lambda _, y, modes, k=k, least=least: np.hypot(*slip_of(y.reshape(2, 9)[k])) - least)
            events[-1].terminal = True
        run = solve_ivp(rates, (t, 0.5), y, args=(modes,), events=events, **how)
        k = [len(when) > 0 for when in run.t_events].index(True)
        t, y = run.t[-1], run.y[:, -1].copy()
        if modes[k] == "drill":
            on = solve_ivp(rates, (t, t + 0.01), y, args=(modes,), **how).y[:, -1].reshape(2, 9)
            assert np.hypot(*slip_of(on[k])) > 1e-3 * late[k]  # by itself the slip creeps on
            modes[k] = "slide"
        else:
            modes[k], ends[k] = "roll", t
        found = motion.at(t)[:, 0]
        np.testing.assert_allclose(found[:, :2], y.reshape(2, 9)[:, :2], rtol=0, atol=1e-10)
        np.testing.assert_allclose(found[:, 3:5], y.reshape(2, 9)[:, 3:5], rtol=0, atol=3e-9)
    assert ends == pytest.approx([motion.first("slide_end", k).t for k in (0, 1)], abs=2e-9)
    batch = solve_collisions(
        Model().replace({"drilling_spin.a": a, "magnetic_attraction.pull": pull}), LAUNCHED, T_C, 0.5
    )
    assert batch.slide_ends == pytest.approx([motion.first("slide_end", k).t for k in (0, 1)], abs=1e-10)


def test_strong_pulls_and_other_effects_in_the_batch():
    """As `solve`: what the batch leads in pieces of its own."""
    numbers = {"magnetic_attraction.pull": 0.1, "hop.share": 1.0, "hop.bounce": 0.5, "mass_mismatch.excess": 0.02}
    model = Model().replace(numbers | {"plate_tilt.x": 3e-4, "stribeck.rise": 0.2, "diameter_mismatch.excess": 1e-3})
    rows = np.array([[0, 0, T_C, 0.1, 1.0, 0.8], [0, 0, T_C, 0.5, 2.0, -0.3], [0, 0, T_C, 0.25, 4.0, 0.05]])
    batch, times = solve_collisions(model, rows, 0.0, 0.4, True), np.linspace(0, 0.4, 41)
    found = batch.at(times)
    for k, (x, y, t_c, v0, heading, b) in enumerate(rows):
        motion = solve(model, Launch.pair(model.bodies("ba"), t_c, v0, b, heading, (x, y)), 0.0, 0.4)
        np.testing.assert_allclose(found[:, k, :, :3], motion.at(times)[..., :3], rtol=0, atol=2e-12)


@pytest.mark.parametrize("more", [0.0, 1e-7, 2e-5, -3e-4])
def test_two_drilling_slides_that_end_all_but_together(more):
    """Each drills until its own slip is small, whatever the other does: no jump where a pull is added."""
    model = Model().replace({"drilling_spin.a": 2e-5})
    states = rolling_state(np.array([[0, 0], [0.01, 0]]), np.array([[-0.1, 0.02], [0.1, -0.02]]), 80.0, np.full(2, R))
    states[:, 7] += [90.0, -90.0 * (1 + more)]

    def run(pull):
        pulled = model.replace({"magnetic_attraction.pull": pull})
        return solve(pulled, Launch(0.0, states, model.bodies("ab")), 0.0, 0.3).at(np.linspace(0, 0.3, 61))[..., :2]

    np.testing.assert_allclose(run(1e-9), run(0.0), rtol=0, atol=3e-11)
