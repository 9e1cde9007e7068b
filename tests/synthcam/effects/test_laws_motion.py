"""The laws of motion against derivations that their files do not hold: Lagrangians, quadratures, tables, balances."""

import numpy as np
import pytest

from synthcam.dynamics.kinematics import rolling_state
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.effects.air_drag import AirDrag
from synthcam.model import Model

R, M, G = Model().ball.radius, Model().ball.mass, 9.81
LOSSLESS = Model(rolling_drag=0.0, rolling_decel=0.0)


def alone(model, speed, end=0.1, label="a"):
    """The motion of one ball that rolls along x."""
    body = model.bodies(label)
    launch = Launch(0.0, rolling_state(np.zeros((1, 2)), np.array([[speed, 0.0]]), 0.0, body.radius), body)
    return solve(model, launch, 0.0, end)


def slide_of(model, speed, heading=0.0):
    """The motion of a ball set down at this speed without spin."""
    state = np.zeros((1, 9))
    state[0, 2:5] = R, speed * np.cos(heading), speed * np.sin(heading)
    return solve(model, Launch(0.0, state, model.bodies("b")), 0.0, 0.2)


def lasts(model, speed, heading=0.0):
    return slide_of(model, speed, heading).first("slide_end", 0).t


def test_viscous_friction_ends_a_slide_after_a_logarithm():
    """u' = -(7/2) mu g (1 + k u), solved."""
    mu, k = Model().sliding_friction, 2.0
    expected = np.log(1 + k * 0.4) / (3.5 * mu * G * k)
    assert lasts(Model().replace({"viscous_friction.k": k}), 0.4) == pytest.approx(expected, rel=1e-9)


def test_stribeck_ends_a_slide_after_its_integral():
    """The integral of du/(1 + rise exp(-u/slip)) is slip ln(exp(u/slip) + rise)."""
    mu, rise, slip = Model().sliding_friction, 0.6, 0.1
    expected = slip * np.log((np.exp(0.4 / slip) + rise) / (1 + rise)) / (3.5 * mu * G)
    model = Model().replace({"stribeck.rise": rise, "stribeck.slip": slip})
    assert lasts(model, 0.4) == pytest.approx(expected, rel=1e-9)


def test_friction_anisotropy_is_a_grain_with_an_axis():
    """Most along th0, least across it; alike there and back; two ways at right angles have mu on average."""
    mu, th0, e = Model().sliding_friction, 0.5, 0.2
    model = Model().replace(
        {"friction_anisotropy.c": e * np.cos(2 * th0), "friction_anisotropy.s": e * np.sin(2 * th0)}
    )
    seen = [0.3 / (3.5 * G * lasts(model, 0.3, th)) / mu for th in th0 + np.pi * np.array([0, 1, 0.5, 0.2, 0.7])]
    np.testing.assert_allclose(seen[:3], [1 + e, 1 + e, 1 - e], rtol=1e-9)
    assert seen[3] + seen[4] == pytest.approx(2, rel=1e-9)
    assert seen[3] != pytest.approx(1, abs=0.05)


def test_adhesion_slides_as_under_a_larger_gravity():
    times = np.linspace(0, 0.2, 30)
    one = slide_of(Model().replace({"adhesion.pull": 0.7}), 0.4)
    two = slide_of(Model(gravity=1.7 * G), 0.4)
    np.testing.assert_allclose(one.at(times)[..., :8], two.at(times)[..., :8], rtol=0, atol=1e-9)


def test_plate_tilt_gives_a_rolling_ball_the_height_that_it_loses():
    """(7/10) v^2 against g times the drop along the fall line, and nothing across."""
    model = LOSSLESS.replace({"plate_tilt.x": 0.02, "plate_tilt.y": -0.01})
    states = alone(model, 0.2).at(np.linspace(0, 0.1, 20))[0]
    drop = states[:, 0] * np.sin(0.02) + states[:, 1] * np.sin(-0.01)
    gained = 0.7 * ((states[:, 3:5] ** 2).sum(axis=-1) - 0.2**2)
    np.testing.assert_allclose(gained, G * drop, rtol=0, atol=1e-12)
    across = states[:, 3] * np.sin(-0.01) - states[:, 4] * np.sin(0.02)
    np.testing.assert_allclose(across, across[0], rtol=0, atol=1e-12)


# Measured values as listed by the course CalcDEMma, Indiana University of Pennsylvania (drag07); the last is Stokes's.
MEASURED_DRAG = [(3.02, 10.86), (7.015, 5.623), (15.49, 3.388), (57.54, 1.479), (144.5, 0.9204), (264.9, 0.7194)]


@pytest.mark.parametrize(("reynolds", "drag"), MEASURED_DRAG)
def test_air_drag_is_the_measured_drag_of_spheres(reynolds, drag):
    density, viscosity = 1.204, 1.516e-5
    speed = reynolds * viscosity / (2 * R)
    push = AirDrag(share=1.0).push(np.zeros((1, 2)), np.array([[speed, 0.0]]), np.array([R]), np.array([M]))
    force = drag * np.pi * R**2 * density * speed**2 / 2
    assert -push[0, 0] * M == pytest.approx(force, rel=0.10 if reynolds > 1 else 0.003)
    assert push[0, 1] == 0


def test_rolling_quadratic_alone_makes_a_logarithm_of_the_path():
    """v' = -K v^2: x = ln(1 + K v0 t)/K."""
    model, times = LOSSLESS.replace({"rolling_quadratic.K": 5.0}), np.linspace(0, 0.1, 20)
    x = alone(model, 0.5).at(times)[0, :, 0]
    np.testing.assert_allclose(x, np.log1p(5.0 * 0.5 * times) / 5.0, rtol=0, atol=1e-12)
