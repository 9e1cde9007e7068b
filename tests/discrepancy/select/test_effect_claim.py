"""An effect as it is named: what it may be confused with."""

import numpy as np
import pytest

from discrepancy.fitting.parameters import Candidate
from discrepancy.select.effect_claim import EffectClaim, find_similar_pairs
from discrepancy.select.score_test import CandidateScore
from synthcam.library import library

KIND = library()["velocity_restitution"]


def scored(name, signature):
    return CandidateScore(Candidate(name, (f"{name}.e",), (), KIND), {}, 9.0, 81.0, 1.0, True, signature, ())


@pytest.mark.parametrize(("cosine", "alike"), [(0.97, False), (0.985, True)])
def test_two_effects_have_the_signature_of_a_third_from_a_cosine_of_98_hundredths(cosine, alike):
    axes = np.eye(20)
    one, other = (scored(n, axes[:, [k]]) for k, n in enumerate(("one", "other")))
    own = cosine * (axes[:, :1] + axes[:, 1:2]) / np.sqrt(2) + np.sqrt(1 - cosine**2) * axes[:, 2:3]
    found = find_similar_pairs(own, [one, other])
    assert [names for names, _ in found] == [("one", "other")] * alike


def test_an_effect_that_is_alike_by_itself_is_in_no_pair():
    axes = np.eye(20)
    own = 0.95 * axes[:, :1] + np.sqrt(1 - 0.95**2) * axes[:, 1:2]
    assert find_similar_pairs(own, [scored("one", axes[:, :1]), scored("other", axes[:, 1:2])]) == ()


def hop(bounce, std):
    return EffectClaim(
        "hop", {"hop.share": 0.02}, {"hop.share": 0.002}, 20.0, ("hop",), {"hop.bounce": bounce}, {"hop.bounce": std}
    )


def test_a_shape_at_an_end_of_its_range_speaks_against_the_effect():
    for std in (0.1, np.inf):
        assert hop(0.9, std).shape_at_limit() == ("hop.bounce", 0.9)
        assert hop(0.0, std).shape_at_limit() is None  # a plate that gives nothing back
        assert hop(0.4, std).shape_at_limit() is None
