"""Tracks that no model follows: a search ends with a verdict or with one line, and never with anything else."""

import dataclasses
from contextlib import suppress

import numpy as np
import pytest
from discrepancy_clips import STD, collisions, exact, only
from hypothesis import given, settings
from hypothesis import strategies as st

from discrepancy.fitting.gauss_newton import _interpolate, fit_model, minimise_chi2
from discrepancy.fitting.jacobian import linearise
from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.fitting.parameters import BASE_PARAMETERS, parameter_limits, replace_within_limits
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.search import search
from synthcam.library import library
from synthcam.model import Model
from synthcam_shared.errors import InputError

NOISE = Noise(NoiseComponent(1.0))
CLIPS = collisions(Model(), 2, 3, frames=40)
START = linearise(WhitenedClips.of(CLIPS, NOISE), Model(), BASE_PARAMETERS, np.array([c.launch for c in CLIPS]))
LIMITED = ("unknown_lamp.height", "unknown_lamp.x", "hop.share", "hop.bounce", "restitution", "spin_transfer")


def pucks(clip, rng):
    """Two that slide without friction and part anyhow."""
    way = 0.3 * np.array([np.cos(clip.launch[4]), np.sin(clip.launch[4])])
    t, position = clip.frame / clip.fps - clip.launch[2], np.array([[0.0, 0.0], -2.38e-3 * way / 0.3])
    before, after = np.array([[0.0, 0.0], way]), rng.normal(0, 0.3, (2, 2))
    velocity = np.where((t < 0)[:, None], before[clip.ball], after[clip.ball])
    return clip.launch[:2] + position[clip.ball] + velocity * t[:, None] + STD * rng.standard_normal((len(t), 2))


def walks(clip, rng):
    steps = 2e-4 * rng.standard_normal((2, len(clip.frame) // 2, 2))
    return (np.cumsum(steps, axis=1) + rng.uniform(-0.02, 0.02, (2, 1, 2))).reshape(-1, 2)


@pytest.mark.gate
@pytest.mark.parametrize("motion", [pucks, walks])
def test_a_search_of_anything_ends_well(monkeypatch, motion):
    only(monkeypatch, ("friction_speed", "force_place"), unknown_lamp=library()["unknown_lamp"])
    rng = np.random.default_rng(1)
    clips = [dataclasses.replace(c, xy=motion(c, rng)) for c in exact(Model(), 6, 1, 30)]
    blind = [dataclasses.replace(c, camera=dataclasses.replace(c.camera, lamp=None)) for c in clips]
    with suppress(InputError):  # one line
        found = search(blind, Model())
        assert found.verdict in {"none", "named", "ambiguous", "outside_library", "inadequate"}
        assert found.is_complete or all(np.isnan(s) for n in found.document()["named"] for s in n["std"].values())


@settings(max_examples=200)
@given(st.sampled_from(LIMITED), st.sampled_from([0, 1]), st.sampled_from([1.0, 0.3, 0.1]), st.floats(-1e3, 1e3))
def test_no_step_ends_beyond_a_limit(name, side, share, further):
    """From a limit to it, to beyond it, or away from it, by rounding or by far."""
    end = parameter_limits(Model(), name)[side]
    fit = dataclasses.replace(START, model=replace_within_limits(Model(), {name: end}), names=(name,))
    for aim in (end, end + further, np.nextafter(end, -np.inf), np.nextafter(end, np.inf)):
        there = replace_within_limits(fit.model, _interpolate(fit, {name: aim}, share))
        assert parameter_limits(Model(), name)[0] <= there.value(name) <= parameter_limits(Model(), name)[1]


@pytest.mark.parametrize("error", [ValueError, np.linalg.LinAlgError, FloatingPointError, OverflowError])
def test_a_step_that_fails_is_a_failed_step(monkeypatch, error):
    """Whatever it is that fails, and wherever on the way."""
    calls = 0
    true = WhitenedClips.whitened_residuals

    def failing(self, model, launches):
        nonlocal calls
        calls += 1
        if calls % 2:
            raise error("no motion")
        return true(self, model, launches)

    monkeypatch.setattr(WhitenedClips, "whitened_residuals", failing)
    fit = minimise_chi2(WhitenedClips.of(CLIPS, NOISE), START)
    assert calls > 1
    assert fit.chi2 <= START.chi2
    there = dataclasses.replace(START.linearisation, launches=START.launches + 1e-9)  # derivatives of somewhere near
    elsewhere = dataclasses.replace(START, linearisation=there)
    for broken in ("discrepancy.fitting.gauss_newton.linearise", "discrepancy.fitting.gauss_newton._step"):
        with monkeypatch.context() as patch:
            patch.setattr(broken, lambda *_, **__: (_ for _ in ()).throw(error("no motion")))
            assert minimise_chi2(WhitenedClips.of(CLIPS, NOISE), elsewhere).chi2 <= START.chi2


def test_what_tracks_do_not_show_of_a_launch_stays():
    """A singular matrix of one clip."""
    linearisation = dataclasses.replace(START.linearisation, launch_slopes=tuple(0 * a for a in START.launch_slopes))
    flat = dataclasses.replace(START, linearisation=linearisation)
    assert np.isfinite(minimise_chi2(WhitenedClips.of(CLIPS, NOISE), flat, rough=True).chi2)
    assert fit_model(CLIPS, Model(), BASE_PARAMETERS, NOISE).chi2 < START.chi2
