"""The summary of a free law, as files have it."""

import dataclasses
import json

import numpy as np
import pytest
from discrepancy_clips import exact, noisy
from discrepancy_outsiders import each_outsider, outsider
from discrepancy_selected import challenged

from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.parameters import BASE_PARAMETERS
from discrepancy.free_laws.law_summary import LawSummary, describe_law
from discrepancy.free_laws.library import free_laws_over
from discrepancy.noise.model import Noise, NoiseComponent
from synthcam.model import Model


@each_outsider
def test_bands_lie_about_the_curve_and_one_in_the_other(law):
    said = outsider(law).document()["outside"][0]
    curve, wide, narrow = (np.array(said[k]) for k in ("curve", "band", "band68"))
    assert np.all((wide[:, 0] < narrow[:, 0]) & (narrow[:, 0] < curve))
    assert np.all((curve < narrow[:, 1]) & (narrow[:, 1] < wide[:, 1]))
    assert json.loads(json.dumps(said)) == said


@pytest.mark.gate
def test_a_map_is_given_at_pairs_within_its_ranges():
    found = outsider("friction_place")
    x = np.array(found.document()["outside"][0]["x"])
    assert x.shape == (25 * 25, 2)
    for values, axis in zip(x.T, found.free_law.law.axes, strict=True):
        assert (values.min(), values.max()) == pytest.approx((axis.low, axis.high))


def test_words():
    clips = exact(Model(), 6, 9)
    laws = {law.name: law for law in free_laws_over(Model(), np.array([c.launch for c in clips]), clips)}
    assert describe_law(laws["friction_place"]) == "mu that depends on the position"
    assert describe_law(laws["restitution_speed"]) == "r that depends on the normal speed"
    assert describe_law(laws["spin_transfer_speed"]) == "C that depends on the contact speed"


def test_a_number_for_each_clip_is_given_with_the_clips_own_number():
    numbers = [0, 2, 3, 7, 9, 20]
    plain = [dataclasses.replace(c, clip=n) for c, n in zip(exact(Model(), 6, 9), numbers, strict=True)]
    starts, noise = np.array([c.launch for c in plain]), Noise(NoiseComponent(1.0))
    law = next(s for s in free_laws_over(Model(), starts, plain) if s.name == "restitution_clip")
    clips = noisy(law.subtract_from(plain, Model(), starts, 3e-3 * np.array([1, -1, 0, 2, -2, 0])), 9)
    filled = challenged(clips, fit_model(clips, Model(), BASE_PARAMETERS, noise), noise)
    answer = LawSummary.of(next(f for f in filled if f.law.name == "restitution_clip"))
    assert answer.x[0].tolist() == answer.document()["x"] == numbers
    assert len(answer.curve) == len(numbers)
