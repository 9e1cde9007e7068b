"""The residuals of a fit that explains the data tell of slow noise; those of one that does not are not believed."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from discrepancy_clips import FRAMES, STD, collisions, correlated, exact, noise_of_pair

from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.noise_refit import RestrictedResiduals, refit_noise
from discrepancy.fitting.parameters import BASE_PARAMETERS
from discrepancy.noise.model import Noise, NoiseComponent, estimate_noise
from synthcam.model import Model


@cache
def measured(seed, rho=0.0, walk=0.0, hidden=0.0, count=8):
    """Clips, with a random walk that both balls share, and a restitution that falls with speed."""
    rng, out = np.random.default_rng(seed), []
    for c in exact(Model().replace({"velocity_restitution.e": hidden}), count, 5):
        common = walk * STD * np.cumsum(rng.standard_normal((FRAMES, 2)), axis=0)
        out.append(dataclasses.replace(c, xy=c.xy + noise_of_pair(rng, rho) + np.concatenate([common, common])))
    return out


def slow(component):
    """The power of its slowest part."""
    lags = component.autocovariances(200)
    return float(2 * lags.sum() - lags[0])


def test_noise_that_is_known_already_stays():
    clips = measured(1)
    noise = estimate_noise(clips)
    fit = fit_model(clips, Model(), BASE_PARAMETERS, noise)
    assert refit_noise(clips, fit, noise) is None
    residuals = RestrictedResiduals.of(clips, fit, noise, range(len(clips)))
    assert abs(residuals.common_mode_score(noise)[0]) < 4  # the largest of several normal scores


def test_slow_noise_is_known_better_from_whole_clips():
    truth, first, second = slow(NoiseComponent(1.0, (0.9,))), [], []
    for seed in range(4):
        clips = measured(seed, rho=0.9)
        noise = estimate_noise(clips)
        better = refit_noise(clips, fit_model(clips, Model(), BASE_PARAMETERS, noise), noise) or noise
        first.append(np.log(slow(noise.own) / truth))
        second.append(np.log(slow(better.own) / truth))
    assert np.sqrt(np.mean(np.square(second))) < 0.7 * np.sqrt(np.mean(np.square(first)))
    assert abs(np.mean(second)) < 3 * np.std(second, ddof=1) / np.sqrt(4) + 0.05


def test_a_walk_too_slow_for_the_phases_is_found():
    clips = measured(1, walk=0.25, count=6)
    noise = estimate_noise(clips)
    assert noise.shared == ()
    better = refit_noise(clips, fit_model(clips, Model(), BASE_PARAMETERS, noise), noise)
    assert better.scale == pytest.approx(1, rel=0.1)
    for s in better.shared:
        lags = s.autocovariances(2)
        assert 2 * (lags[0] - lags[1]) / (0.25 * STD) ** 2 == pytest.approx(1, rel=0.5)


@pytest.mark.parametrize("hidden", [0.001, 0.01])
def test_what_is_unexplained_is_not_hidden_by_noise(hidden):
    clips, names = measured(2, hidden=hidden), [*BASE_PARAMETERS, "velocity_restitution.e"]
    noise = Noise(NoiseComponent(1.0))
    base = fit_model(clips, Model(), BASE_PARAMETERS, noise)
    z2 = base.chi2 - fit_model(clips, Model(), names, noise).chi2
    assert z2 > 30
    worse = refit_noise(clips, base, noise)
    left = fit_model(clips, Model(), BASE_PARAMETERS, worse).chi2 - fit_model(clips, Model(), names, worse).chi2
    assert left > 0.8 * z2 / (1 + z2 / (8 * len(clips)))
    assert left > 4.5**2


def test_what_a_model_lacks_is_not_taken_for_a_camera_that_shakes():
    """A tilt pushes both balls alike. Where it is in the model, nothing is left to be shared."""
    tilted = Model().replace({"plate_tilt.x": 3e-5, "plate_tilt.y": 2e-5})
    clips = collisions(tilted, 8, 3)
    noise = estimate_noise(clips)
    base = fit_model(clips, Model(), BASE_PARAMETERS, noise)
    assert base.chi2 > 1.1 * base.points
    assert refit_noise(clips, base, noise, explained=False).shared == ()
    assert refit_noise(clips, fit_model(clips, tilted, BASE_PARAMETERS, noise), noise) is None


@pytest.mark.parametrize("leans", [False, True])
def test_a_table_that_leans_another_way_in_each_clip_is_no_camera_that_shakes(leans):
    """Beside one that does shake, whose noise was found within the phases."""
    rng, clips, level = np.random.default_rng(4), [], exact(Model(), 8, 5)
    for k in range(8):
        tilt = {"plate_tilt.x": 1e-4 * np.cos(2.4 * k), "plate_tilt.y": 1e-4 * np.sin(2.4 * k)}
        clip = exact(Model().replace(tilt), 8, 5)[k] if leans else level[k]
        shake = 2 * STD * correlated(rng, FRAMES, 0.9)
        clips.append(dataclasses.replace(clip, xy=clip.xy + noise_of_pair(rng, 0.0) + np.concatenate([shake, shake])))
    noise = estimate_noise(clips)
    assert noise.common_mode_rms == pytest.approx(2 * STD, rel=0.5)
    better = refit_noise(clips, fit_model(clips, Model(), BASE_PARAMETERS, noise), noise) or noise
    assert better.common_mode_rms == pytest.approx(2 * STD, rel=0.5)


def test_noise_that_the_phases_exclude_is_refused():
    clips = measured(2, hidden=0.2)
    noise = Noise(NoiseComponent(1.0))
    base = fit_model(clips, Model(), BASE_PARAMETERS, noise)
    assert base.chi2 > 20 * base.points
    assert refit_noise(clips, base, noise) is None


def test_where_phases_hold_motion_the_noise_is_not_read_over_more():
    """Balls roll where they are said to slide, and more than that is missing: none of it is noise."""
    clips = [dataclasses.replace(c, slide_ends=c.slide_ends + 0.1) for c in measured(1, hidden=0.2)]
    noise = estimate_noise(clips)
    base = fit_model(clips, Model(), BASE_PARAMETERS, noise)
    assert noise.whole_phase_scale > 100
    assert base.chi2 > 100 * base.points
    assert refit_noise(clips, base, noise) is None
    assert refit_noise(clips, base, noise, explained=False) is None


def test_clips_are_whitened_together_only_where_one_filter_whitens_them():
    """Without shared parameters the likelihood is the sum over clips, some of which have other frames or errors."""
    clips = collisions(Model(), 5, 3)
    clips[1] = clips[1].select(np.arange(len(clips[1].frame)) % 7 > 0)
    clips[2] = clips[2].select(np.flatnonzero(clips[2].frame != 50))
    clips[3] = dataclasses.replace(clips[3], covariance=clips[3].covariance * np.diag([1.0, 4.0]))
    own = NoiseComponent(1.0, (0.4,))
    fit = fit_model(clips, Model(), (), Noise(own))
    shared = NoiseComponent(STD**2, (0.9,))
    for noise in (Noise(own), Noise(own, (shared, shared))):
        together = RestrictedResiduals.of(clips, fit, Noise(own), range(5)).cost(noise)
        each = [RestrictedResiduals.of(clips, fit, Noise(own), [k]).cost(noise) for k in range(5)]
        assert together == pytest.approx(sum(each), rel=1e-9)
