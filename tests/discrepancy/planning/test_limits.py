"""Limits and likeness, against dense algebra on the same derivatives and against drawn numbers."""

from functools import cache

import numpy as np
import pytest
from discrepancy_clips import unabsorbed
from discrepancy_plans import small

from discrepancy.fitting.jacobian import differentiate_tracks
from discrepancy.fitting.significance import chi2_to_sigma
from discrepancy.planning.limits import Signatures, chi2_to_detect

PAIR = ("air_drag", "rolling_quadratic")


@cache
def limits(noise_px=None, only=PAIR):
    return {x.strength: x for x in Signatures.of(small(noise_px), only).limits()}


def columns(name):
    """Whitened derivatives by a strength less all that the fit absorbs, (points,)."""
    here = small()
    slopes = differentiate_tracks(here.model, here.launches, here.clips, name)
    return unabsorbed(here.fit(), np.concatenate(here.evidence.whiten(slopes))[:, None])[:, 0]


def test_a_limit_is_five_over_the_length_of_the_signature():
    for name, found in limits().items():
        assert found.limit == pytest.approx(5 / np.linalg.norm(columns(name)), rel=1e-3)


def test_a_naming_limit_is_five_over_what_the_rival_leaves():
    one, other = columns("air_drag.share"), columns("rolling_quadratic.K")
    left = one - other * (one @ other) / (other @ other)
    found = limits()["air_drag.share"]
    assert found.naming_limit == pytest.approx(5 / np.linalg.norm(left), rel=1e-3)
    assert [r.effect for r in found.rivals] == ["rolling_quadratic"]
    assert found.rivals[0].cosine == pytest.approx(abs(one @ other) / np.linalg.norm(one) / np.linalg.norm(other), 1e-3)


def test_limits_grow_with_the_noise():
    one, two = (limits(px)["rolling_quadratic.K"].limit for px in (0.01, 0.03))
    assert two == pytest.approx(3 * one, rel=1e-6)


def test_what_the_fit_absorbs_does_not_show():
    """A wrong clock is another friction and other speeds, but for what differences of finite steps leave of it."""
    found = limits(only=("clock_error", "hop"))
    assert found["clock_error.e"].limit > 100 * found["clock_error.e"].typical
    assert not found["clock_error.e"].shows
    assert found["hop.share"].rivals == ()  # and is nobody's rival


def test_limits_hold_for_realistic_shapes():
    found = limits(only=("stribeck", "viscous_friction"))
    assert found["stribeck.rise"].shapes == {"stribeck.slip": pytest.approx(0.1)}
    assert found["stribeck.rise"].best < found["stribeck.rise"].limit < found["stribeck.rise"].worst
    assert found["stribeck.rise"].indistinguishable == ("viscous_friction",)


@pytest.mark.parametrize(("dof", "factor"), [(1, 1.0), (2, 1.0), (2, 80.0), (3, 1.0)])
def test_half_of_all_experiments_show_more_than_five_sigma_at_the_limit(dof, factor):
    draws = np.random.default_rng(1).noncentral_chisquare(dof, chi2_to_detect(dof, factor), 4001)
    assert chi2_to_sigma(float(np.median(draws)), dof, factor) == pytest.approx(5, abs=0.05)
