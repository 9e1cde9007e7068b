"""What a slot found, as files have it."""

import json

import numpy as np
import pytest

from discrepancy.answer import SIDE, words
from discrepancy_outsiders import OUTSIDERS, outsider


@pytest.mark.parametrize("slot", list(OUTSIDERS))
def test_bands_lie_about_the_curve_and_one_in_the_other(slot):
    said = outsider(slot).document()["outside"][0]
    curve, wide, narrow = (np.array(said[k]) for k in ("curve", "band", "band68"))
    assert np.all((wide[:, 0] < narrow[:, 0]) & (narrow[:, 0] < curve))
    assert np.all((curve < narrow[:, 1]) & (narrow[:, 1] < wide[:, 1]))
    assert json.loads(json.dumps(said)) == said


def test_a_map_is_given_at_pairs_within_its_ranges():
    found = outsider("friction_place")
    x = np.array(found.document()["outside"][0]["x"])
    assert x.shape == (SIDE * SIDE, 2)
    for values, axis in zip(x.T, found.slot.slot.axes, strict=True):
        assert (values.min(), values.max()) == pytest.approx((axis.low, axis.high))


def test_words():
    assert words(outsider("friction_place").slot.slot) == "mu that depends on the place"
    assert words(outsider("restitution_speed").slot.slot) == "r that depends on the normal speed"
