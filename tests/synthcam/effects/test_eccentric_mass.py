"""An eccentric ball keeps its energy."""

import numpy as np
import pytest

from synthcam.dynamics.kinematics import rolling_state
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.model import Model

R, M, G = Model().ball.radius, Model().ball.mass, 9.81
LOSSLESS = Model(rolling_drag=0.0, rolling_decel=0.0)


def alone(model, speed, end=0.1, label="a"):
    """The motion of one ball that rolls along x."""
    body = model.bodies(label)
    launch = Launch(0.0, rolling_state(np.zeros((1, 2)), np.array([[speed, 0.0]]), 0.0, body.radius), body)
    return solve(model, launch, 0.0, end)


@pytest.mark.parametrize("speed", [0.1, 0.3, 0.6])
def test_eccentric_mass_keeps_the_energy_of_an_eccentric_sphere(speed):
    """T + V of a rigid sphere whose centre of mass starts c ahead of the middle and d above it, to all orders."""
    c, d = 0.8e-6, -0.6e-6
    model = LOSSLESS.replace({"eccentric_mass.c": c, "eccentric_mass.d": d})
    states = alone(model, speed).at(np.linspace(0, 0.1, 400))[0]
    turned, rate = states[:, 0] / R, states[:, 3] / R
    ahead, up = c * np.cos(turned) + d * np.sin(turned), d * np.cos(turned) - c * np.sin(turned)
    own = 0.4 * R**2 - c**2 - d**2  # about the centre of mass; 2/5 R^2 about the middle
    twice = (R + up) ** 2 + ahead**2 + own  # over rate^2: the centre of mass turns about the lowest point
    energy = twice / 2 * rate**2 + G * up
    free = np.sqrt(2 * (energy[0] - G * up) / twice) * R  # the speed that it has by its energy
    ripple = np.ptp(free)
    assert ripple > 1e-4 * speed
    np.testing.assert_allclose(states[:, 3], free, rtol=0, atol=3e-3 * ripple)  # d/R is 8e-4
