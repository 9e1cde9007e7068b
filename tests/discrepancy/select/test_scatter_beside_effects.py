"""A strong effect does not pass as scatter from stretch to stretch, and real scatter does not pass as an effect."""

import dataclasses

import pytest
from discrepancy_clips import STD, collisions, only, scattering_stretches

from discrepancy.fitting.base_fit import CLAIMED_NOISE, fit_base_model
from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.fitting.stretch_scatter import add_scatter, fit_scatter
from discrepancy.preparation import prepare_data
from discrepancy.select.library_fits import LibraryFits
from discrepancy.select.scatter_beside_effects import compute_residual_cost, fit_scatter_beside_effects
from synthcam.library import library
from synthcam.model import Model

TILT, SCATTER, WARP = 1e-3, 0.05, 2 * STD  # rad; of the friction, relative; of the displacements
FEW = ("plate_tilt", "lens_distortion", "rolling_quadratic", "friction_anisotropy")


@pytest.fixture(autouse=True)
def few_effects(monkeypatch):
    only(monkeypatch, **{name: library()[name] for name in FEW})


def draw(model, seed, warp, scatter=SCATTER, count=8):
    """Stretches with displacements and frictions of their own, and the fit of the base model to them."""
    clips = scattering_stretches(model, count, scatter=scatter, warp=warp, same=False, seed=seed)
    return clips, fit_base_model(clips, Model(), CLAIMED_NOISE), CLAIMED_NOISE


def tilted():
    return Model().replace({"plate_tilt.x": TILT, "plate_tilt.y": TILT / 2})


@pytest.mark.parametrize("seed", [8, pytest.param(7, marks=pytest.mark.gate)])
def test_a_tilt_does_not_pass_as_scatter(seed):
    """Beside the base model, displacements are as large as the fit allows."""
    given = draw(tilted(), seed, WARP)
    assert fit_scatter(*given).is_implausible
    found, fit = fit_scatter_beside_effects(*given)
    assert found.displacement_m == pytest.approx(WARP, rel=0.4)
    assert found.friction == pytest.approx(SCATTER, rel=0.5)
    assert fit.model.value("plate_tilt.x") == pytest.approx(TILT, rel=0.2)
    assert fit.model.value("plate_tilt.y") == pytest.approx(TILT / 2, rel=0.2)


def test_a_search_begins_with_the_scatter_beside_a_tilt():
    data = prepare_data(collisions(tilted(), 8, 3), Model(), stretches=True)
    assert not data.scatter.is_implausible
    assert data.scatter.displacement_m < STD


def one_of_each(clips):
    """One stretch of each collision: those of one collision share its friction."""
    own = {}
    for clip in clips:
        own.setdefault(clip.clip, []).append(clip)
    return [every[k % len(every)] for k, every in enumerate(own.values())]


@pytest.mark.parametrize(("seed", "warp"), [(301, 2), (302, 3), (303, 25)])
def test_scatter_does_not_pass_as_an_effect(seed, warp):
    """Displacements of 25 noise sizes are more than the fit of the scatter allows, so that effects are tried."""
    clips = one_of_each(scattering_stretches(Model(), 16, scatter=0.02, warp=warp * STD, same=False, seed=seed))
    base = fit_base_model(clips, Model(), CLAIMED_NOISE)
    scatter, fit = fit_scatter_beside_effects(clips, base, CLAIMED_NOISE)
    assert fit is base
    assert scatter.is_implausible == (warp > 10)
    if not scatter.is_implausible:
        clips = add_scatter(clips, fit, scatter, CLAIMED_NOISE)
        tests = LibraryFits(WhitenedClips.of(clips, CLAIMED_NOISE), fit_base_model(clips, Model(), CLAIMED_NOISE))
        assert tests.score_tests(()).leaders(tests.required_sigma)[0].sigma < tests.required_sigma


def test_the_cost_of_residuals_is_that_of_noise():
    """Without scatter, residuals off the fit have unit variance: the cost is their chi^2."""
    clips, fit, noise = draw(Model(), 5, 0.0, scatter=0.0, count=4)
    bare = [dataclasses.replace(clip, scatter=None) for clip in clips]
    assert compute_residual_cost(bare, fit, fit_scatter(clips, fit, noise), noise) == pytest.approx(fit.chi2, rel=1e-3)
