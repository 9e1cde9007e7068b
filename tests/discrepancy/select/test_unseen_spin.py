"""Contacts of balls whose strikers spin unseen: impacts that are integrated step by step, and measured with errors."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from discrepancy.data.contacts import Contacts
from discrepancy.select.contact_effects import select_contact_laws
from discrepancy.select.unseen_spin import COULOMB, FALLING, SHARE, FrictionFit

ANGLE_ERROR, NORMAL_ERROR, ACROSS_ERROR = 0.006, 0.015, 0.015  # rad, and of the velocities after the hit over the speed
SCATTER = 0.01  # of the friction from hit to hit
SPIN = "with an unseen spin of the striker"


def rub(mu):
    """Friction over the normal impulse, by surfaces that meet in small steps; mu: function of the slip speed.

    Balls of 1 kg. An impulse dJ on both surfaces changes their relative velocity by (1 + 1) (1 + 5/2) dJ.
    """

    def find(across, down, normal_impulse, steps=200):
        slip, impulse = np.array([across, down]), 0.0
        for _ in range(steps):
            size = np.hypot(*slip)
            step = min(mu(size) * normal_impulse / steps, size / 7) * slip / max(size, 1e-12)
            impulse, slip = impulse + step[0], slip - 7 * step
        return impulse / normal_impulse

    return find


def stop(share):
    """The friction that stops a share of the tangential velocity of surfaces, as if balls could not turn."""
    return lambda across, down, normal_impulse: share * across / 2 / normal_impulse


def draw(friction, seed, count=74, width=0.0, glides=False):
    """Measured hits of 1 to 5 m/s; an error of the line of centres enters all that is measured from it."""
    rng, rows = np.random.default_rng(seed), []
    for clip in range(count):
        speed, sine, r = rng.uniform(1, 5), rng.uniform(0.05, 0.85), rng.normal(0.96, 0.02)
        before = speed * np.array([np.sqrt(1 - sine**2), sine])
        normal_impulse = (1 + r) / 2 * before[0]
        down = 0.0 if glides else before[0]
        ratio = friction(before[1] + width * speed * rng.standard_normal(), down, normal_impulse)
        across = 2 * normal_impulse * (ratio + SCATTER * rng.standard_normal())
        after = np.array([-r * before[0], before[1] - across])
        after += speed * np.array([NORMAL_ERROR, ACROSS_ERROR]) * rng.standard_normal(2)
        angle = ANGLE_ERROR / np.sqrt(1 - sine**2) * rng.standard_normal()
        frame = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        (into, along), (out, along_after) = frame @ before, frame @ after
        values = {
            "v0": (speed, 0.002),
            "b": (along / speed, ANGLE_ERROR),
            "r": (-out / into, NORMAL_ERROR * speed / into),
        }
        values["s"] = along_after / along, ACROSS_ERROR * speed / abs(along)
        row = {
            f"{name}_local{end}": x for name, pair in values.items() for end, x in zip(("", "_std"), pair, strict=True)
        }
        row |= {"clip": clip, "striker": "b", "status": "misfit", "local": "{}", "local_shared": "{}"}
        rows.append(row | {"mass_ratio": 1.0, "mass_ratio_std": 0.01, "motion_local": "glide" if glides else "roll"})
    return Contacts.of(rows)


def name_friction(contacts):
    return next(claim for claim in select_contact_laws(contacts) if claim.quantity == "friction")


def test_coulomb_friction_beside_an_unseen_spin_is_named_alone():
    claims = [name_friction(draw(rub(lambda slip: 0.12), seed, count=120, width=0.7)) for seed in (1, 2, 3, 4)]
    for claim in claims:
        assert claim.law == f"Coulomb friction, {SPIN}"
        for number, true in zip(claim.numbers, (0.12, 0.7), strict=True):
            assert abs(number.value - true) < 3 * number.std < true / 2
    alone = [claim for claim in claims if claim.causes == ("ball_friction",)]
    assert len(alone) >= 3
    assert all("a share of the tangential speed stops" in claim.excluded for claim in alone)


def test_friction_that_falls_is_named_beside_an_unseen_spin_if_it_falls():
    claim = name_friction(draw(rub(lambda slip: 0.05 + 0.54 * np.exp(-slip / 0.92)), 1, count=120, width=0.7))
    assert claim.causes == ("falling ball_friction",)
    assert claim.law.endswith(SPIN)


@pytest.mark.parametrize("seed", [1, 2])
def test_no_spin_is_named_where_there_is_none(seed):
    claim = name_friction(draw(rub(lambda slip: 0.09), seed))
    assert claim.law == "Coulomb friction"
    assert not any(SPIN in rival for rival in claim.rivals)
    assert abs(claim.numbers[0].value - 0.09) < 3 * claim.numbers[0].std


@pytest.mark.parametrize(("share", "width"), [(0.08, 0.0), (0.25, 0.0), (0.08, 0.75), (0.2, 0.5)])
def test_a_share_is_not_excluded_where_it_is_true(share, width):
    """A spin with a share has no limit, so that it does not scatter the friction as Coulomb's law does."""
    for seed in (1, 2):
        claim = name_friction(draw(stop(share), seed, width=width))
        assert "spin_transfer" in claim.causes or not claim.causes
        assert SPIN not in claim.law or claim.law.startswith("a share")


