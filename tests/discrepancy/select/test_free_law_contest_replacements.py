"""Beside a free law an effect is told from others that could stand there."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import exact, noisy

from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.fitting.parameters import BASE_PARAMETERS, candidates_by_name
from discrepancy.free_laws.library import free_laws_over
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.policy import current_policy
from discrepancy.select.free_law_contest import find_replacements
from discrepancy.select.law_fit import (
    fit_law,
    fit_law_with_effect,
    refit_without_effect,
    score_law,
)
from discrepancy.select.score_test import ScoreTests
from synthcam.model import Model

NOISE = Noise(NoiseComponent(1.0))
CLIPS = 6
SLIP, RISE, SCATTER = 0.25, 0.03, 0.003


@pytest.fixture(scope="module")
def rubbed():
    """Friction is another in each clip, and falls with the slip, over so wide a range that viscous friction is near."""
    model, clips = Model().replace({"stribeck.rise": RISE, "stribeck.slip": SLIP}), []
    for k, mu in enumerate(np.random.default_rng(2).normal(0.24, SCATTER, CLIPS)):
        clips.append(exact(model.replace({"sliding_friction": mu}), CLIPS, 6)[k])
    clips = noisy(clips, 6)
    base, evidence = fit_model(clips, Model(), BASE_PARAMETERS, NOISE), WhitenedClips.of(clips, NOISE)
    law = next(s for s in free_laws_over(base.model, base.launches, clips) if s.name == "friction_clip")
    known = fit_law(evidence, score_law(evidence, law, base), base)
    tests = ScoreTests.of(known.evidence, known.joint_fit, about=known.model_without_law)
    return evidence, base, known, {c.effect: c for c in tests.ranking()}


def beside(rubbed, name, **shapes):
    evidence, base, known, ranking = rubbed
    scored = dataclasses.replace(ranking[name], shapes={f"{name}.{k}": v for k, v in shapes.items()})
    return fit_law_with_effect(evidence, known, scored, base)


@pytest.fixture(scope="module")
def wrong_effect(rubbed):
    """Viscous friction beside the free law: its sigma, the fit, the effect, and the fit without it."""
    evidence, base, *_ = rubbed
    sigma, wrong = beside(rubbed, "viscous_friction")
    named = candidates_by_name(wrong.model_without_law, base.model, base.names)["viscous_friction"]
    return sigma, wrong, named, refit_without_effect(evidence, wrong, named, base)


def test_what_fits_better_in_the_place_of_an_effect_is_found(rubbed, wrong_effect):
    evidence, base, *_ = rubbed
    sigma, wrong, named, less = wrong_effect
    ((name, best), *_) = find_replacements(evidence, less, named, (), base)
    assert sigma > current_policy().free_law_sigma
    assert name == "stribeck"
    assert best.score < wrong.score - current_policy().rival_excluded_chi2
    assert best.model_without_law.value("stribeck.slip") == pytest.approx(
        SLIP, abs=4 * best.joint_fit.std["stribeck.slip"]
    )


@pytest.mark.gate
def test_a_shape_parameter_is_found_from_far_beside_a_free_law(rubbed):
    near, *far = (beside(rubbed, "stribeck", slip=s)[1].score for s in (SLIP, 0.1, 0.3))
    assert far == pytest.approx([near, near], abs=1)


def test_an_effect_that_is_no_rival_is_not_asked(rubbed, wrong_effect):
    evidence, base, *_ = rubbed
    _, _, named, less = wrong_effect
    assert "stribeck" not in [name for name, _ in find_replacements(evidence, less, named, ("stribeck",), base)]
