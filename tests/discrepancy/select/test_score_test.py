"""Score tests: the chi^2 of a dense linear fit, at the level that they claim when nothing is hidden."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from discrepancy_clips import collisions, exact, noisy

from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.fitting.parameters import BASE_PARAMETERS, Candidate
from discrepancy.fitting.predict import predict_tracks
from discrepancy.noise.model import estimate_noise
from discrepancy.select.score_test import ScoreTests, largest_cosine
from synthcam.library import library
from synthcam.model import Model


def contest_of(clips, names=BASE_PARAMETERS):
    noise = estimate_noise(clips)
    evidence = WhitenedClips.of(clips, noise)
    return evidence, ScoreTests.of(evidence, fit_model(clips, Model(), names, noise))


@cache
def nothing():
    return contest_of(collisions(Model(), 6, 5))


def with_residuals(tests, left):
    """The contest with other whitened residuals, of all clips in a row."""
    cuts = np.cumsum([len(r) for r in tests.fit.residuals])[:-1]
    other = dataclasses.replace(tests, fit=dataclasses.replace(tests.fit, residuals=tuple(np.split(left, cuts))))
    vars(other).update({k: v for k, v in vars(tests).items() if k.startswith("_")})  # all that is known by now
    return other


def absorbed(fit):
    """All that the fit absorbs as one dense matrix: shared parameters, and launches clip by clip."""
    rows = np.cumsum([0, *(len(r) for r in fit.residuals)])
    launches = np.zeros((rows[-1], 6 * len(fit.residuals)))
    for k, own in enumerate(fit.launch_slopes):
        launches[rows[k] : rows[k + 1], 6 * k : 6 * k + 6] = own
    return np.column_stack([np.concatenate(fit.slopes), launches])


def remainder(columns, left):
    unit = columns / np.linalg.norm(columns, axis=0)
    return float(np.sum((left - unit @ np.linalg.lstsq(unit, left, rcond=None)[0]) ** 2))


@pytest.mark.parametrize("effect", ["velocity_restitution", "plate_tilt", "stribeck"])
def test_a_gain_is_that_of_a_dense_linear_fit(effect):
    _, tests = nothing()
    left = np.random.default_rng(2).standard_normal(tests.fit.points)
    scored = next(c for c in with_residuals(tests, left).ranking() if c.effect == effect)
    dense = absorbed(tests.fit)
    own = np.concatenate(scored.columns)
    assert scored.gain == pytest.approx(remainder(dense, left) - remainder(np.column_stack([dense, own]), left))
    assert scored.gain > 0.01


def test_an_exchange_is_foretold_as_by_dense_linear_fits():
    clips = collisions(Model().replace({"velocity_restitution.e": 0.005}), 6, 6)
    _, tests = contest_of(clips, names=(*BASE_PARAMETERS, "velocity_restitution.e"))
    fit = tests.fit
    gone = Candidate("velocity_restitution", ("velocity_restitution.e",), (), library()["velocity_restitution"])
    left = np.concatenate(fit.residuals) + np.concatenate(fit.slopes)[:, -1] * fit.model.value(gone.strengths[0])
    dense = np.delete(absorbed(fit), len(BASE_PARAMETERS), axis=1)
    assert tests.chi2(gone) == pytest.approx(remainder(dense, left))
    assert tests.chi2(gone) > fit.chi2 + 50
    rival = next(c for c in tests.ranking(gone) if c.effect == "spin_transfer_velocity")
    both = np.column_stack([dense, np.concatenate(rival.columns)])
    assert tests.chi2(gone) - rival.gain == pytest.approx(remainder(both, left))


@pytest.mark.gate
def test_searches_with_nothing_hidden_claim_something_at_the_level_they_say():
    _, tests = nothing()
    rng, level, draws = np.random.default_rng(3), 0.2, 60
    needed = tests.claim(level)
    best = []
    for _ in range(draws):
        best.append(with_residuals(tests, rng.standard_normal(tests.fit.points)).ranking()[0].sigma)
    assert 3 <= sum(b > needed for b in best) <= 21  # 12 +- 3.1
    assert sum(b > 1.28 for b in best) > 50  # the level of a single test
    assert 3.8 < tests.claim() < 4.5


def test_a_strength_of_one_sign_scores_nothing_the_other_way():
    _, tests = nothing()
    hop = next(t for t in tests.trials if t.candidate.name == "hop")
    signature = np.concatenate(hop.columns)[:, 0]
    signature *= 100 / np.linalg.norm(signature)
    for sign, least in ((1, 5.0), (-1, 0.0)):
        ranking = with_residuals(tests, sign * signature).ranking()
        hop = next(c for c in ranking if c.effect == "hop")
        assert hop.sigma > least if sign > 0 else hop.sigma == 0


def test_what_these_collisions_cannot_show_is_said():
    _, tests = nothing()
    identifiable = {c.effect: c.identifiable for c in tests.ranking()}
    assert not identifiable["clock_error"]  # absorbed exactly
    assert not identifiable["adhesion"]
    assert identifiable["velocity_restitution"]
    alike = [
        dataclasses.replace(c, launch=c.launch * [1, 1, 1, 0, 1, 0] + [0, 0, 0, 0.3, 0, 0.1])
        for c in exact(Model(), 6, 5)
    ]
    _, same = contest_of(moved(alike))
    identifiable = {c.effect: c.identifiable for c in same.ranking()}
    assert not identifiable["velocity_restitution"]  # one speed of impact, one restitution
    assert identifiable["stribeck"]


def moved(clips):
    """The clips as their launches would have them, with noise."""
    paths = predict_tracks(Model(), np.array([c.launch for c in clips]), clips)
    return noisy([dataclasses.replace(c, xy=xy) for c, xy in zip(clips, paths, strict=True)], 5)


def test_a_shape_is_made_out_between_those_tried():
    hidden = Model().replace({"stribeck.rise": 0.1, "stribeck.slip": 0.15})
    evidence, tests = contest_of(collisions(hidden, 6, 7))
    coarse = next(c for c in tests.ranking() if c.effect == "stribeck")
    fine = tests.sharper(evidence, coarse)
    assert fine.gain > coarse.gain
    assert abs(np.log(fine.shapes["stribeck.slip"] / 0.15)) < abs(np.log(coarse.shapes["stribeck.slip"] / 0.15))
    assert fine.shapes["stribeck.slip"] == pytest.approx(0.15, rel=0.15)


def test_likeness_is_a_cosine():
    rng = np.random.default_rng(4)
    one, other = np.linalg.qr(rng.standard_normal((50, 2)))[0].T
    assert largest_cosine(one[:, None], 3 * one[:, None]) == pytest.approx(1)
    assert largest_cosine(one[:, None], other[:, None]) == pytest.approx(0, abs=1e-12)
    assert largest_cosine(one[:, None], (0.6 * one + 0.8 * other)[:, None]) == pytest.approx(0.6)
    assert largest_cosine(one[:, None], np.zeros((50, 0))) == 0


def test_signatures_of_the_library_can_be_told_apart():
    signatures = {c.effect: c.signature for c in nothing()[1].ranking()}
    assert largest_cosine(signatures["velocity_restitution"], signatures["rolling_quadratic"]) < 0.9
    assert largest_cosine(signatures["mass_mismatch"], signatures["diameter_mismatch"]) > 0.9
