"""Flux that a film's glints share: to a clipped glint's position it adds what conditioning adds, or nothing."""

import numpy as np
import pytest
from tracker_film import CAMERA, collision
from tracker_film import film as drawn

from tracker.camera.camera import Camera
from tracker.camera.recordings import Frames, Recording
from tracker.detection.detect import detect, make_view
from tracker.detection.detectors import maximum_likelihood
from tracker.detection.likelihood.brightness_priors import apply_flux_prior

CROSS, OWN = np.array([0.6, -0.5]), 0.01**2  # correlations of position with log flux; variance of log flux
POSITION = 0.005**2


def film(rng, n, scatter=0.0, field=0.01):
    """n glints anywhere, their errors of position and log flux correlated as a clipped glint's are."""
    true = rng.uniform([0, 0], [640, 480], (n, 2))
    cross = rng.choice([-1, 1], n)[:, None] * CROSS * np.sqrt(POSITION * OWN)
    cov = np.broadcast_to(POSITION * np.eye(2), (n, 2, 2)).copy()
    whole = np.zeros((n, 3, 3))
    whole[:, :2, :2], whole[:, 2, 2] = cov, OWN
    whole[:, 2, :2] = whole[:, :2, 2] = cross
    error = (np.linalg.cholesky(whole) @ rng.standard_normal((n, 3, 1)))[..., 0]
    flux = 8.0 + field * ((true / 640) ** 2).sum(axis=1) + scatter * rng.standard_normal(n) + error[:, 2]
    return true, true + error[:, :2], cov, flux, cross, np.full(n, OWN)


def z_of(miss, cov):
    return np.linalg.solve(np.linalg.cholesky(cov), miss[..., None])[..., 0]


@pytest.mark.parametrize("scatter", [0.0, 0.01])
def test_it_gains_what_conditioning_gains(scatter):
    true, seen, *rest = film(np.random.default_rng(1), 4000, scatter)
    better, cov = apply_flux_prior(seen, *rest)
    left = 1 - CROSS**2 * OWN / (OWN + scatter**2)  # of the variance, by axis
    assert ((better - true) ** 2).mean(axis=0) / POSITION == pytest.approx(left, rel=0.06)
    assert np.diagonal(cov, axis1=1, axis2=2).mean(axis=0) / POSITION == pytest.approx(left, rel=0.02)
    assert z_of(better - true, cov).std() == pytest.approx(1.0, abs=0.03)


def test_a_clip_of_few_frames_stays_honest():
    rng, z = np.random.default_rng(2), []
    for _ in range(60):
        true, seen, *rest = film(rng, 60)
        better, cov = apply_flux_prior(seen, *rest)
        z.append(z_of(better - true, cov))
    assert np.std(z) == pytest.approx(1.0, abs=0.04)


def test_a_flickering_lamp_gives_no_prior_and_does_no_harm():
    true, seen, cov, *rest = film(np.random.default_rng(3), 200, scatter=0.3)
    better, surer = apply_flux_prior(seen, cov, *rest)
    assert np.abs(better - seen).max() < 0.2 * np.sqrt(POSITION)
    np.testing.assert_allclose(surer, cov, atol=2e-3 * POSITION)
    assert len(true) == 200


def test_what_shines_otherwise_is_left_alone_and_does_not_disturb():
    rng = np.random.default_rng(4)
    true, seen, cov, flux, cross, own = film(rng, 400)
    strange = rng.random(400) < 0.1
    flux[strange] -= rng.uniform(0.5, 3.0, strange.sum())
    better, surer = apply_flux_prior(seen, cov, flux, cross, own)
    np.testing.assert_array_equal(better[strange], seen[strange])
    np.testing.assert_array_equal(surer[strange], cov[strange])
    left = ((better - true)[~strange] ** 2).mean() / POSITION
    assert left == pytest.approx(1 - (CROSS**2).mean(), rel=0.15)


@pytest.mark.parametrize("n", [0, 1, 29])
def test_too_few_to_measure(n):
    _, seen, cov, *rest = film(np.random.default_rng(5), n)
    better, surer = apply_flux_prior(seen, cov, *rest)
    np.testing.assert_array_equal(better, seen)
    np.testing.assert_array_equal(surer, cov)


def test_balls_that_all_rest():
    """One position, one flux: no field to be fitted."""
    _, seen, cov, flux, cross, own = film(np.random.default_rng(6), 100)
    better, surer = apply_flux_prior(np.full_like(seen, 7.25), cov, flux, cross, own)
    assert np.isfinite(better).all()
    assert np.isfinite(surer).all()


@pytest.mark.parametrize(("peak", "gain"), [(700.0, (0.002, 0.05)), (150.0, (0.0, 0.0))])
def test_clipped_glints_of_a_film_gain_and_open_ones_need_not(monkeypatch, peak, gain):
    frames = drawn(np.random.default_rng(7), collision(40, speed=3.0), peak=peak, profile=14.0)
    sensor = CAMERA["sensor"] | {"full_well": 20000}
    clip = Recording(
        0, Camera.from_dict(CAMERA | {"sensor": sensor}), Frames(40, frames.shape[1:], np.uint8, lambda k: frames[k])
    )
    helped = detect(clip, make_view(clip)).glints
    monkeypatch.setattr(maximum_likelihood, "apply_flux_prior", lambda xy, cov, *_: (xy, cov))
    alone = detect(clip, make_view(clip)).glints
    saved = 1 - np.trace(helped.cov, axis1=1, axis2=2).sum() / np.trace(alone.cov, axis1=1, axis2=2).sum()
    assert gain[0] <= saved <= gain[1]
    assert np.array_equal(helped.xy, alone.xy) == (gain[1] == 0)
