"""A wavy plate is a ball on a curved surface, by Lagrange."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.model import Model

R, M, G = Model().ball.radius, Model().ball.mass, 9.81
LOSSLESS = Model(rolling_drag=0.0, rolling_decel=0.0)


def over_a_wave(height, k, speed, times, mu):
    """Centre x at times of a ball set down at `speed` without spin on h = height sin(k s), its curved path in full.

    Contact at s; along the tangent and the normal, kappa the plate's curvature:
    v' = -g sin - mu N,  N = g cos + v^2 kappa/(1 - kappa R),  R w' = (5/2) mu N, until v = R w; then (7/5) v' = -g sin.
    """

    def plate(s):
        slope, bend = height * k * np.cos(k * s), -height * k * k * np.sin(k * s)
        wide = np.hypot(1, slope)
        return slope / wide, 1 / wide, bend / wide**3

    def rates(_, y, slides):
        sin, cos, kappa = plate(y[0])
        rub = mu * (G * cos + y[1] ** 2 * kappa / (1 - kappa * R)) if slides else 0.0
        gained = -G * sin - rub if slides else -5 / 7 * G * sin
        return [y[1] * cos / (1 - kappa * R), gained, 2.5 * rub if slides else gained]

    def slip(_, y, slides):
        return y[1] - y[2]

    slip.terminal = True
    how = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-16, "dense_output": True}
    start = brentq(lambda s: s - R * plate(s)[0], -R, R)  # where the centre is at x = 0
    one = solve_ivp(rates, (0, times[-1]), [start, speed, 0.0], args=(True,), events=slip, **how)
    two = solve_ivp(rates, (one.t[-1], times[-1]), one.y[:, -1], args=(False,), **how)
    s = np.where(times < one.t[-1], one.sol(np.minimum(times, one.t[-1]))[0], two.sol(np.maximum(times, one.t[-1]))[0])
    return s - R * plate(s)[0]


@pytest.mark.parametrize("speed", [0.1, 0.3, 0.6])
def test_plate_waviness_is_a_ball_on_a_curved_plate(speed):
    """Its load too: v^2 h'' times mu is 0.7 of the push at .3 m/s on waves of 20 mm."""
    height, wavelength = 1e-6, 0.02
    wave = {"plate_waviness.b": height, "plate_waviness.wavelength": wavelength, "plate_waviness.angle": 0.0}
    model, times = LOSSLESS.replace(wave), np.linspace(0, 0.11, 45)
    state = np.zeros((1, 9))
    state[0, 2:4] = R, speed
    launch = Launch(0.0, state, model.bodies("b"))
    ours, flat = (solve(m, launch, 0.0, 0.11).at(times)[0, :, 0] for m in (model, LOSSLESS))
    full = over_a_wave(height, 2 * np.pi / wavelength, speed, times, model.sliding_friction)
    moved = np.abs(full - flat).max()
    assert moved > 3e-7
    np.testing.assert_allclose(ours, full, rtol=0, atol=0.01 * moved)