@pytest.mark.parametrize("kind", ["normal", "uniform"])
def test_scatter_without_a_law_is_no_friction_beside_a_spin(kind):
    """The friction does not oppose the slip. A wide spin would give Coulomb friction a uniform scatter too."""
    rng = np.random.default_rng(8)
    scatter = {"normal": rng.standard_normal, "uniform": lambda: rng.uniform(-1.73, 1.73)}[kind]
    for seed in range(20):
        assert not name_friction(draw(lambda *_: 0.08 * scatter(), seed, count=120)).causes


def test_no_spin_of_bodies_that_glide_is_named():
    """It would turn their friction around, but the limit at which their rims stick is not known."""
    balls, discs = (draw(rub(lambda slip: 0.12), 2, count=120, width=0.7, glides=glides) for glides in (False, True))
    assert SPIN in name_friction(balls).law
    assert SPIN not in name_friction(discs).law


def test_the_likelihood_without_a_spin_is_that_of_normal_errors():
    contacts = draw(stop(0.1), 3)
    rng = np.random.default_rng(4)
    std, shared = contacts.friction_std, 0.02 * rng.standard_normal((len(contacts), 3))
    fit = FrictionFit.of(SHARE, contacts, (std, shared), spins=False)
    law = fit.numbers[0] * contacts.speed_t / ((1 + contacts.restitution) * contacts.speed_n)
    covariance = np.diag(std**2 + fit.scatter**2) + shared @ shared.T
    expected = -2 * multivariate_normal.logpdf(contacts.friction - law, cov=covariance)
    assert fit.cost == pytest.approx(expected - len(contacts) * np.log(2 * np.pi), abs=0.01)


@pytest.mark.parametrize("law", [COULOMB, FALLING])
def test_the_density_is_that_of_drawn_spins(law):
    """The share of drawn spins whose friction, with an error, is less than each of nine values."""
    contacts = draw(stop(0.1), 5, count=1)
    speed, normal = float(contacts.speed[0]), float(contacts.speed_n[0])
    numbers = np.array([0.1]) if law is COULOMB else np.array([0.1, 0.05])
    mu = lambda slip: numbers[0] - (numbers[1] * np.log(slip / contacts.slip[0]) if law is FALLING else 0)  # noqa: E731
    fit = FrictionFit(law, 0.0, numbers, 0.0, 0.6, np.zeros(0), np.zeros(0))
    grid = np.linspace(-0.3, 0.3, 601)
    each = dataclasses.replace(contacts, friction=grid)
    density = np.exp(fit.find_log_densities(each, (np.full(601, 0.02), np.zeros((601, 0))))) / np.sqrt(2 * np.pi)
    rng = np.random.default_rng(6)
    across = contacts.speed_t + 0.6 * speed * rng.standard_normal(20_000)
    slip = np.hypot(across, normal)
    ratio = mu(slip) * across / slip
    below = np.cumsum(density) * (grid[1] - grid[0])
    for k in range(60, 601, 60):
        assert below[k] == pytest.approx(norm.cdf((grid[k] - ratio) / 0.02).mean(), abs=0.012)
