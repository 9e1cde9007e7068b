"""The band of a law left free: known laws of the normal speed, seen through an experiment's slopes in white noise."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from discrepancy_clips import exact
from scipy.stats import binom, norm

from discrepancy.data.launch import V0, B
from discrepancy.fitting.gauss_newton import solve_step
from discrepancy.fitting.jacobian import differentiate_tracks, linearise
from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.fitting.parameters import BASE_PARAMETERS
from discrepancy.free_laws.credible_band import NormalMixture, _fit_steps, gain_of_steps
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.library import free_laws_over
from discrepancy.free_laws.marginal_likelihood import maximise_evidence
from discrepancy.noise.model import Noise, NoiseComponent
from synthcam.model import Model

NOISE = Noise(NoiseComponent(1.0))
KNOWN = Model().restitution
EVERY = 8  # of the frames: fewer points tell as much in less time
X = np.linspace(0.12, 0.55, 60)


@cache
def experiment(count=24):
    """Collisions as a linear problem: evidence, fit, law, its columns, and those of each clip's restitution."""
    clips = [
        dataclasses.replace(c, **{k: getattr(c, k)[::EVERY] for k in ("frame", "ball", "xy", "covariance")})
        for c in exact(Model(), count, 11)
    ]
    evidence, launches = WhitenedClips.of(clips, NOISE), np.array([c.launch for c in clips])
    start = linearise(evidence, Model(), BASE_PARAMETERS, launches)
    law = next(s for s in free_laws_over(Model(), launches, clips) if s.name == "restitution_speed")
    moves = evidence.whiten(law.derivatives(Model(), launches, clips))
    single = evidence.whiten(differentiate_tracks(Model(), launches, clips, "restitution"))
    return evidence, start, law, moves, single


def drawn(law, size, seed):
    """The free law fitted to a law `size` times as large as one clip's error of restitution; and that size."""
    evidence, start, free_law, moves, single = experiment()
    rng = np.random.default_rng(seed)
    scale = size / np.sqrt(np.median([s @ s for s in single]))
    speed = start.launches[:, V0] * np.sqrt(1 - start.launches[:, B] ** 2)
    residuals = [s * scale * law(v) + rng.standard_normal(len(s)) for s, v in zip(single, speed, strict=True)]
    fit = dataclasses.replace(start, residuals=tuple(residuals))
    weight = maximise_evidence(free_law, *fit.information(moves))
    rest = [r - m @ weight.coefs for r, m in zip(residuals, moves, strict=True)]
    fit = dataclasses.replace(fit, residuals=tuple(rest))
    shared, own = solve_step(fit, 0.0, np.full(len(BASE_PARAMETERS), -np.inf), np.full(len(BASE_PARAMETERS), np.inf))
    rest = [r - s @ shared - a @ o for r, s, a, o in zip(rest, fit.slopes, fit.launch_slopes, own, strict=True)]
    model = Model().replace({"restitution": KNOWN + float(shared[BASE_PARAMETERS.index("restitution")])})
    fit = dataclasses.replace(fit, residuals=tuple(rest), model=model)
    return FittedLaw(free_law, weight.coefs, weight.prior, fit, Model(), evidence, moves, 0.0, 0.0), scale


def bands(law, size, seed):
    """Compute the truth at X, (n,), the band of 95 %, and that of the smooth curve alone, (2, n) each."""
    filled, scale = drawn(law, size, seed)
    mixture = NormalMixture.of(filled, X)
    curve, covariance = filled.curve(X)
    half = 1.96 * np.sqrt(np.diag(covariance[0]))
    alone = np.stack([curve[:, 0] - half, curve[:, 0] + half])
    return KNOWN + scale * law(X), np.stack([mixture.quantile(z)[:, 0] for z in (-1.96, 1.96)]), alone


def share(truth, band):
    """Compute the share of positions at which the truth lies in the band."""
    return np.mean((band[0] <= truth) & (truth <= band[1]))


def step(x):
    return (1 + np.tanh((x - 0.31) / 0.01)) / 2


def smooth(x):
    return np.sin(x / 0.1)


@pytest.mark.gate
def test_the_band_holds_a_step_as_often_as_it_says():
    """In 70 draws the band holds the truth. That of the smooth curve alone is wider about a wiggle and holds less."""
    draws = [bands(step, 10, seed) for seed in range(70)]
    new, alone = (np.array([share(truth, each[k]) for truth, *each in draws]) for k in (0, 1))
    assert new.mean() > binom.ppf(1e-3, len(draws), 0.95) / len(draws) > alone.mean()
    assert np.mean(new >= 0.9) > 0.8 > 0.6 > np.mean(alone >= 0.9)
    assert np.median([np.ptp(new, axis=0) / np.ptp(old, axis=0) for _, new, old in draws]) < 1


def test_it_is_wide_only_where_the_place_of_a_step_is_uncertain():
    _, band, _ = bands(step, 30, 1)
    width = np.ptp(band, axis=0)
    assert X[width.argmax()] == pytest.approx(0.31, abs=0.05)
    assert np.all(width[np.abs(X - 0.31) > 0.1] < width.max() / 2)


@pytest.mark.parametrize("seed", range(3))
def test_beside_a_smooth_law_nothing_changes(seed):
    _, band, alone = bands(smooth, 10, seed)
    assert band == pytest.approx(alone, abs=0.02 * np.ptp(alone, axis=0).min())


def test_quantiles_of_a_mixture():
    """Quantiles of one normal, of two far apart, and of two about one position, whose distributions are known."""
    one = NormalMixture(np.ones(1), np.full((1, 2, 1), 3.0), np.full((1, 2, 1), 0.5))
    assert one.quantile(1.96) == pytest.approx(np.full((2, 1), 3 + 0.98))
    apart = NormalMixture(np.array([0.25, 0.75]), np.array([[[0.0]], [[100.0]]]), np.ones((2, 1, 1)))
    assert apart.quantile(norm.ppf(0.125)) == pytest.approx(0.0)
    assert apart.quantile(norm.ppf(0.625)) == pytest.approx(100.0)
    about = NormalMixture(np.array([0.5, 0.5]), np.zeros((2, 1, 1)), np.array([[[1.0]], [[2.0]]]))
    at = float(about.quantile(1.0)[0, 0])
    assert (norm.cdf(at) + norm.cdf(at / 2)) / 2 == pytest.approx(norm.cdf(1.0))


@pytest.mark.parametrize("seed", range(3))
def test_a_free_law_is_worth_more_where_the_law_steps_and_a_little_less_where_it_does_not(seed):
    """With a clear step the clips are a hundred times as likely, and more; of a smooth law, the one half is lost."""
    assert gain_of_steps(drawn(step, 30, seed)[0]) > 2 * np.log(100)
    assert gain_of_steps(drawn(smooth, 10, seed)[0]) == pytest.approx(-2 * np.log(2), abs=0.2)


@pytest.mark.parametrize("size", [30, 300])
def test_a_step_below_the_slowest_collision_is_the_constant_whatever_error_the_slopes_have(size):
    filled, _ = drawn(smooth, size, 0)
    bare = dataclasses.replace(filled, fit=filled.fit.subtract(filled.slopes, -filled.coefs))
    where = np.stack(
        [np.linspace(-1.0, -0.5, 20), np.full(20, np.log(0.025))], axis=1
    )  # shares of the range: tanh is 1
    gains, _, _ = _fit_steps(bare, where, X)
    assert gains == pytest.approx(0.0, abs=0.5)  # the law itself has a chi^2 of 20,000 and 2,000,000
