"""The laws of motion against derivations that their files do not hold: Lagrangians, quadratures, tables, balances."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from synthcam.dynamics.kinematics import rolling_state
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.effect import Laws
from synthcam.effects.adhesion import Adhesion
from synthcam.effects.air_drag import AirDrag
from synthcam.effects.drilling_spin import DrillingSpin
from synthcam.effects.magnetic_attraction import MagneticAttraction
from synthcam.effects.viscous_friction import ViscousFriction
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


def over_hertz_contact(a, slip, spin, rings=300, spokes=600):
    """Force and torque, of mu N and mu N m, of Coulomb friction under Hertz's pressure where all slides and turns."""
    nodes, weights = np.polynomial.legendre.leggauss(rings)
    angle, weights = (1 + nodes) * np.pi / 4, weights * np.pi / 4  # rho = a sin(angle): the pressure's root is smooth
    around = 2 * np.pi * (np.arange(spokes) + 0.5) / spokes
    x, y = a * np.sin(angle)[:, None] * np.cos(around), a * np.sin(angle)[:, None] * np.sin(around)
    load = 1.5 / np.pi * (weights * np.cos(angle) ** 2 * np.sin(angle))[:, None] * 2 * np.pi / spokes
    assert (load + 0 * x).sum() == pytest.approx(1)
    vx, vy = slip - spin * y, spin * x
    speed = np.hypot(vx, vy)
    return (load * vx / speed).sum(), (load * (x * vy - y * vx) / speed).sum()


@pytest.mark.parametrize("ratio", [1e-4, 0.03, 0.2, 0.5, 0.8, 1.0, 1.3, 2.0, 5.0, 30.0])
@pytest.mark.parametrize("spin", [150.0, -40.0])
def test_drilling_spin_is_coulomb_friction_over_a_hertz_contact(ratio, spin):
    a, mu, load = 3e-5, 0.2, 12.0
    slip = ratio * a * abs(spin)
    force, torque = over_hertz_contact(a, slip, spin)
    effect, ends = DrillingSpin(a=a), ratio < 1e-3 or ratio > 10
    friction = effect.friction(mu, slip, spin)
    assert friction == pytest.approx(mu * force, rel=1e-4 if ends else 0.01)
    twist = effect.drilling(0.0, spin, slip, friction, load, R)
    assert twist == pytest.approx(-mu * load * torque / (0.4 * R**2), rel=1e-3 if ends else 0.01)


def test_drilling_spin_takes_friction_and_load_as_others_bend_them():
    """Thrice the load and friction that grows with slip: the torque is that of both."""
    laws = Laws([DrillingSpin(a=2e-5), Adhesion(pull=2.0), ViscousFriction(k=0.5)])
    instant = {"slip_speed": 1e-3, "spin": 100.0, "gravity": G, "radius": R}
    instant["friction"] = laws("friction", 0.2, instant)
    instant["load"] = laws("normal_load", G, instant)
    force, torque = over_hertz_contact(2e-5, 1e-3, 100.0)
    assert instant["friction"] == pytest.approx(0.2 * (1 + 0.5e-3) * force, rel=0.01)
    expected = -0.2 * (1 + 0.5e-3) * 3 * G * torque / (0.4 * R**2)
    assert laws("drilling", 0.0, instant) == pytest.approx(expected, rel=0.01)


def test_a_realistic_contact_is_hertzs():
    """a^3 = 3 N R / (4 E*), steel (210 GPa, .3) on aluminium (70 GPa, .33): 2.0 um."""
    stiffness = 1 / ((1 - 0.3**2) / 210e9 + (1 - 0.33**2) / 70e9)
    radius = (0.75 * Model().ball.mass * G * R / stiffness) ** (1 / 3)
    assert radius == pytest.approx(2.0e-6, rel=0.02)
    (a,) = DrillingSpin.parameters()
    assert a.typical == pytest.approx(radius, rel=0.02)


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
MEASURED_DRAG += [(512.9, 0.5623), (1e-3, 24e3)]


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
