"""The experiment that parts two effects, against what trials elsewhere have measured."""

from functools import cache

import pytest
from discrepancy_clips import collisions

from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.parameters import BASE_PARAMETERS, list_candidates
from discrepancy.noise.model import estimate_noise
from discrepancy.planning.compare import ComparedDesign, advise_on_pair, compare_designs
from synthcam.model import Model

CANDIDATES = {s.name: s for s in list_candidates(Model(), BASE_PARAMETERS)}


@cache
def found(one, other):
    clips = collisions(Model(), 8, 5)
    noise = estimate_noise(clips)
    fit = fit_model(clips, Model(), BASE_PARAMETERS, noise)
    pair = [(CANDIDATES[n], next(iter(CANDIDATES[n].grid(Model())))) for n in (one, other)]
    return {d.words: d.cosine for d in compare_designs(clips, noise, fit, *pair)}


def test_exchanged_balls_part_a_hop_from_a_heavier_ball():
    cosines = found("hop", "mass_mismatch")
    assert cosines["the balls exchanged in half of the collisions"] < 0.3 < 0.6 < cosines["these collisions"]
    assert cosines["films twice as long"] > 0.6
    assert all(0 <= c <= 1 + 1e-9 for c in cosines.values())


def test_nothing_parts_a_heavier_ball_from_a_larger_one():
    cosines = found("mass_mismatch", "diameter_mismatch")
    assert min(cosines.values()) > 0.9


def test_the_advice_is_the_best_of_the_designs():
    said = advise_on_pair(
        CANDIDATES["hop"],
        CANDIDATES["mass_mismatch"],
        [ComparedDesign(w, c) for w, c in found("hop", "mass_mismatch").items()],
    )
    assert said.startswith("To distinguish hop and mass_mismatch: the balls exchanged in half of the collisions;")
    hopeless = advise_on_pair(
        CANDIDATES["mass_mismatch"], CANDIDATES["diameter_mismatch"], [ComparedDesign("these collisions", 1.0)] * 3
    )
    assert "No collisions" in hopeless
    assert "weigh the balls" in hopeless


def test_nothing_parts_an_effect_from_one_that_the_fit_absorbs():
    """A wrong clock is another friction and other speeds: it has no signature to be told by."""
    pair = ("clock_error", "rolling_quadratic")
    cosines = found(*pair)
    assert set(cosines.values()) == {1.0}
    said = advise_on_pair(*(CANDIDATES[n] for n in pair), [ComparedDesign(w, c) for w, c in cosines.items()])
    assert said.startswith("No collisions of two balls distinguish ")


def test_effects_that_differ_already_need_more_of_the_same():
    pair = CANDIDATES["friction_mismatch"], CANDIDATES["stribeck"]
    said = advise_on_pair(*pair, [ComparedDesign("these collisions", 0.27), ComparedDesign("longer films", 0.6)])
    assert said.startswith("To distinguish friction_mismatch and stribeck: more collisions like these")


@pytest.mark.parametrize(("cosine", "parted"), [(0.87, True), (0.93, False)])
def test_two_effects_are_parted_under_nine_tenths(cosine, parted):
    pair = CANDIDATES["hop"], CANDIDATES["mass_mismatch"]
    said = advise_on_pair(
        *pair,
        [ComparedDesign("these collisions", 0.99), ComparedDesign("longer films", cosine), ComparedDesign("all", 0.99)],
    )
    assert ("To distinguish hop and mass_mismatch: longer films" in said) is parted
