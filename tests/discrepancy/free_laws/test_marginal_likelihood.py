"""The share that a free curve explains, against the marginal likelihood written out and against noise alone."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import multivariate_normal

from discrepancy.free_laws.library import list_free_laws
from discrepancy.free_laws.marginal_likelihood import (
    PRIOR_LENGTHS,
    compute_significance,
    cost_of_strengths,
    maximise_evidence,
)
from discrepancy.free_laws.ranges import Axis

LAWS = {law.base_name: law for law in list_free_laws()}
LAW = dataclasses.replace(LAWS["restitution_speed"], axes=(Axis("normal speed", "m/s", 0.1, 0.6, 8),))
RNG = np.random.default_rng(5)
DESIGN = LAW.basis(RNG.uniform(0.1, 0.6, 30)) @ np.diag(RNG.uniform(1, 4, 8))


def evidence(left, prior, size):
    """-2 ln of no curve's likelihood less that of a curve of this size."""
    none = multivariate_normal(np.zeros(30), np.eye(30))
    some = multivariate_normal(np.zeros(30), np.eye(30) + size**2 * DESIGN @ np.diag(prior.spread) @ DESIGN.T)
    return 2 * (some.logpdf(left) - none.logpdf(left))


def test_the_gain_is_the_mean_marginal_likelihood_of_all_lengths_each_of_its_best_size():
    left = DESIGN @ RNG.standard_normal(8) + RNG.standard_normal(30)
    weight = maximise_evidence(LAW, DESIGN.T @ DESIGN, DESIGN.T @ left)
    prior = weight.prior

    def best(length):
        some = dataclasses.replace(prior, spread=LAW.prior_variances(length))
        found = minimize_scalar(lambda s: -evidence(left, some, np.exp(s)), bounds=(-6, 6), method="bounded")
        return -found.fun

    every = np.array([best(length) for length in PRIOR_LENGTHS])
    assert weight.gain == pytest.approx(2 * np.log(np.exp((every - every.max()) / 2).mean()) + every.max(), abs=0.1)
    assert prior.length == PRIOR_LENGTHS[every.argmax()]
    assert evidence(left, prior, prior.size) - prior.cost == pytest.approx(weight.gain)
    for other in (0.7, 1.4):
        assert evidence(left, prior, other * prior.size) < evidence(left, prior, prior.size)
    matrix = DESIGN.T @ DESIGN + prior.precision
    assert weight.coefs == pytest.approx(np.linalg.solve(matrix, DESIGN.T @ left))


def test_a_curve_that_is_there_is_worth_its_freedom_and_noise_is_not():
    noise = RNG.standard_normal((200, 30))
    gains = [maximise_evidence(LAW, DESIGN.T @ DESIGN, DESIGN.T @ n).gain for n in noise]
    assert np.quantile(gains, 0.99) < 9.5
    curve = DESIGN @ (3 * np.eye(8)[1])
    assert (
        np.quantile([maximise_evidence(LAW, DESIGN.T @ DESIGN, DESIGN.T @ (n + curve)).gain for n in noise], 0.01) > 9.5
    )


def test_a_field_that_acts_and_changes_along_one_axis_costs_less_freedom():
    axes = Axis("x", "px", 0.0, 1.0, 8), Axis("y", "px", 0.0, 1.0, 8)
    law = dataclasses.replace(LAWS["warp_place"], axes=axes)
    one = law.basis(*RNG.uniform(0, 1, (2, 400)))
    x = np.linspace(0, 1, 50)
    along = np.linalg.lstsq(axes[0].basis(x), x**4, rcond=None)[0]  # a function of x alone, along x alone
    truth = np.outer(along, np.arange(8) == 0).ravel()
    design = np.kron(np.eye(2), one)
    signal = np.concatenate([one @ truth, np.zeros(400)])
    pull = design.T @ (10 * signal / np.linalg.norm(signal - signal.mean()))
    weight = maximise_evidence(law, design.T @ design, pull)
    spread = law.prior_variances(weight.prior.length)
    matrix = np.eye(128) + weight.prior.size**2 * spread[:, None] * (design.T @ design)
    alike = pull @ np.linalg.solve(matrix, weight.prior.size**2 * spread * pull) - np.linalg.slogdet(matrix)[1]
    assert 0 < weight.prior.cost - 4 * np.log(3) < 2 * np.log(len(PRIOR_LENGTHS))
    assert weight.gain > alike + 10
    assert np.abs(weight.coefs[64:]).max() < 1e-6 * np.abs(weight.coefs).max()


def test_significance_is_rare_in_noise():
    scores = np.array(
        [compute_significance(LAW, DESIGN.T @ DESIGN, DESIGN.T @ n) for n in RNG.standard_normal((600, 30))]
    )
    assert 0.01 < np.mean(scores > 1.96) < 0.06  # 5 % of a normal variable; the trials overlap
    assert scores.max() < 4


def test_a_smooth_map_is_found_among_many_coefficients():
    """10 sigma in one smooth direction of 144 are 10 sigma, less what the trials cost; all 144 together are five."""
    axis = Axis("x", "m", 0.0, 1.0, 12)
    plate = dataclasses.replace(LAWS["friction_place"], axes=(axis, axis))
    x, y = RNG.uniform(0, 1, (2, 400))
    design = plate.basis(x, y)
    smooth = 10 * design[:, 1] / np.linalg.norm(design[:, 1])
    assert 8.5 < compute_significance(plate, design.T @ design, design.T @ smooth) <= 10


def test_nothing_seen_is_nothing():
    assert compute_significance(LAW, np.zeros((8, 8)), np.zeros(8)) == 0


@pytest.mark.parametrize("z", [2.0, 10.0, 300.0])
def test_the_price_of_freedom_in_closed_form(z):
    """One number, z standard deviations from zero: 1 + ln z^2. Two alike: twice that. Units are nothing to it."""
    one = 1 + np.log(z**2)
    assert cost_of_strengths(np.eye(1), np.array([z])) == pytest.approx(one, abs=0.02)
    assert cost_of_strengths(np.eye(2), np.array([z, -z])) == pytest.approx(2 * one, abs=0.04)
    assert cost_of_strengths(1e6 * np.eye(2), np.array([z, z]) / 1e3) == pytest.approx(2 * one, abs=0.04)
    assert cost_of_strengths(np.eye(2), np.array([0, z])) == pytest.approx(
        min(one + 2 * np.log(3), 2 + 2 * np.log(z**2 / 2)), abs=0.04
    )


def test_nothing_found_costs_nothing_more_than_it_gains():
    assert cost_of_strengths(np.eye(1), np.array([0.5])) == pytest.approx(0.25)
