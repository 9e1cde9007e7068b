"""One rolling loss for both balls: what both fits do where it does not hold."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

import synthcam
from benchmarks.regression.error_bars import SHAKEN, follow_centres
from tracker.camera.camera import Camera
from tracker.measurement import estimate
from tracker.measurement.collision.adequacy import Flag
from tracker.measurement.collision.derived import DerivedValues
from tracker.measurement.collision.rolling_losses import LossDifference, ModelWeight, compare_losses, weigh_shift
from tracker.measurement.estimate import measure
from tracker.settings import FitSettings


def measure_hit(number, seed, *, drag, **settings):
    """The row of one drawn hit whose striker loses more speed by `drag`, 1/s, and its truth."""
    effects = {"rolling_mismatch": {"drag": drag}}
    clip = synthcam.Scene.build("loss", **SHAKEN, effects=effects).draw(number, seed)
    tracks = follow_centres(clip, np.random.default_rng([seed, number]))
    (row,) = measure(tracks, Camera.of(clip.camera_json), FitSettings(local_window_s=0, **settings))
    return row, clip.truth


@pytest.mark.parametrize(("number", "seed"), [(0, 14), (18, 14), (6, 15)])
def test_values_carry_a_difference_that_the_tracks_show(number, seed):
    """By one loss for both balls, v0 of these hits is 9 to 11 standard errors off, and they are ok too."""
    row, truth = measure_hit(number, seed, drag=0.02)
    assert (row["status"], row["flags"]) == ("ok", "")
    for name in ("v0", "b", "r", "mu_k", "C", "tau1", "tau2", "energy_fraction"):
        assert abs(row[name] - truth[name]) < 3 * row[f"{name}_std"]
    assert abs(row["v0_free"] - truth["v0"]) < 3 * row["v0_free_std"]


def test_a_difference_beyond_doubt_is_a_misfit_that_names_it():
    row, _ = measure_hit(2, 12, drag=0.02)
    assert (row["status"], row["flags"]) == ("misfit", Flag.LOSSES_DIFFER)
    assert row["adequate"] > 1e-4  # chi^2 of all positions does not show it
    assert np.isnan(row["v0_std"])


def test_equal_losses_hardly_change_the_values_and_their_errors(monkeypatch):
    averaged = [measure_hit(number, 12, drag=0.0)[0] for number in range(9)]
    monkeypatch.setattr(estimate, "compare_losses", lambda *_: None)
    alone = [measure_hit(number, 12, drag=0.0)[0] for number in range(9)]
    assert {(row["status"], row["flags"]) for row in averaged} == {("ok", "")}
    shift = [abs(row["v0"] - one["v0"]) / one["v0_std"] for row, one in zip(averaged, alone, strict=True)]
    wider = [row["v0_std"] / one["v0_std"] for row, one in zip(averaged, alone, strict=True)]
    assert max(shift) < 0.5
    assert min(wider) > 1
    assert np.median(wider) < 1.1


def test_a_setting_of_zero_keeps_the_fit_of_one_loss(monkeypatch):
    names = ("v0", "v0_std", "mu_k", "mu_k_std")
    kept, _ = measure_hit(0, 14, drag=0.02, rolling_loss_difference=0)
    changed, _ = measure_hit(0, 14, drag=0.02)
    monkeypatch.setattr(estimate, "compare_losses", lambda *_: None)
    alone, _ = measure_hit(0, 14, drag=0.02)
    assert [kept[name] for name in names] == [alone[name] for name in names]
    assert changed["v0"] != alone["v0"]


@pytest.mark.parametrize(("z", "scale"), [(0.1, 10.0), (0.7, 0.2), (2.0, 1.0), (3.0, 30.0), (4.5, 8.0), (12.0, 2.0)])
def test_the_mean_over_both_models_is_that_of_numerical_integrals(z, scale):
    def integrate(power):
        def density(x):
            return x**power * scale / (np.pi * (scale**2 + x**2)) * np.exp(-((z - x) ** 2) / 2) / np.sqrt(2 * np.pi)

        return quad(density, z - 12, z + 12, points=sorted({0.0, z}), epsabs=0, epsrel=1e-9, limit=200)[0]

    evidence, first, second = map(integrate, (0, 1, 2))
    equal = np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)
    mean = first / (evidence + equal)
    weight = weigh_shift(z, scale)
    assert weight.probability == pytest.approx(evidence / (evidence + equal), rel=1e-6)
    assert weight.mean == pytest.approx(mean, rel=1e-6, abs=1e-12)
    assert weight.variance == pytest.approx(second / (evidence + equal) - mean**2, rel=1e-6)


def test_nothing_jumps_as_a_difference_grows():
    weights = [weigh_shift(z, 20.0) for z in np.arange(0.0, 5.0, 0.01)]
    assert np.abs(np.diff([weight.mean for weight in weights])).max() < 0.03
    assert np.abs(np.diff([weight.variance for weight in weights])).max() < 0.03


def test_free_quantities_with_the_difference_of_the_tied_fit_have_their_covariance():
    """Two linear fits of one set of data, of which the tied one has fewer parameters."""
    rng = np.random.default_rng(3)
    wide, by = rng.normal(size=(60, 6)), rng.normal(size=60)
    tie = rng.normal(size=(6, 3))

    def fit(rows, to_wide):
        """Estimators of the six parameters if the difference is zero, and of the difference; and the effect."""
        inverse = np.linalg.inv(rows.T @ rows)
        left = by - rows @ inverse @ rows.T @ by
        estimator = to_wide @ inverse @ rows.T
        square = left @ left
        difference, effect = left / square, -estimator @ by
        return estimator, LossDifference(0.0, square**-0.5, difference, 1.0, effect, np.zeros(6))

    free, free_losses = fit(wide, np.eye(6))
    _, tied_losses = fit(wide @ tie, tie)
    difference = tied_losses.response
    free_losses = replace(free_losses, cov_with_tied=free @ difference)
    values = free_losses.replace_by(tied_losses, DerivedValues(np.zeros(6), free @ free.T))
    together = free + np.outer(free_losses.effect - tied_losses.effect, difference)
    assert values.cov == pytest.approx(together @ together.T)
    apart = (free_losses.effect - tied_losses.effect) * tied_losses.std
    assert values.cov == pytest.approx(free @ free.T - np.outer(apart, apart))  # Hausman, for linear fits
    corrected = tied_losses.correct(values, ModelWeight(1.0, 0.0, 1.0))
    together = together + np.outer(tied_losses.effect, difference)
    assert corrected.cov == pytest.approx(together @ together.T)


def test_a_free_fit_whose_slide_hardly_ends_in_the_film_keeps_errors_that_hold():
    """The difference of the tied fit, taken for independent of the free fit, left negative variances there."""
    clip = synthcam.Scene.build("loss", **SHAKEN).draw(50, 21)
    tracks = follow_centres(clip, np.random.default_rng([21, 50]), noise_px=0.05)
    (row,) = measure(tracks, Camera.of(clip.camera_json), FitSettings(local_window_s=0))
    for name in ("v0", "r", "C", "tau1", "v1f", "w1t", "energy_fraction"):
        assert abs(row[f"{name}_free"] - clip.truth[name]) < 3 * row[f"{name}_free_std"]
        assert row[f"{name}_free_std"] > 0.9 * row[f"{name}_std"]


@pytest.mark.parametrize("key", ["scale", "fps", "ball_diameter"])
def test_the_response_to_noise_is_the_error_of_a_difference_if_the_camera_has_none(key):
    clip = synthcam.Scene.build("loss", **SHAKEN).draw(1, 21)
    tracks, found = follow_centres(clip, np.random.default_rng(1)), []

    def compare(*given):
        found.append(compare_losses(*given))
        return found[-1]

    for camera in (clip.camera_json, clip.camera_json | {f"{key}_std": 0.01 * clip.camera_json[key]}):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(estimate, "compare_losses", compare)
            measure(tracks, Camera.of(camera), FitSettings(local_window_s=0))
    sure, _, unsure, _ = found
    noise, more = (float(np.linalg.norm(losses.response)) for losses in (sure, unsure))
    assert noise == pytest.approx(sure.std, rel=1e-3)  # all but the broad priors
    assert noise * 0.999 < more <= unsure.std  # the weights for errors of the camera are not the best for noise alone
