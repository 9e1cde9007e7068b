"""Contacts that are too short to be seen: held to Hertz's equation, to draws, and to clips of known contacts."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import norm
from tracker_contacts import SoftHit

import tracker
from tracker.measurement import estimate
from tracker.measurement.collision.hidden_duration import compute_steel_duration, estimate_hidden_duration

pytestmark = pytest.mark.usefixtures("not_local")


@pytest.mark.parametrize(("diameter", "closing"), [(0.05, 0.3), (0.00238, 0.14)])
def test_steel_balls_touch_for_as_long_as_hertz_forces_integrate_to(diameter, closing):
    mass = 7800 * np.pi * diameter**3 / 6
    stiffness = 4 / 3 * 206e9 / (2 * (1 - 0.3**2)) * np.sqrt(diameter / 4)

    def rates(t, y):
        return [y[1], -stiffness * max(y[0], 0.0) ** 1.5 / (mass / 2)]

    def leaves(t, y):
        return y[0] if y[1] < 0 else 1.0

    leaves.terminal = True
    depth = (mass / 2 * closing**2 / stiffness) ** 0.4
    found = solve_ivp(rates, (0, 20 * depth / closing), [0.0, closing], events=leaves, rtol=1e-9, atol=1e-15)
    assert compute_steel_duration(diameter, closing) == pytest.approx(found.t[-1], rel=2e-3)


@pytest.mark.parametrize("measured", [-1.0, 0.0, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("std", [2e-5, 1e-4, 5e-4])
def test_the_duration_is_that_of_drawn_contacts_that_measure_the_same(measured, std):
    """One in fifty is soft. The logarithm of the duration is even from .1 to .3 ms, and of soft ones up to 30 ms."""
    rng, shortest, n = np.random.default_rng(0), 1e-4, 1_000_000
    soft, share = rng.random(n) < 0.02, rng.random(n)
    lasts = np.where(soft, 3e-4 * (0.03 / 3e-4) ** share, shortest * 3**share)
    drawn = np.sqrt(np.average(lasts**2, weights=norm.pdf(measured * std, lasts, std)))
    assert estimate_hidden_duration(measured * std, std, shortest) == pytest.approx(drawn, rel=0.05, abs=0.01 * std)


def list_scores(hit, seeds):
    """List z of r, and its standard error, of a hit with different noise."""
    rows = [
        tracker.measure(hit.tracks(np.random.default_rng(k)), hit.camera, unit="m").estimates.iloc[0] for k in seeds
    ]
    return np.array([((row["r"] - hit.r) / row["r_std"], row["r_std"]) for row in rows])


@pytest.mark.parametrize("measured", [0.0, 0.5, 1.0])
def test_a_contact_measured_as_the_shortest_or_less_is_hardly_an_instant(measured):
    """If noise hides it, a real contact lasts at least as long as one of steel, whatever simulations do."""
    shortest = compute_steel_duration(0.057, 0.3)
    assert shortest == pytest.approx(2.2e-4, rel=0.05)
    assert estimate_hidden_duration(measured * shortest, shortest, shortest) > 0.7 * shortest


@pytest.mark.gate
def test_the_shortest_contacts_of_steel_balls_of_50_mm_are_within_the_errors_of_r():
    """Friction presses the balls together for as long as they touch: without that, r was up to 6 errors off."""
    hit = SoftHit(2e-4, 0.79, v0=0.26, b=0.19, friction=0.24, fps=250.0, noise=1.8e-5, before=20, after=87)
    scores = list_scores(replace(hit, law="viscous"), range(8))[:, 0]
    assert np.isfinite(scores).all()
    assert np.sqrt(np.mean(scores**2)) < 1.6  # 2.5 sampling errors over 1
    assert np.abs(scores).max() < 3.5


@pytest.mark.gate
def test_small_balls_that_touch_for_an_instant_keep_their_errors(monkeypatch):
    hit = SoftHit(0.0, 0.9, v0=0.14, b=0.1, friction=0.1, fps=500.0, diameter=0.00238, noise=4e-7, before=40, after=150)
    wide = list_scores(hit, range(6))[:, 1]
    monkeypatch.setattr(estimate, "add_contact_errors", lambda fit, values, camera, distance: values)
    narrow = list_scores(hit, range(6))[:, 1]
    assert (wide >= narrow).all()
    assert np.median(wide / narrow) < 1.02
