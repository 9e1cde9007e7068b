"""The collision law against the textbook: momentum, spin, restitution and energy, each worked out anew."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synthcam.effects.velocity_restitution import VelocityRestitution
from synthcam.impact import collide
from synthcam.model import Model

R = Model().ball.radius
speed = st.floats(-1, 1)
angle = st.floats(0, 2 * np.pi)


@st.composite
def encounters(draw):
    """Two balls of any velocity and spin on the plate, touching and approaching."""
    states = np.zeros((2, 9))
    for state in states:
        state[3:5] = [draw(speed), draw(speed)]
        state[6:9] = [draw(speed) / R, draw(speed) / R, draw(speed) / R]
        state[2] = R
    a = draw(angle)
    n = np.array([np.cos(a), np.sin(a), 0])
    states[0, :2] = 2 * R * n[:2]
    closing = (states[1, 3:6] - states[0, 3:6]) @ n
    states[1, 3:6] += (draw(st.floats(0.01, 1)) - closing) * n
    return states, n


def slip(states, n):
    """Velocity of the striker's touching surface over the target's, without its normal part."""
    target, striker = states
    surface = striker[3:6] + np.cross(striker[6:9], R * n) - target[3:6] - np.cross(target[6:9], -R * n)
    return surface - (surface @ n) * n


def energy(states):
    """Of unit masses: centre and spin."""
    return (states[:, 3:6] ** 2).sum() / 2 + 0.2 * R**2 * (states[:, 6:9] ** 2).sum()


@given(encounters(), st.floats(0, 1), st.floats(0, 5 / 7))
def test_any_collision_keeps_the_balances(encounter, r, c):
    before, n = encounter
    hit = collide(Model(restitution=r, spin_transfer=c), *before)
    change = hit.states - before
    u, t = slip(before, n), np.array([-n[1], n[0], 0])
    size = np.abs(before[:, 3:6]).max() + R * np.abs(before[:, 6:9]).max()

    def close(a, b):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12 * size)

    close(hit.states[:, :3], before[:, :3])
    close(change[0, 3:6], -change[1, 3:6])
    close(hit.states[:, 5], 0)
    close((hit.states[0] - hit.states[1])[3:6] @ n, -r * (before[0] - before[1])[3:6] @ n)
    close(hit.impulse_n, change[0, 3:6] @ n)
    close(hit.impulse_t, change[0, 3:6] @ t)
    pull = 0.4 * c * u  # on the target, over the mass; the plate takes up what is vertical of it
    close(change[0, 3:6] - (change[0, 3:6] @ n) * n, [pull[0], pull[1], 0])
    for k, lever in enumerate((-n, n)):
        close(R * change[k, 6:9], 2.5 * np.cross(lever, pull if k == 0 else -pull))
    assert energy(hit.states) <= energy(before) + 1e-12 * size**2


@given(encounters(), angle)
def test_a_turned_collision_is_the_same_collision_turned(encounter, turn):
    before, _ = encounter
    matrix = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])

    def turned(states):
        return np.concatenate([states[:, k : k + 3] @ matrix.T for k in (0, 3, 6)], axis=1)

    one, other = collide(Model(), *before), collide(Model(), *turned(before))
    np.testing.assert_allclose(turned(one.states)[:, :6], other.states[:, :6], rtol=0, atol=1e-12)
    np.testing.assert_allclose(turned(one.states)[:, 6:], other.states[:, 6:], rtol=0, atol=1e-9)
    assert (one.impulse_n, one.impulse_t) == pytest.approx((other.impulse_n, other.impulse_t), abs=1e-12)


@pytest.mark.parametrize(("v", "r"), [(0.05, 0.925), (0.2, 0.903 + 0.0057), (0.3, 0.903), (0.6, 0.889)])
def test_restitution_that_depends_on_speed(v, r):
    before = np.zeros((2, 9))
    before[0, 0], before[:, 2], before[1, 3] = 2 * R, R, v
    hit = collide(Model(effects=(VelocityRestitution(e=0.2),)), *before)
    exact = 1 - 0.097 * (1 + (v / 0.3) ** 0.2 - 1)
    assert hit.states[0, 3] - hit.states[1, 3] == pytest.approx(exact * v, rel=1e-12)
    assert exact == pytest.approx(r, abs=0.011)  # the table of Ramirez et al., scaled to 0.3 m/s


def test_restitution_stays_between_0_and_1():
    before = np.zeros((2, 9))
    before[0, 0], before[:, 2], before[1, 3] = 2 * R, R, 1e-9
    hit = collide(Model(restitution=0.0, effects=(VelocityRestitution(e=1),)), *before)
    assert 0 <= (hit.states[0, 3] - hit.states[1, 3]) / 1e-9 <= 1
