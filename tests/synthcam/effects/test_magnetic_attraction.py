"""Attraction is the gradient of the dipoles' energy, and obeys the third law."""

import numpy as np
import pytest

from synthcam.dynamics.kinematics import rolling_state
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.effects.magnetic_attraction import MagneticAttraction
from synthcam.model import Model

R, M, G = Model().ball.radius, Model().ball.mass, 9.81
LOSSLESS = Model(rolling_drag=0.0, rolling_decel=0.0)


def dipole_energy(one, two, apart):
    """mu0/(4 pi r^3) [m1.m2 - 3 (m1.r)(m2.r)/r^2], J: the textbooks' energy of two dipoles `apart` (3,)."""
    r = np.linalg.norm(apart)
    return 1e-7 / r**3 * (one @ two - 3 * (one @ apart) * (two @ apart) / r**2)


@pytest.mark.parametrize("upright", [True, False])
@pytest.mark.parametrize("gap", [1.0, 1.7, 6.0])
def test_magnetic_attraction_is_the_gradient_of_the_dipoles_energy(upright, gap):
    """Moments side by side, upright, repel by half of what moments along the line of centres attract by."""
    strength, line = 2e-5, np.array([np.cos(0.4), np.sin(0.4), 0.0])  # A m^2
    moment = strength * (np.array([0, 0, 1.0]) if upright else line)
    at_touch = 3e-7 * strength**2 / (2 * R) ** 4 / Model().ball.mass
    effect = MagneticAttraction(pull=-at_touch if upright else 2 * at_touch)
    position, step = gap * 2 * R * line, 1e-7
    slope = [
        (dipole_energy(moment, moment, position + step * e) - dipole_energy(moment, moment, position - step * e))
        / step
        / 2
        for e in np.eye(3)[:2]
    ]  # of the energy, by where the other is: the force on this one
    push = effect.push(np.zeros((1, 2)), position[None, :2], np.array([M]), Model().ball)
    np.testing.assert_allclose(push[0], np.array(slope) / M, rtol=1e-6)


@pytest.mark.parametrize("others", [{"mass_mismatch.excess": 0.5}, {"diameter_mismatch.excess": 0.1}])
def test_magnetic_attraction_obeys_the_third_law_beside_unequal_balls(others):
    """Two that roll without loss: m1 v1 + m2 v2 stays, and so does the energy with the force's own potential."""
    pull = 0.3
    model = LOSSLESS.replace({"magnetic_attraction.pull": pull} | others)
    pair = model.bodies("ab")
    states = rolling_state(
        np.array([[0.004, 0.001], [-0.004, -0.001]]), np.array([[-0.02, 0.01], [0.03, 0.0]]), 0.0, pair.radius
    )
    at = solve(model, Launch(0.0, states, pair), 0.0, 0.08).at(np.linspace(0, 0.08, 50))
    carried = (pair.mass[:, None, None] * at[..., 3:5]).sum(axis=0)
    np.testing.assert_allclose(carried, np.broadcast_to(carried[0], (50, 2)), rtol=0, atol=1e-12 * pair.mass.sum())
    moving = 0.7 * (pair.mass[:, None] * (at[..., 3:5] ** 2).sum(axis=-1)).sum(axis=0)
    bound = M * pull * (2 * R) ** 4 / 3 / np.hypot(*(at[1] - at[0])[:, :2].T) ** 3
    assert np.ptp(bound) > 0.01 * moving[0]
    np.testing.assert_allclose(moving - bound, moving[0] - bound[0], rtol=1e-10)
