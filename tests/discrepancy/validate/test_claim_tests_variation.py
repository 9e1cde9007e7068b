"""A true effect is the same in all collisions; what only resembles one is not."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import collisions

from benchmarks.search.sealed.ordinary import ORDINARY
from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.fitting.parameters import BASE_PARAMETERS
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.validate.claim_tests import StrengthVariation, find_strength_variation
from synthcam.library import library
from synthcam.model import Model

CLAIMED = Noise(NoiseComponent(1.0))


def fitted(hidden, name, seed):
    """Compute the sigma of an effect in 16 collisions with a hidden cause, and the quantity that it depends on most."""
    clips = collisions(dataclasses.replace(Model(), effects=(hidden,)), 16, seed)
    base = fit_model(clips, Model(), BASE_PARAMETERS, CLAIMED)
    best = fit_model(clips, Model(), [*BASE_PARAMETERS, name], CLAIMED, base.launches)
    return np.sqrt(base.chi2 - best.chi2), find_strength_variation(WhitenedClips.of(clips, CLAIMED), best, [name])


@pytest.mark.gate
@pytest.mark.parametrize(
    ("name", "value"), [("plate_tilt.x", 1e-3), ("stribeck.rise", 0.1), ("velocity_restitution.e", 0.05)]
)
def test_a_true_effect_is_the_same_everywhere(name, value):
    effect, _, own = name.partition(".")
    seen = [fitted(library()[effect](**{own: value}), name, seed) for seed in range(6)]
    assert min(sigma for sigma, _ in seen) > 8
    assert max(found.sigma for _, found in seen) < 4


def test_what_resembles_an_effect_is_told_by_where_it_changes():
    """Friction that rises at slow slip, as stribeck's does, but on one half of the plate."""
    sigma, found = fitted(ORDINARY["half_polished"](rise=0.3), "stribeck.rise", 5)
    assert sigma > 8
    assert found.against in ("position", "heading")  # balls are hit in the middle of the plate
    assert found.rejects(sigma)


def test_what_resembles_an_effect_is_told_by_when_it_changes():
    """Friction by the angle between slip and way moves the balls for as long as they slide: no restitution does."""
    sigma, found = fitted(ORDINARY["friction_way"](size=0.02), "velocity_restitution.e", 5)
    assert sigma > 8
    assert found.against == "time since the hit"
    assert found.rejects(sigma)


@pytest.mark.parametrize(
    ("sigma", "own", "stands"), [(4.9, 10, True), (5.1, 10, False), (19, 100, True), (21, 100, False)]
)
def test_a_fifth_of_itself_and_five_sigma_refuse_it(sigma, own, stands):
    assert StrengthVariation("speed", sigma).rejects(own) != stands
