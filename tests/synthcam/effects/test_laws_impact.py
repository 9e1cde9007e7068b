"""The laws of the impact against contacts taken in small steps, textbook limits and the balls' own definitions."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.effects.velocity_restitution import VelocityRestitution
from synthcam.model import Model

R, M, G = Model().ball.radius, Model().ball.mass, 9.81


def hit(model, v0, b=0.0, labels="ab"):
    """The contact of a striker that rolls at a resting ball: an Event, before and after (2, 9)."""
    return solve(model, Launch.pair(model.bodies(labels), 0.1, v0, b, 0.0, (0, 0)), 0.1, 0.1).first("contact")


@pytest.mark.parametrize("speed", [0.05, 0.15, 0.6])
def test_velocity_restitution_is_a_viscoelastic_sphere_at_e_of_a_fifth(speed):
    """A Hertz contact whose material resists its rate too, k d^(3/2) + A (3/2) k d^(1/2) d', integrated to the parting.

    The law is its first order: so small a loss that the second, .6 of the loss, hardly shows.
    """

    def loss(v):
        def rates(_, y):
            depth = max(y[0], 0.0)
            return [y[1], -max(depth**1.5 + 1e-3 * 1.5 * depth**0.5 * y[1], 0.0)]

        def parts(_, y):
            return y[0] - 1e-12

        parts.terminal, parts.direction = True, -1
        run = solve_ivp(rates, (0, 100), [1e-12, v], events=parts, rtol=1e-12, atol=1e-14, method="DOP853")
        return 1 + run.y[1, -1] / v

    law = VelocityRestitution(e=0.2)
    lost = [1 - law.restitution(1 - 0.01, v) for v in (speed, 0.3)]
    assert lost[0] / lost[1] == pytest.approx(loss(speed) / loss(0.3), rel=2e-3)


def test_spin_transfer_velocity_is_a_straight_line_through_the_models_own_at_30_cm_per_s():
    """C as format.md defines it, read from the target's spin: w1t = -C w0t."""
    model = Model().replace({"spin_transfer_velocity.c": 0.3})
    found = []
    for v in (0.1, 0.3, 0.5):
        contact = hit(model, v, 0.4)
        t = np.array([-contact.n[1], contact.n[0]])
        found.append(-(contact.after[0, 6:8] @ t) / (contact.before[1, 6:8] @ t))
    assert found[1] == pytest.approx(Model().spin_transfer, rel=1e-12)
    assert found[2] - found[1] == pytest.approx(found[1] - found[0], rel=1e-9)
    assert (found[2] - found[0]) / found[1] == pytest.approx(0.3 * (0.5 - 0.1) / 0.3)  # c per 30 cm/s


@pytest.mark.parametrize("excess", [0.3, -0.2])
def test_mass_mismatch_is_the_textbooks_elastic_collision(excess):
    """r = 1, C = 0, head-on: (m2 - m1)/(m1 + m2) and 2 m2/(m1 + m2) of the striker's speed; ball a is the heavier."""
    model = Model(restitution=1.0, spin_transfer=0.0).replace({"mass_mismatch.excess": excess})
    for labels, one, two in (("ab", 1 + excess, 1.0), ("ba", 1.0, 1 + excess)):
        after = hit(model, 0.3, labels=labels).after[:, 3] / 0.3
        np.testing.assert_allclose(after, [2 * two / (one + two), (two - one) / (one + two)], rtol=1e-12)
    assert model.bodies("ab").radius[0] == R


def test_diameter_mismatch_is_a_larger_ball_of_the_same_steel():
    """Its density is the other's; the balls touch where their centres are R1 + R2 apart in space."""
    model = Model().replace({"diameter_mismatch.excess": 0.1})
    pair = model.bodies("ab")
    np.testing.assert_allclose(pair.mass / (4 / 3 * np.pi * pair.radius**3), 7800, rtol=1e-12)
    assert pair.radius[0] / pair.radius[1] == pytest.approx(1.1)
    before = hit(model, 0.3, 0.3).before[:, :3]
    np.testing.assert_allclose(before[:, 2], pair.radius, rtol=1e-12)
    assert np.linalg.norm(before[0] - before[1]) == pytest.approx(pair.radius.sum(), rel=1e-12)


def sticking(speed, held):
    """C of steel balls that stick to each other, head-on, by Hertz contacts in small steps, on aluminium if `held`."""
    steel, aluminium = (1 - 0.3**2) / 210e9, (1 - 0.33**2) / 70e9
    between, below = 4 / 3 / (2 * steel) * np.sqrt(R / 2), 4 / 3 / (steel + aluminium) * np.sqrt(R)
    rest = (M * G / below) ** (2 / 3)

    def rates(_, y):
        depth, rate, *vertical, spin = y  # of the contact; heights and velocities of target and striker; spins' sum
        (z1, z2), (v1, v2) = vertical[:2], vertical[2:]
        push = between * max(depth, 0.0) ** 1.5
        slip = v2 - v1 + R * spin  # up: the striker's front rises
        rub = push * np.tanh(slip / 1e-4)  # on the target; friction of 1 sticks at once
        loads = [below * max(rest - z, 0.0) ** 1.5 if held else M * G for z in (z1, z2)]
        lifts = (rub + loads[0]) / M - G, (-rub + loads[1]) / M - G
        return [rate, -2 * push / M, v1, v2, *lifts, -2 * 2.5 / R * rub / M]

    def parts(_, y):
        return y[0] + 1e-15

    parts.terminal, parts.direction = True, -1
    start = [0.0, speed, 0.0, 0.0, 0.0, 0.0, speed / R]
    how = {"method": "LSODA", "rtol": 1e-8, "atol": 1e-14, "max_step": 5e-8, "events": parts}
    run = solve_ivp(rates, (0, 1e-4), start, **how)
    return (1 - run.y[6, -1] * R / speed) / 2, run.t[-1]


def test_balls_that_stick_hardly_feel_the_plate_while_they_touch():
    """So ball_friction's C is that of free balls, 5/14, and not the 1/2 of two that a plate holds."""
    (free, _), (real, touch) = sticking(0.3, False), sticking(0.3, True)
    ours = -hit(Model().replace({"ball_friction.share": 1.0, "ball_friction.mu": 1.0}), 0.3).after[0, 7] * R / 0.3
    assert ours == pytest.approx(free, abs=2e-3)
    assert touch == pytest.approx(9e-6, rel=0.05)
    assert 0 < real - ours < 0.03
