"""The impacts against the textbook: momentum, spin, restitution and energy, each worked out anew."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from synthcam.dynamics.contacts.impact import MIN_BOUNCE_SPEED_M_S, collide_pairs, land_on_plate
from synthcam.dynamics.kinematics import contact_velocity, rolling_velocity
from synthcam.effects.ball_friction import BallFriction
from synthcam.effects.hop import Hop
from synthcam.effects.spin_transfer_velocity import SpinTransferVelocity
from synthcam.effects.velocity_restitution import VelocityRestitution
from synthcam.model import Bodies, Model

R = Model().ball.radius
M = Model().ball.mass
ONE, TWO = Model().bodies("a"), Model().bodies("b")
UP = np.array([0.0, 0.0, 1.0])
speed = st.floats(-1, 1)
angle = st.floats(0, 2 * np.pi)
same = st.just(1.0)
ratio = same | st.floats(0.5, 2)


@st.composite
def encounters(draw, masses=ratio, sizes=same):
    """Two balls of any velocity and spin on the plate, touching and approaching; target, striker, their bodies, n."""
    r1, r2 = R * draw(sizes), R
    m1, m2 = M * draw(masses) * (r1 / r2) ** 3, M
    a = draw(angle)
    apart = 2 * np.sqrt(r1 * r2)
    n = np.array([apart * np.cos(a), apart * np.sin(a), r1 - r2]) / (r1 + r2)
    states = np.zeros((2, 9))
    for state, radius in zip(states, (r1, r2), strict=True):
        state[2:5] = [radius, draw(speed), draw(speed)]
        state[6:9] = [draw(speed) / R, draw(speed) / R, draw(speed) / R]
    states[0, :2] = apart * np.array([np.cos(a), np.sin(a)])
    closing = (states[1, 3:6] - states[0, 3:6]) @ n
    flat = np.array([n[0], n[1], 0.0])
    states[1, 3:6] += (draw(st.floats(0.01, 1)) - closing) * flat / (flat @ n)
    bodies = [Bodies(np.array([r]), np.array([m]), np.zeros(1), np.full(1, 0.4)) for r, m in ((r1, m1), (r2, m2))]
    return states, bodies, n


def struck(model, states, bodies):
    """The collision's outcome, and the states after it (2, 9)."""
    hit = collide_pairs(model, states[:1], states[1:], *bodies)
    return hit, np.concatenate([hit.target, hit.striker])


def slip(states, bodies, n):
    """Velocity of the striker's touching surface over the target's, without its normal part."""
    (target, striker), (r1, r2) = states, [b.radius[0] for b in bodies]
    surface = striker[3:6] + np.cross(striker[6:9], r2 * n) - target[3:6] - np.cross(target[6:9], -r1 * n)
    return surface - (surface @ n) * n


def energy(states, bodies):
    return sum(
        b.mass[0] * (s[3:6] @ s[3:6] / 2 + 0.2 * b.radius[0] ** 2 * s[6:9] @ s[6:9])
        for s, b in zip(states, bodies, strict=True)
    )


@given(encounters(), st.floats(0, 1), st.floats(0, 5 / 7))
def test_any_collision_keeps_the_balances(encounter, r, c):
    before, bodies, n = encounter
    hit, after = struck(Model(restitution=r, spin_transfer=c), before, bodies)
    change = after - before
    m1, m2 = (b.mass[0] for b in bodies)
    u, t = slip(before, bodies, n), np.array([-n[1], n[0], 0])
    size = np.abs(before[:, 3:6]).max() + R * np.abs(before[:, 6:9]).max()

    def close(a, b):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12 * size)

    close(after[:, :3], before[:, :3])
    close(m1 * change[0, 3:6] / M, -m2 * change[1, 3:6] / M)
    close(after[:, 5], 0)
    close((after[0] - after[1])[3:6] @ n, -r * (before[0] - before[1])[3:6] @ n)
    close(hit.impulse_n / M, m1 * change[0, 3:6] @ n / M)
    close(hit.impulse_t / M, m1 * change[0, 3:6] @ t / M)
    pull = 0.4 * c * u * 2 * m1 * m2 / (m1 + m2)  # on the target; the plate takes up what is vertical of it
    close(m1 * (change[0, 3:6] - (change[0, 3:6] @ n) * n) / M, np.array([pull[0], pull[1], 0]) / M)
    for k, (lever, m) in enumerate(((-n, m1), (n, m2))):
        close(R * change[k, 6:9], 2.5 * np.cross(lever, pull if k == 0 else -pull) / m)
    assert energy(after, bodies) <= energy(before, bodies) + 1e-12 * max(m1, m2) * size**2


