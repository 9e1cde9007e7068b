"""Free laws in the contest: fitted in full they give back what was put in; beside the right effect they are silent."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import CAMERA, FPS, collisions, exact, noisy
from discrepancy_selected import challenged

from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.fitting.parameters import BASE_PARAMETERS
from discrepancy.fitting.predict import predict_tracks
from discrepancy.free_laws.library import free_laws_over
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.policy import current_policy
from discrepancy.select.free_law_contest import FreeLawFits, find_better_law, find_winning_law, is_beaten_by_law
from discrepancy.select.law_fit import fit_law, fit_unseen_clips, score_law, whiten_law_columns
from discrepancy.select.model_cost import compute_cost
from synthcam.model import Model

NOISE = Noise(NoiseComponent(1.0))


def based(clips, model=None):
    return fit_model(clips, model or Model(), BASE_PARAMETERS, NOISE)


def test_a_contact_at_the_edge_of_an_exposure_that_is_too_short_is_no_lag():
    """There the tracks bend sharply with the instant of contact, and launches do not absorb a constant lag."""
    true = np.array([c.launch for c in exact(Model(), 8, 6)])
    true[0, 2] = round(true[0, 2] * FPS) / FPS + 2e-4
    clips = [dataclasses.replace(c, launch=launch) for c, launch in zip(exact(Model(), 8, 6), true, strict=True)]
    seen = [dataclasses.replace(c, xy=xy) for c, xy in zip(clips, predict_tracks(Model(), true, clips), strict=True)]
    short = dataclasses.replace(CAMERA, exposure=2e-4)
    base = based([dataclasses.replace(c, camera=short) for c in noisy(seen, 6)])
    assert base.chi2 > base.points  # the contact is seen
    again = [dataclasses.replace(c, camera=short) for c in noisy(seen, 6)]
    assert "lag_speed" not in [f.law.name for f in challenged(again, base, NOISE)]


def filled_with(name, curve, clips=8, seed=6):
    """Collisions in which one free law is filled with a curve: the free laws that were fitted, and the base."""
    plain = exact(Model(), clips, seed)
    launches = np.array([c.launch for c in plain])
    law = next(s for s in free_laws_over(Model(), launches, plain) if s.name == name)
    x = law.axes[0].grid(200)
    coefs = np.linalg.lstsq(law.basis(x), curve(x), rcond=None)[0]
    measured = collisions(law.add_to(Model(), coefs), clips, seed)
    base = based(measured)
    laws = FreeLawFits(WhitenedClips.of(measured, NOISE), base)
    return laws, laws.challenge(base)


@pytest.fixture(scope="module")
def wavy():
    return filled_with("restitution_heading", lambda th: 2e-3 * np.cos(3 * th), 10)


def test_the_free_law_that_was_filled_is_the_best_and_the_noise_is_left(wavy):
    laws, _ = wavy
    best, base = min(laws.fitted, key=lambda f: f.score), laws.base
    assert best.law.name == "restitution_heading"
    assert best.sigma > 20
    assert best.score < compute_cost(base, base) - current_policy().effect_preferred_chi2
    freedom = best.fit.points - best.fit.parameters - best.law.size
    assert abs(best.fit.chi2 / freedom - 1) < 4 * np.sqrt(2 / freedom)


def test_its_curve_is_the_truth_within_the_band(wavy):
    best = min(wavy[0].fitted, key=lambda f: f.score)
    th = best.law.axes[0].grid(40)
    values, spread = best.curve(th)
    off = values[:, 0] - Model().restitution - 2e-3 * np.cos(3 * th)
    std = np.sqrt(np.diag(spread[0]))
    assert np.mean(np.abs(off) < 1.96 * std) >= 0.9
    assert np.median(std) < 5e-4
    peak, information = best.likelihood_of_curve()
    assert best.law.basis(th) @ peak == pytest.approx(best.law.basis(th) @ best.coefs, abs=1e-3)
    assert np.linalg.eigvalsh(information).min() > -1e-6 * np.linalg.eigvalsh(information).max()


def test_a_fit_of_the_truth_leaves_no_free_law_significant():
    truth = Model().replace({"velocity_restitution.e": 0.02})
    clips = collisions(truth, 8, 7)
    base = based(clips)
    laws = FreeLawFits(WhitenedClips.of(clips, NOISE), base)
    right = fit_model(clips, Model(), (*BASE_PARAMETERS, "velocity_restitution.e"), NOISE)
    assert laws.challenge(base).is_refuted
    after = laws.challenge(right)
    assert not after.is_refuted
    assert not is_beaten_by_law(after, laws)
    assert find_better_law(laws, after) is find_winning_law(laws, after) is None


def test_a_free_law_that_beats_the_base_alone_is_the_outcome(wavy):
    laws, opponent = wavy
    outcome = find_winning_law(laws, opponent)
    assert outcome is not None
    assert outcome.law.name == "restitution_heading"
    assert outcome.significances_of_effects(laws.base) == {}
    assert outcome.model_without_law.effects == ()


def test_a_number_of_each_clip_is_fitted_to_clips_kept_out():
    """Restitution that is another in each clip: the law is found, and clips that it never saw fit as well with it."""
    plain = exact(Model(), 12, 9)
    launches = np.array([c.launch for c in plain])
    law = next(s for s in free_laws_over(Model(), launches, plain) if s.name == "restitution_clip")
    coefs = 3e-3 * np.random.default_rng(3).standard_normal(12)
    shifted = law.subtract_from(plain, Model(), launches, -coefs)
    rng = np.random.default_rng(4)
    clips = [dataclasses.replace(c, xy=c.xy + 1.6e-6 * rng.standard_normal(c.xy.shape)) for c in shifted]
    some, kept_out = clips[:8], clips[8:]
    base = based(some)
    laws = FreeLawFits(WhitenedClips.of(some, NOISE), base)
    best = find_winning_law(laws, laws.challenge(base))
    assert best is not None
    assert best.law.name == "restitution_clip"
    assert best.prior.size == pytest.approx(3e-3, rel=0.7)
    before = fit_model(kept_out, base.model, (), NOISE)
    after = fit_unseen_clips(best, kept_out, before, NOISE)
    assert before.chi2 > 3 * before.points
    assert after.chi2 < 1.1 * after.points


def test_nothing_hidden_fills_no_free_law():
    clips = collisions(Model(), 8, 12)
    base = based(clips)
    laws = FreeLawFits(WhitenedClips.of(clips, NOISE), base)
    assert not laws.challenge(base).is_refuted
    assert laws.fitted == []


def test_what_the_base_holds_rightly_is_no_effect_beside_a_free_law():
    """A strength fitted beside a free law is measured from where the base holds it, here at the truth."""
    held = Model().replace({"rolling_quadratic.K": 0.1})
    clips = collisions(held, 8, 3)
    base, fit = based(clips, held), fit_model(clips, held, (*BASE_PARAMETERS, "rolling_quadratic.K"), NOISE)
    evidence = WhitenedClips.of(clips, NOISE)
    law = next(s for s in free_laws_over(base.model, base.launches, clips) if s.name == "restitution_speed")
    look = score_law(evidence, law, fit, whiten_law_columns(evidence, law, base.model, base.launches))
    filled = fit_law(evidence, look, base)
    assert 0.1 / filled.joint_fit.std["rolling_quadratic.K"] > 30
    assert filled.significances_of_effects(base)["rolling_quadratic"] < 3.5
