"""One bad clip among good ones makes no discovery, and a missing effect makes no clip bad."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import collisions

from discrepancy.data.launch import HEADING, V0
from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.parameters import BASE_PARAMETERS
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.validate.outlier_clips import find_outlier_clips
from synthcam.model import Model

CLAIMED = Noise(NoiseComponent(1.0))


def pushed(clip, size):
    """Ball 1 of a clip is pushed along while it rolls, as if something stood in its way."""
    late = np.maximum(clip.frame / clip.fps - clip.slide_ends[0], 0) * (clip.ball == 0)
    way = np.array([np.cos(clip.launch[HEADING]), np.sin(clip.launch[HEADING])])
    return dataclasses.replace(clip, xy=clip.xy + size * late[:, None] ** 2 * way)


def fits(clips, effect):
    base = fit_model(clips, Model(), BASE_PARAMETERS, CLAIMED)
    return base, fit_model(clips, Model(), [*BASE_PARAMETERS, effect], CLAIMED, base.launches)


def significance(base, best):
    return np.sqrt(base.chi2 - best.chi2)


@pytest.mark.parametrize("rank", [0, 6])  # by speed, the slower the later
@pytest.mark.parametrize("size", [1e-3, 4e-3])
def test_a_bad_clip_that_makes_a_discovery_is_found(rank, size):
    clips = collisions(Model(), 12, 6)
    bad = sorted(range(12), key=lambda k: -clips[k].launch[V0])[rank]
    clips[bad] = pushed(clips[bad], size * (1 + rank))
    base, best = fits(clips, "rolling_quadratic.K")
    assert significance(base, best) > 4
    found = find_outlier_clips(clips, base, best)
    assert list(found) == [bad]
    assert str(found[bad]).startswith(f"clip {clips[bad].clip}: ")
    assert found[bad].clip == clips[bad].clip
    rest = [c for k, c in enumerate(clips) if k != bad]
    assert significance(*fits(rest, "rolling_quadratic.K")) < 4


@pytest.mark.parametrize(("effect", "value"), [("rolling_quadratic.K", 0.1), ("velocity_restitution.e", 0.05)])
def test_an_effect_makes_no_clip_bad(effect, value):
    clips = collisions(Model().replace({effect: value}), 12, 7)
    base, best = fits(clips, effect)
    assert significance(base, best) > 5
    assert find_outlier_clips(clips, base, best) == {}
    assert find_outlier_clips(clips, base, base) == {}  # nor one that is not found


def test_a_bad_clip_is_found_beside_an_effect():
    clips = collisions(Model().replace({"velocity_restitution.e": 0.05}), 12, 7)
    clips[3] = pushed(clips[3], 4e-3)
    assert list(find_outlier_clips(clips, *fits(clips, "velocity_restitution.e"))) == [3]


def test_noise_makes_no_clip_bad():
    for seed in range(4):
        clips = collisions(Model(), 10, 20 + seed)
        assert find_outlier_clips(clips, *fits(clips, "rolling_quadratic.K")) == {}


def test_one_clip_in_ten_may_be_odd_in_all():
    """One of twelve clips is an outlier, and none is once that one is removed."""
    clips = collisions(Model(), 12, 6)
    clips[3] = pushed(clips[3], 8e-3)
    both = fits(clips, "rolling_quadratic.K")
    assert [list(find_outlier_clips(clips, *both, gone)) for gone in (0, 1)] == [[3], []]


def test_a_clip_that_no_model_predicts_is_found_where_the_base_predicts_none():
    """The base fit misses the effect, so its own chi^2 spreads too widely for any clip to stand out there."""
    clips = collisions(Model().replace({"velocity_restitution.e": 0.3}), 12, 7)
    clips[3] = pushed(clips[3], 2e-2)
    base, best = fits([c for k, c in enumerate(clips) if k != 3], "velocity_restitution.e")
    both = [fit_model(clips, fit.model, (), CLAIMED) for fit in (base, best)]
    assert list(find_outlier_clips(clips, *both)) == [3]
    assert not find_outlier_clips(clips, *both, are_held_out=True)


@pytest.mark.parametrize(("without", "outliers"), [(2.0, []), (12.0, [11]), (320.0, [])])
def test_a_clip_that_the_claims_improve_or_spoil_is_no_outlier(without, outliers):
    """The base fit misses all clips, in one of which the claims leave chi^2 per point 12."""
    clips = collisions(Model(), 12, 7)
    fit, signs = fit_model(clips, Model(), (), CLAIMED), [np.ones(2 * len(c.frame)) for c in clips]
    chi2 = ([*np.geomspace(2, 300, 11), without], [*np.linspace(0.9, 1.2, 11), 12.0])
    both = (
        dataclasses.replace(fit, residuals=tuple(np.sqrt(c) * s for c, s in zip(each, signs, strict=True)))
        for each in chi2
    )
    assert list(find_outlier_clips(clips, *both)) == outliers