@given(encounters(sizes=st.floats(0.8, 1.25)), st.floats(0, 1), st.floats(0, 5 / 7))
def test_balls_of_any_size_when_nothing_holds_them_down(encounter, r, c):
    """Free of the plate the pair keeps its momentum, and its angular momentum about the contact; r and C hold."""
    before, bodies, n = encounter
    model = Model(restitution=r, spin_transfer=c, effects=(Hop(share=1.0),))
    hit, after = struck(model, before, bodies)
    size = np.abs(before[:, 3:6]).max() + R * np.abs(before[:, 6:9]).max()
    (r1, r2), (m1, m2) = ([getattr(b, f)[0] for b in bodies] for f in ("radius", "mass"))
    change = after - before
    tight = {"rtol": 0, "atol": 1e-12 * size}
    np.testing.assert_allclose(hit.n[0], n, rtol=0, atol=1e-12)
    np.testing.assert_allclose((m1 * change[0, 3:6] + m2 * change[1, 3:6]) / M, 0, **tight)
    for k, (lever, m, radius) in enumerate(((r1 * n, m1, r1), (-r2 * n, m2, r2))):  # from the contact to the centre
        orbital = m * np.cross(lever, change[k, 3:6])
        np.testing.assert_allclose((orbital + 0.4 * m * radius**2 * change[k, 6:9]) / (M * R), 0, **tight)
    closing = [(s[1] - s[0])[3:6] @ n for s in (before, after)]
    assert closing[1] == pytest.approx(-r * closing[0], abs=1e-12 * size)
    left = slip(after, bodies, n)
    np.testing.assert_allclose(left, (1 - 3.5 * 0.8 * c) * slip(before, bodies, n), **tight)  # 1/m_t = 3.5/m
    assert energy(after, bodies) <= energy(before, bodies) + 1e-12 * max(m1, m2) * size**2


@given(encounters(sizes=st.floats(0.8, 1.25)), st.floats(0, 1), st.floats(0, 5 / 7))
def test_the_plate_makes_no_energy(encounter, r, c):
    before, bodies, _ = encounter
    _, after = struck(Model(restitution=r, spin_transfer=c), before, bodies)
    assert energy(after, bodies) <= energy(before, bodies) * (1 + 1e-12)
    np.testing.assert_array_equal(after[:, 5], 0)


@given(encounters(), angle)
def test_a_turned_collision_is_the_same_collision_turned(encounter, turn):
    before, bodies, _ = encounter
    matrix = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])

    def turned(states):
        return np.concatenate([states[:, k : k + 3] @ matrix.T for k in (0, 3, 6)], axis=1)

    (one, straight), (other, round_) = struck(Model(), before, bodies), struck(Model(), turned(before), bodies)
    np.testing.assert_allclose(turned(straight)[:, :6], round_[:, :6], rtol=0, atol=1e-12)
    np.testing.assert_allclose(turned(straight)[:, 6:], round_[:, 6:], rtol=0, atol=1e-9)
    for a, b in ((one.impulse_n, other.impulse_n), (one.impulse_t, other.impulse_t)):
        np.testing.assert_allclose(a / M, b / M, rtol=0, atol=1e-12)


@given(st.lists(encounters(), min_size=2, max_size=4))
def test_many_at_once_are_one_by_one(some):
    model = Model(effects=(BallFriction(mu=0.1), VelocityRestitution(e=0.2)))
    states = np.array([s for s, _, _ in some])
    bodies = [Bodies.join(*(b[k] for _, b, _ in some)) for k in (0, 1)]
    together = collide_pairs(model, states[:, 0], states[:, 1], *bodies)
    for k, (before, own, _) in enumerate(some):
        alone, after = struck(model, before, own)
        np.testing.assert_array_equal([together.target[k], together.striker[k]], after)
        assert together.impulse_t[k] == alone.impulse_t[0]


def head_on(v, roll=True, n=(0.0, 1.0)):
    before = np.zeros((2, 9))
    before[0, :2], before[:, 2], before[1, 3:5] = 2 * R * np.array(n), R, [0, v]
    before[1, 6] = -v / R if roll else 0.0
    return before


@pytest.mark.parametrize(("v", "r"), [(0.05, 0.925), (0.2, 0.903 + 0.0057), (0.3, 0.903), (0.6, 0.889)])
def test_restitution_that_depends_on_speed(v, r):
    after = struck(Model(effects=(VelocityRestitution(e=0.2),)), head_on(v, roll=False), (ONE, TWO))[1]
    exact = 1 - 0.097 * (1 + (v / 0.3) ** 0.2 - 1)
    assert after[0, 4] - after[1, 4] == pytest.approx(exact * v, rel=1e-12)
    assert exact == pytest.approx(r, abs=0.011)  # the table of Ramirez et al., scaled to 0.3 m/s


