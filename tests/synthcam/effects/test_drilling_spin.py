"""A drilling spin is Coulomb friction over a Hertz contact."""

import numpy as np
import pytest

from synthcam.effect import ActiveLaws
from synthcam.effects.adhesion import Adhesion
from synthcam.effects.drilling_spin import DrillingSpin
from synthcam.effects.viscous_friction import ViscousFriction
from synthcam.model import Model

R, M, G = Model().ball.radius, Model().ball.mass, 9.81


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
    laws = ActiveLaws([DrillingSpin(a=2e-5), Adhesion(pull=2.0), ViscousFriction(k=0.5)])
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
