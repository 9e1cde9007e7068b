"""The hop against formulas, an event-driven motion written out here, and stiff contacts taken in small steps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from synthcam.dynamics.batch import solve_collisions
from synthcam.dynamics.contacts.impact import collide_pairs
from synthcam.dynamics.launch import Launch, launch_touching_pairs
from synthcam.dynamics.solve import solve
from synthcam.effects.ball_friction import BallFriction
from synthcam.effects.hop import Hop
from synthcam.model import Bodies, Model

R, G, MU, REST, C = 1.19e-3, 9.81, 0.232, 0.903, 5 / 14
PAIR = Model().bodies("ab")


def hopping(bounce, **numbers):
    return Model(effects=(Hop(share=1.0, bounce=bounce),), **({"spin_transfer": C} | numbers))


def run(model, v0, b=0.0, heading=0.0, end=0.3):
    return solve(model, Launch.pair(PAIR, 0.1, v0, b, heading, (0, 0)), 0.0, end)


@pytest.mark.parametrize("bounce", [0.0, 0.4])
@pytest.mark.parametrize("v0", [0.05, 0.2, 0.6])
def test_head_on_the_slides_last_as_the_formula_says(v0, bounce):
    motion = run(hopping(bounce), v0)
    for ball, sign in ((0, 1), (1, -1)):
        tau = v0 * ((1 + REST) / 2 + sign * C * (1 - 1.4 * MU)) / (3.5 * MU * G)
        assert motion.first("slide_end", ball).t - 0.1 == pytest.approx(tau, rel=1e-9)
        landings = [e for e in motion.events if e.kind == "land" and e.i == ball]
        assert landings
        assert landings[-1].t < 0.1 + tau  # the condition: the bounces end before rolling
    without = run(Model(spin_transfer=C), v0)
    assert without.first("slide_end", 1).t < motion.first("slide_end", 1).t - 1e-4  # the hop is seen


@pytest.mark.parametrize(("v0", "ms"), [(0.05, 1.5), (0.2, 5.8), (0.6, 17.5)])
def test_the_striker_flies(v0, ms):
    motion = run(hopping(0.0), v0)
    up = 0.4 * C * v0
    landing = motion.first("land", 1)
    assert landing.t - 0.1 == pytest.approx(2 * up / G, rel=1e-12)
    assert 1e3 * (landing.t - 0.1) == pytest.approx(ms, abs=0.05)
    times = np.linspace(0.1, landing.t, 9)[:-1]
    height = motion.at(times)[1, :, 2] - R
    np.testing.assert_allclose(height, up * (times - 0.1) - G * (times - 0.1) ** 2 / 2, rtol=0, atol=1e-16)
    assert motion.at((0.1 + landing.t) / 2)[1, 0, 2] - R == pytest.approx(up**2 / (2 * G), rel=1e-12)
    assert set(motion.motion(times)[1]) == {"fly"}
    np.testing.assert_array_equal(np.diff(motion.at(times)[1, :, 3]), 0)  # nothing rubs in the air


@given(st.floats(0.05, 0.6), st.floats(0, 0.9), st.floats(0, 0.45), st.floats(0.1, 0.4))
@settings(max_examples=40)
def test_just_after_the_targets_rebound(v0, bounce, c, mu):
    motion = run(hopping(bounce, spin_transfer=c, sliding_friction=mu), v0)
    hit = motion.first("contact")
    target = motion.at(hit.t)[0, 0]
    together = 3e-6 if bounce * 0.4 * c * v0 < 1e-7 else 1e-12  # so low a bounce is none of its own
    assert target[7] * R / v0 == pytest.approx(-c * (1 - mu * (1 + bounce)), abs=together)
    r = (target[3] - hit.after[1, 3]) / v0
    assert r == pytest.approx(REST - 0.4 * c * mu * (1 + bounce), abs=together)


@given(st.floats(0.05, 0.6), st.floats(-0.95, 0.95), st.floats(0, 6.3), st.floats(0, 0.9), st.floats(0, 0.45))
@settings(max_examples=40)
def test_final_velocities_know_nothing_of_the_hop(v0, b, heading, bounce, c):
    base, hop = (run(m, v0, b, heading) for m in (Model(spin_transfer=c), hopping(bounce, spin_transfer=c)))
    for ball in (0, 1):
        a, z = (m.first("slide_end", ball).after[0, 3:5] for m in (base, hop))
        np.testing.assert_allclose(z, a, rtol=0, atol=1e-12 * v0)


def bounced(slip, up, pressed, bounce, mu):
    """When a ball that slips, and leaves the plate at `up` or is pressed on it at `pressed`, rolls: event by event."""
    t, first = 0.0, True
    speed = np.hypot(*slip)
    while speed > 0:
        down = pressed if first else up
        if not first or pressed > 0:
            lost = 3.5 * mu * (1 + bounce) * down
            up = bounce * down
            speed -= lost
            if speed <= 0:
                return t
        first = False
        if up < 1e-13:
            return t + speed / (3.5 * mu * G)
        t += 2 * up / G
    return t


@given(st.floats(0.05, 0.6), st.floats(-0.95, 0.95), st.floats(0, 0.9), st.floats(0, 0.7), st.floats(0.1, 1.5))
@settings(max_examples=60)
def test_right_where_the_bounces_outlast_the_slip_too(v0, b, bounce, c, mu):
    motion = run(hopping(bounce, spin_transfer=c, sliding_friction=mu), v0, b, end=0.2)
    d = np.array([np.sqrt(1 - b * b), b])  # along n and t
    u_t = 0.4 * c * v0 * np.array([d[1], -1.0])  # of J: along t, and up for the striker
    kick = np.array([(1 + REST) / 2 * d[0] * v0, u_t[0]])
    w0 = np.array([-d[1], d[0]]) * v0
    spins = np.array([0, -c * w0[1]]), np.array([w0[0], (1 - c) * w0[1]])
    for ball, (v, w) in enumerate(zip((kick, v0 * d - kick), spins, strict=True)):
        slip = v - np.array([w[1], -w[0]])
        up = 0.4 * c * v0 * d[0]  # the striker's surface that rises is the part of its spin across n
        tau = bounced(slip, up if ball else 0.0, 0.0 if ball else up, bounce, mu)
        end = motion.first("slide_end", ball)
        assert (end.t - 0.1 if end else 0.0) == pytest.approx(tau, rel=1e-9, abs=2e-9)


def stiff_pair(states, mass, mu):
    """Two balls in contact, in small steps: spring and dashpot along the line of centres, regularised Coulomb across.

    Until they no longer press on each other; the dashpot's restitution is near .9.
    """
    reduced = mass[0] * mass[1] / mass.sum()
    rate = 2 * np.pi * 3e7  # 1/s: the contact lasts some 20 ns
    spring, dash = reduced * rate**2, 0.06 * reduced * rate

    def right(_, y):
        (x1, v1, w1), (x2, v2, w2) = y.reshape(2, 3, 3)
        n = (x1 - x2) / np.linalg.norm(x1 - x2)
        relative = v2 - v1
        slip = relative - (relative @ n) * n + R * np.cross(w1 + w2, n)
        size = np.linalg.norm(slip)
        push = pressure(y)
        force = push * n + mu * push * slip / max(size, 1e-300) * np.tanh(size / 1e-3)
        turn = -R * np.cross(n, force)
        inertia = 0.4 * mass * R**2
        return np.concatenate([v1, force / mass[0], turn / inertia[0], v2, -force / mass[1], turn / inertia[1]])

    def pressure(y):
        apart = y[0:3] - y[9:12]
        distance = np.linalg.norm(apart)
        return spring * (2 * R - distance) + dash * (y[12:15] - y[3:6]) @ apart / distance

    def parted(_, y):
        return pressure(y)

    parted.terminal, parted.direction = True, -1
    run = solve_ivp(right, (0, 1e-7), states.ravel(), "DOP853", events=parted, rtol=1e-9, atol=1e-13, max_step=2e-10)
    return run.y[:, -1].reshape(2, 9)


@pytest.mark.parametrize(
    ("b", "mu", "heavier"), [(0.0, 0.1, 1.0), (0.4, 0.1, 1.0), (-0.7, 0.2, 1.3), (0.3, 0.9, 1.0), (0.6, 0.05, 0.8)]
)
def test_the_impact_in_small_steps_of_a_stiff_contact(b, mu, heavier):
    """Slip all the way, or slip that ends within the contact and sticks; nothing holds the balls down."""
    one, two = launch_touching_pairs(
        PAIR[:1], PAIR[1:], np.array([0.3]), np.array([b]), np.array([0.5]), np.zeros((1, 2))
    )
    mass = PAIR.mass * [heavier, 1]
    before = np.concatenate([one, two])
    theirs = stiff_pair(before, mass, mu)
    n = (before[0, :3] - before[1, :3]) / (2 * R)
    restitution = (theirs[0] - theirs[1])[3:6] @ n / ((before[1] - before[0])[3:6] @ n)
    assert 0.88 < restitution < 0.96
    model = Model(restitution=restitution, effects=(Hop(share=1.0), BallFriction(mu=mu)))
    balls = [Bodies(np.array([R]), mass[k : k + 1], np.zeros(1), np.full(1, 0.4)) for k in (0, 1)]
    ours = collide_pairs(model, one, two, *balls)
    after = np.concatenate([ours.target, ours.striker])
    np.testing.assert_allclose(after[:, 3:6], theirs[:, 3:6], rtol=0, atol=0.3 * 3e-6)
    np.testing.assert_allclose(after[:, 6:9] * R, theirs[:, 6:9] * R, rtol=0, atol=0.3 * 3e-6)
    assert np.abs(after[:, 3:] - np.concatenate([one, two])[:, 3:]).max() > 1e-2


def stiff_plate(state, bounce):
    """A ball over a stiff plate, in small steps, until it rolls: spring, dashpot and regularised Coulomb friction."""
    damping = -np.log(bounce) / np.hypot(np.pi, np.log(bounce))
    rate = 2 * np.pi * 2e5
    rest = -G / rate**2

    def load(y):
        height = y[2] - R
        return max(-(rate**2) * height - 2 * damping * rate * y[5], 0.0) if height < 0 else 0.0

    def right(_, y):
        u = np.array([y[3] - R * y[7], y[4] + R * y[6]])
        f = -MU * load(y) * u / np.hypot(*u) * np.tanh(np.hypot(*u) / 1e-6)
        return [*y[3:6], *f, load(y) - G, 2.5 / R * f[1], -2.5 / R * f[0], 0.0]

    def rolls(_, y):
        return np.hypot(y[3] - R * y[7], y[4] + R * y[6]) - 1e-5

    rolls.terminal = True
    start = state.copy()
    start[2] += rest
    how = {"rtol": 1e-8, "atol": 1e-11, "max_step": 1e-6}
    return solve_ivp(right, (0, 0.1), start, "RK45", events=rolls, **how)


@pytest.mark.parametrize("b", [0.0, 0.5])
def test_a_hop_in_small_steps_of_a_stiff_plate(b):
    """The striker's flight, landings and slide; the bounce of .4 costs a linear dashpot nothing in accuracy."""
    motion = run(hopping(0.4), 0.05, b)
    start = motion.first("contact").after[1]
    by_hand = stiff_plate(start, 0.4)
    tau = motion.first("slide_end", 1).t - 0.1
    assert by_hand.t[-1] == pytest.approx(tau, rel=3e-3)
    ours = motion.at(0.1 + by_hand.t[-1])[1, 0]
    np.testing.assert_allclose(ours[:2], by_hand.y[:2, -1], rtol=0, atol=2e-7)
    np.testing.assert_allclose(ours[3:5], by_hand.y[3:5, -1], rtol=0, atol=3e-3 * 0.05)


@pytest.mark.parametrize("push", [{}, {"plate_tilt.x": 1e-3}, {"magnetic_attraction.pull": 0.02}])
def test_a_ball_that_stops_slipping_in_mid_bounce_ends_its_slide_once(push):
    """Then it rolls on, in the air too; a push may make it slip a little in each flight, which is no slide."""
    model = hopping(0.8, spin_transfer=0.35, sliding_friction=0.9).replace(push)
    rows = np.array([[0, 0, 0.1, 0.3, 0.0, b] for b in (-0.5, 0.0, 0.3)])
    batch = solve_collisions(model, rows, 0.0, 0.3)
    for k, b in enumerate(rows[:, 5]):
        motion = run(model, 0.3, b)
        for ball in (0, 1):
            (end,) = (e for e in motion.events if e.kind == "slide_end" and e.i == ball)
            assert any(e.kind == "land" and e.i == ball and e.t > end.t for e in motion.events)
            assert batch.slide_ends[k + 3 * ball] == pytest.approx(end.t, abs=1e-9)