def test_restitution_stays_between_0_and_1():
    after = struck(Model(restitution=0.0, effects=(VelocityRestitution(e=1),)), head_on(1e-9, False), (ONE, TWO))[1]
    assert 0 <= (after[0, 4] - after[1, 4]) / 1e-9 <= 1


@pytest.mark.parametrize("beta", [-0.5, 0.0, 0.4])
@given(encounters(masses=st.just(1.0)), st.floats(0, 0.6))
def test_coulomb_between_the_balls_sticks_or_slips(beta, encounter, mu):
    """J = mu P against the slip, but no more than turns the slip into -beta times itself where nothing holds down."""
    before, bodies, n = encounter
    free = (BallFriction(share=1.0, mu=mu, beta=beta), Hop(share=1.0))
    hit, after = struck(Model(effects=free), before, bodies)
    u, size = slip(before, bodies, n), np.abs(before[:, 3:6]).max() + R * np.abs(before[:, 6:9]).max()
    impulse = M * (after[0, 3:6] - before[0, 3:6])
    along = impulse - (impulse @ n) * n
    if mu * hit.impulse_n[0] / M < (1 + beta) * np.hypot(*[np.hypot(*u[:2]), u[2]]) / 7:
        np.testing.assert_allclose(np.linalg.norm(along), mu * hit.impulse_n[0], rtol=1e-9, atol=1e-15 * M)
        np.testing.assert_allclose(np.cross(along, u) / M, 0, rtol=0, atol=1e-12 * size**2)
    else:
        np.testing.assert_allclose(slip(after, bodies, n), -beta * u, rtol=0, atol=1e-11 * size)


def test_sticking_passes_on_5_14_of_the_spin():
    for model in (Model(effects=(BallFriction(mu=1.0),)), Model(spin_transfer=5 / 14)):
        after = struck(model, head_on(0.3), (ONE, TWO))[1]
        np.testing.assert_allclose(after[:, 6] * R / 0.3, [5 / 14, -9 / 14], rtol=1e-12)


def test_spin_transfer_at_other_speeds():
    for v in (0.1, 0.3, 0.6):
        after = struck(Model(effects=(SpinTransferVelocity(c=0.2),)), head_on(v), (ONE, TWO))[1]
        assert after[0, 6] * R / v == pytest.approx(0.347 * (1 + 0.2 * (v / 0.3 - 1)), rel=1e-12)


@given(st.floats(1e-3, 1), speed, speed, speed, speed, speed, st.floats(0, 0.9), st.floats(0.05, 0.5))
def test_a_landing(down, vx, vy, wx, wy, wz, bounce, mu):
    """The plate's impulse is (1 + e) v_z; the friction impulse is mu times that, or what ends the slip."""
    before = np.array([[0.01, 0.02, R, vx, vy, -down, wx / R, wy / R, wz / R]])
    after = land_on_plate(Model(sliding_friction=mu, effects=(Hop(bounce=bounce),)), before, ONE)
    u = contact_velocity(before, R)[0]
    given_ = min(mu * (1 + bounce) * down, np.hypot(*u) / 3.5)
    assert after[0, 5] == pytest.approx(bounce * down if bounce * down >= MIN_BOUNCE_SPEED_M_S else 0.0)
    np.testing.assert_allclose(after[0, 3:5] - before[0, 3:5], -given_ * u / max(np.hypot(*u), 1e-300), atol=2e-7)
    np.testing.assert_allclose(rolling_velocity(after, R), rolling_velocity(before, R), rtol=0, atol=1e-15)
    lowest = np.cross(-R * UP, [*(after[0, 3:5] - before[0, 3:5]), 0.0]) / (0.4 * R**2)
    np.testing.assert_allclose(after[0, 6:9] - before[0, 6:9], lowest, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(after[0, [0, 1, 2, 8]], before[0, [0, 1, 2, 8]])


@given(encounters(), st.floats(0, 0.9), st.floats(0.01, 0.3), st.floats(0, 0.5), st.floats(0.1, 0.7))
def test_no_impact_tells_a_tangential_restitution_from_a_larger_share(encounter, share, mu, beta, c):
    """If C is free, share (1 + beta) and mu / (1 + beta) act alike; C acts beside them."""
    before, bodies, _ = encounter
    wider = share * (1 + beta)
    assume(wider < 0.95)
    rest = (1 - share) * c / (1 - wider)
    assume(rest <= 5 / 7)
    one, other = (
        struck(Model(spin_transfer=own, effects=(effect,)), before, bodies)[1]
        for own, effect in (
            (c, BallFriction(share=share, mu=mu, beta=beta)),
            (rest, BallFriction(share=wider, mu=mu / (1 + beta))),
        )
    )
    np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
