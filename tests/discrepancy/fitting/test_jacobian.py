"""Derivatives of the forecast where the motion without the push between balls does not exist."""

import numpy as np
import pytest
from discrepancy_clips import exact

from discrepancy.data.stretches import cut_stretches
from discrepancy.fitting import jacobian
from discrepancy.fitting.jacobian import (
    differentiate_all,
    differentiate_launches,
    differentiate_launches_and_base,
    linearise,
)
from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.fitting.parameters import BASE_PARAMETERS, list_candidates
from discrepancy.fitting.predict import predict_tracks
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.select.score_test import ScoreTests
from synthcam.model import Model, without_mutual_push


def test_a_ball_that_rests_only_beside_the_other_has_exact_derivatives():
    """A tilt too steep for a ball to rest by itself, and a pull: no error, and differences of the whole motion."""
    clips = exact(Model(), 2, 3)
    launches = np.array([clip.launch for clip in clips])
    model, name = Model().replace({"plate_tilt.x": 3e-3, "magnetic_attraction.pull": 0.3}), "restitution"
    with pytest.raises(ValueError, match="rest"):
        predict_tracks(without_mutual_push(model), launches, clips)
    (found,) = differentiate_all(model, launches, clips, [name], predict_tracks(model, launches, clips))
    step, value = 1e-4, model.value(name)
    ahead, behind = (predict_tracks(model.replace({name: value + s}), launches, clips) for s in (step, -step))
    for slope, one, other in zip(found, ahead, behind, strict=True):
        np.testing.assert_allclose(slope, (one - other) / (2 * step), rtol=0, atol=1e-6)


def test_score_tests_beside_such_a_model():
    clips = exact(Model(), 2, 3)
    launches = np.array([clip.launch for clip in clips])
    evidence = WhitenedClips.of(clips, Noise(NoiseComponent(1e-12)))
    model = Model().replace({"plate_tilt.x": 3e-3, "magnetic_attraction.pull": 0.3})
    fit = linearise(evidence, model, (*BASE_PARAMETERS, "plate_tilt.x", "magnetic_attraction.pull"), launches)
    (drag,) = (c for c in list_candidates(model, fit.names) if c.name == "air_drag")
    (scored,) = ScoreTests.of(evidence, fit, only=[drag]).ranking()
    assert np.isfinite(scored.sigma)


def test_what_is_not_free_moves_nothing():
    """No side spin but in one clip: no slope by it elsewhere, nor by slips; rounding would make steps of 10^5 m/s."""
    waves = {"plate_waviness.a": 3e-6, "plate_waviness.b": 1.5e-6, "plate_waviness.wavelength": 0.02}
    model, spins = Model().replace(waves), [[0.0, 0.0, 0.01], *[[0.0, 0.0, 0.0]] * 11]
    clips = exact(model, 12, 3, spins=spins)
    _, slopes = differentiate_launches(model, np.array([clip.launch for clip in clips]), clips)
    assert np.abs(slopes[0][..., 8]).max() > 1e-3
    assert not any(s[..., 6:8].any() for s in slopes)
    assert not any(s[..., 8].any() for s in slopes[1:])


def test_only_free_columns_of_a_launch_are_moved(monkeypatch):
    """A stretch that rolls from the start has four: its position, speed and heading."""
    stretch = next(c for c in cut_stretches(exact(Model(), 1, 3)) if not c.launch[6:].any())
    counts, predict = list[int](), jacobian.predict_tracks

    def spy(model, launches, clips, *base):
        counts.append(len(launches))
        return predict(model, launches, clips, *base)

    monkeypatch.setattr(jacobian, "predict_tracks", spy)
    _, (slopes,) = differentiate_launches(Model(), stretch.launch[None], [stretch])
    assert counts == [5]
    assert slopes.any(axis=(0, 1)).tolist() == [True, True, False, True, True, False, False, False, False]


@pytest.mark.parametrize(
    ("values", "together", "share"),
    [
        ({}, 5, 0.0),
        ({"rolling_drag": 0.0, "rolling_decel": 0.0, "sliding_friction": 0.0}, 5, 0.0),
        (
            {"restitution": 1.0, "ball_friction.mu": 0.1, "ball_friction.share": 0.3, "mass_mismatch.excess": 0.01},
            4,
            0.0,
        ),
        ({"hop.share": 0.1, "hop.bounce": 0.5}, 5, 0.0),
        ({"rolling_quadratic.K": 0.02, "stribeck.rise": 0.1, "drilling_spin.a": 1e-5}, 5, 1e-7),
        ({"plate_tilt.x": 5e-4, "friction_mismatch.excess": 0.05}, 5, 1e-7),
        ({"magnetic_attraction.pull": 0.3}, 0, 0.0),
    ],
)
def test_base_parameters_are_differentiated_together_as_one_by_one(values, together, share):
    """In two batches; bit for bit, or where motion is integrated but for a share. Not at a limit, nor with a pull."""
    model, clips = Model().replace(values), exact(Model(), 5, 3)
    launches = np.array([clip.launch for clip in clips])
    here, own = differentiate_launches(model, launches, clips)
    found = differentiate_launches_and_base(model, launches, clips, (*BASE_PARAMETERS, "clock_error.e"), batch=3)
    shared = dict(zip(BASE_PARAMETERS, differentiate_all(model, launches, clips, BASE_PARAMETERS, here), strict=True))
    assert len(found[2]) == together
    assert all(slope.any() for slopes in found[2].values() for slope in slopes)
    for one, other in ((found[0], here), (found[1], own), *((s, shared[n]) for n, s in found[2].items())):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=share * np.abs(b).max())
