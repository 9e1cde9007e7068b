"""Contacts that last: the damped half-oscillator, Hertz, the limit of an impact, and another integrator beside them."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from synthcam.dynamics.contacts.lasting import ContactSpring
from synthcam.dynamics.kinematics import rolling_state
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.dynamics.supports import Air
from synthcam.dynamics.tabletop import Table
from synthcam.effects.ball_friction import BallFriction
from synthcam.model import Bodies, Model

R, M = 1.19e-3, 5.5e-5
DISCS = Bodies(R * np.array([1.0, 1.5]), M * np.array([1.0, 3.0]), np.zeros(2), np.array([0.5, 0.5]))
REDUCED = 0.75 * M


def head_on(spring, restitution, speed=0.3):
    """Two discs on air; the contact event, its end, and the motion."""
    states = np.zeros((2, 9))
    states[1, 0], states[1, 3] = -0.01, speed
    table = Table(supports=(Air(), Air()), spring=spring)
    model = Model(restitution=restitution, spin_transfer=0.0)
    motion = solve(model, Launch(0.0, states, DISCS), 0.0, 0.2, table=table)
    return motion.first("contact"), motion.first("contact_end"), motion


@pytest.mark.parametrize(("restitution", "duration"), [(1.0, 1e-3), (0.6, 1e-3), (0.9, 1e-5), (0.2, 0.02)])
def test_a_linear_contact_is_a_damped_half_oscillation(restitution, duration):
    """h = v/w exp(-g t) sin(w t): its duration, its deepest overlap, and the speed that it returns."""
    hit, end, motion = head_on(ContactSpring("linear", duration), restitution)
    assert end.t - hit.t == pytest.approx(duration, rel=1e-6)
    w, g = math.pi / duration, -math.log(restitution) / duration
    times = np.linspace(hit.t, end.t, 20001)
    overlap = DISCS.radius.sum() - np.linalg.norm(np.diff(motion.at(times)[..., :2], axis=0)[0], axis=-1)
    deepest = 0.3 / math.hypot(w, g) * math.exp(-g / w * math.atan2(w, g))
    assert overlap.max() == pytest.approx(deepest, rel=1e-6)
    assert end.after[0, 3] - end.after[1, 3] == pytest.approx(restitution * 0.3, rel=1e-6)
    assert hit.impulse_n == pytest.approx((1 + restitution) * 0.3 * REDUCED, rel=1e-6)


@pytest.mark.parametrize("speed", [0.05, 1.0])
def test_a_hertz_contact_lasts_as_hertz_says(speed):
    spring, radius = ContactSpring("hertz", modulus=1e8), R * 1.5 / 2.5
    hit, end, motion = head_on(spring, 1.0, speed)
    lasts = 2.868 * (REDUCED**2 / (radius * 1e16 * speed)) ** 0.2
    assert end.t - hit.t == pytest.approx(lasts, rel=2e-4)  # the number has four digits
    middle = motion.at((hit.t + end.t) / 2)[:, 0]
    stiff = 4 / 3 * 1e8 * math.sqrt(radius)
    deepest = (5 * REDUCED * speed**2 / (4 * stiff)) ** 0.4
    assert DISCS.radius.sum() - abs(middle[0, 0] - middle[1, 0]) == pytest.approx(deepest, rel=1e-6)
    for restitution in (0.3, 0.9):
        _, end, _ = head_on(spring, restitution, speed)
        assert end.after[0, 3] - end.after[1, 3] == pytest.approx(restitution * speed, rel=1e-5)


BALLS = Bodies(R * np.ones(2), M * np.ones(2), np.zeros(2), 0.4 * np.ones(2))


def oblique(duration, model):
    """A striker that rolls at a resting ball; the states at the end of the contact."""
    states = rolling_state(np.array([[0.0, 0.0], [-0.01, R]]), np.array([[0.0, 0.0], [0.3, 0.0]]), 0.0, R)
    spring = ContactSpring("linear", duration) if duration else None
    motion = solve(model, Launch(0.0, states, BALLS), 0.0, 0.06, table=Table(spring=spring))
    hit = motion.first("contact")
    return hit, hit.after, motion


def test_a_short_contact_is_an_impact():
    """With friction between the balls and below them, what is left falls in proportion to the duration."""
    model = Model(restitution=0.8, effects=(BallFriction(mu=0.2),))
    exact = oblique(0.0, model)
    left = []
    for duration in (1e-4, 1e-5, 1e-6):
        hit, after, _ = oblique(duration, model)
        left.append(np.abs(after[:, 3:5] - exact[1][:, 3:5]).max())
        assert abs(hit.impulse_t / exact[0].impulse_t - 1) < 2 * duration / 1e-4
    assert left[0] < 3 * 0.232 * 9.81 * 1e-4
    assert left[1] == pytest.approx(left[0] / 10, rel=0.15)
    assert left[2] < left[1] / 5


def follow_stiff_contact(before, duration, restitution, friction, turns):
    """Integrate spring, damper and Coulomb's friction between two balls, and that of the plate, by an implicit method.

    turns: whether the friction follows the slip; otherwise it keeps the direction that the slip has at first. The plate
    holds back the vertical part of the friction. Returns the velocities and the tangential impulse on the target.
    """
    w, g, grip, kept = math.pi / duration, -math.log(restitution) / duration, 0.232 * 9.81, {}

    def law(_, y):
        now = y[:18].reshape(2, 9)
        x, v, spin = now[:, :2], now[:, 3:5], R * now[:, 6:9]
        far = math.hypot(*(x[0] - x[1]))
        n, u = np.array([*(x[0] - x[1]) / far, 0.0]), np.array([*(v[0] - v[1]), 0.0])
        press = M / 2 * ((w * w + g * g) * (2 * R - far) - 2 * g * (u @ n))
        slip = u - (u @ n) * n - np.cross(spin[0] + spin[1], n)
        hat = slip / math.hypot(np.linalg.norm(slip), 1e-5)
        rub = -friction * press * (hat if turns else kept.setdefault("hat", hat))
        out = np.zeros((2, 9))
        out[:, :2] = v
        for k, sign in ((0, 1), (1, -1)):
            low = v[k] + np.array([-spin[k, 1], spin[k, 0]])
            plate = -grip * low / math.hypot(*low, 1e-5)
            out[k, 3:5] = sign * (press * n + rub)[:2] / M + plate
            out[k, 6:9] = np.cross(-n, rub) / (0.4 * M * R) + np.array([plate[1], -plate[0], 0]) / (0.4 * R)
        return [*out.ravel(), rub[:2] @ [-n[1], n[0]]]

    def parts(_, y):
        return 2 * R - math.hypot(*(y[:2] - y[9:11])) + 1e-12

    parts.terminal, parts.direction = True, -1
    limits = {"rtol": 1e-7, "atol": 1e-13, "max_step": duration / 20}
    first = np.append(before, 0.0)
    last = solve_ivp(law, (0, 20 * duration), first, method="Radau", events=parts, **limits).y[:, -1]
    return last[:18].reshape(2, 9)[:, 3:5], last[18]


@pytest.mark.parametrize(("b", "friction", "least"), [(0.3, 0.05, 0.96), (0.3, 0.15, 0.85), (0.9, 0.15, 0.98)])
def test_friction_in_a_contact_keeps_its_direction(b, friction, least):
    """It is that of a stiff integration. If it followed the slip, the tangential impulse would be smaller."""
    model = Model(restitution=0.8, rolling_drag=0.0, rolling_decel=0.0, effects=(BallFriction(mu=friction),))
    states = rolling_state(np.array([[0.0, 0.0], [-0.01, 2 * R * b]]), np.array([[0.0, 0.0], [0.3, 0.0]]), 0.0, R)
    table = Table(spring=ContactSpring("linear", 1e-4))
    hit = solve(model, Launch(0.0, states, BALLS), 0.0, 0.06, table=table).first("contact")
    velocities, impulse = follow_stiff_contact(hit.before, 1e-4, 0.8, friction, turns=False)
    np.testing.assert_allclose(hit.after[:, 3:5], velocities, rtol=0, atol=2e-5)
    assert hit.impulse_t == pytest.approx(impulse, rel=1e-3)
    _, turned = follow_stiff_contact(hit.before, 1e-4, 0.8, friction, turns=True)
    assert least < turned / hit.impulse_t < 1


def test_the_plate_rubs_balls_in_a_soft_contact():
    """Against the equations with a small step of another integrator, head-on, in 8 ms."""
    model = Model(restitution=0.7, spin_transfer=0.25, rolling_drag=0.0, rolling_decel=0.0)
    states = rolling_state(np.array([[0.0, 0.0], [-0.01, 0.0]]), np.array([[0.0, 0.0], [0.3, 0.0]]), 0.0, R)
    spring = ContactSpring("linear", 8e-3)
    end = solve(model, Launch(0.0, states, BALLS), 0.0, 0.06, table=Table(spring=spring)).first("contact_end")
    w, g, friction = math.pi / 8e-3, -math.log(0.7) / 8e-3, 0.232 * 9.81
    share = 0.4 * 0.25 / (1.7 / 2)  # vertical over normal impulse: k C v 2 m, (1 + r) v m with half the mass

    def law(t, y):
        x1, v1, s1, x2, v2, s2 = y  # s: R times the spin; v - s is the slip
        h, rate = x2 + 2 * R - x1, v2 - v1
        push = ((w * w + g * g) * h + 2 * g * rate) / 2  # over the mass
        rub = [-friction * math.tanh((v - s) / 1e-7) for v, s in ((v1, s1), (v2, s2))]
        turn = -share * push / 0.4
        return [v1, push + rub[0], -rub[0] / 0.4 + turn, v2, -push + rub[1], -rub[1] / 0.4 + turn]

    first = [0.0, 0.0, 0.0, -2 * R, 0.3, 0.3]
    exact = solve_ivp(law, (0, end.t - (0.01 - 2 * R) / 0.3), first, method="Radau", rtol=1e-8, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(end.after[:, 3], exact[[1, 4]], rtol=0, atol=2e-6)
    np.testing.assert_allclose(R * end.after[:, 7], exact[[2, 5]], rtol=0, atol=2e-6)
    assert exact[3] + 2 * R == pytest.approx(exact[0], abs=1e-7)


def test_a_cradle_of_springs_passes_on_nearly_all():
    """Five discs in a row that touch; for linear springs another integrator gives what each gets."""
    five = Bodies(R * np.ones(5), M * np.ones(5), np.zeros(5), 0.5 * np.ones(5))
    states = np.zeros((5, 9))
    states[:, 0], states[:, 2] = 2 * R * np.arange(5), R
    states[0, 0] -= 0.01
    states[0, 3] = 0.3
    table = Table(supports=(Air(),) * 5, spring=ContactSpring("linear", 1e-3))
    motion = solve(Model(restitution=1.0, spin_transfer=0.0), Launch(0.0, states, five), 0.0, 0.1, table=table)
    stiff = (math.pi / 1e-3) ** 2 / 2

    def law(t, y):
        push = stiff * np.maximum(2 * R - np.diff(y[:5]), 0)
        return [*y[5:], *(np.concatenate([[0], push]) - np.concatenate([push, [0]]))]

    first = [*(2 * R * np.arange(5)), 0.3, 0, 0, 0, 0]
    exact = solve_ivp(law, (0, 0.005), first, method="DOP853", rtol=1e-9, atol=1e-12, max_step=1e-4).y[5:, -1]
    np.testing.assert_allclose(motion.at(0.1)[:, 0, 3], exact, rtol=0, atol=1e-6)
    assert exact[-1] < 0.299
