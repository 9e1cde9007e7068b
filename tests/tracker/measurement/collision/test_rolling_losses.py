"""One rolling loss for both balls: what both fits do where it does not hold."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import expit

import synthcam
from benchmarks.regression.error_bars import SHAKEN, doubt_key, follow_centres
from tracker.camera.camera import Camera
from tracker.measurement import estimate
from tracker.measurement.collision.adequacy import Flag
from tracker.measurement.collision.derived import QUANTITY_NAMES, DerivedValues
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


@pytest.mark.parametrize("scale", [1e6, 1e8, 1e12, 1e20])
@pytest.mark.parametrize("z", [0.0, 3.0, 40.0, 1e5])
def test_a_prior_much_wider_than_the_error_leaves_the_measured_difference(z, scale):
    """The posterior is then normal; at |z| of 40 and more the losses are certainly unequal, up to any such scale."""
    weight = weigh_shift(z, scale)
    assert weight.shifted == pytest.approx(z, rel=1e-6, abs=1e-9)
    assert weight.shifted_variance == pytest.approx(1.0, rel=1e-6)
    log_odds = z**2 / 2 - np.log(scale * (1 + (z / scale) ** 2) * np.sqrt(np.pi / 2))  # densities of both models
    assert weight.probability == pytest.approx(expit(log_odds), rel=1e-6)


def test_nothing_jumps_where_the_series_of_the_weight_begins():
    near, far = (weigh_shift(2.0, scale) for scale in (1414.0, 1414.3))
    assert far.shifted_variance == pytest.approx(near.shifted_variance, abs=1e-8)
    assert far.probability == pytest.approx(near.probability, rel=3e-4)


def test_losses_that_noise_makes_small_do_not_count_as_equal():
    """A loss of 0.00 +- 0.10 m/s^2 says no more about a tenth of it than one of 0.10 m/s^2."""
    given = {"std": 0.001, "response": np.zeros(1), "shared": np.zeros(0), "effect": np.zeros(20)}
    given |= {"value": 0.004, "cov_with_tied": np.zeros(20)}
    unsure = LossDifference(loss=0.0, loss_std=0.1, **given).weigh(0.1)
    sure = LossDifference(loss=0.1, loss_std=0.0, **given).weigh(0.1)
    assert unsure.mean == sure.mean > 3
    assert LossDifference(loss=0.0, loss_std=0.0, **given).weigh(0.1).mean == 0


@pytest.mark.parametrize("keys", [0, 2])
def test_quantities_with_a_difference_have_the_covariance_of_linear_fits(keys):
    """Two linear fits of one set of data, of which the tied one has fewer parameters; the camera has `keys` errors."""
    rng = np.random.default_rng(3)
    wide, by, known = rng.normal(size=(60, 6)), rng.normal(size=60), rng.normal(size=(60, keys))
    tie = rng.normal(size=(6, 3))

    def fit(rows, to_wide):
        """Estimators of the six parameters if the difference is zero, and of the difference; and the effect."""
        inverse = np.linalg.inv(rows.T @ rows)
        project = np.eye(60) - rows @ inverse @ rows.T
        left, rest = project @ by, project @ known
        left = np.linalg.solve(np.eye(60) + rest @ rest.T, left)
        square = left @ by
        estimator, difference = to_wide @ inverse @ rows.T, left / square
        none = {"value": 0.0, "loss": 0.1, "loss_std": 0.0, "cov_with_tied": np.zeros(6)}
        found = {"response": difference, "shared": difference @ known, "effect": -estimator @ by}
        return estimator, LossDifference(std=square**-0.5, **found, **none)

    def quantities(estimator):
        return DerivedValues(np.zeros(6), estimator @ estimator.T).with_shared(estimator @ known)

    def assert_is(values, estimator):
        assert values.shared == pytest.approx(estimator @ known)
        assert values.cov == pytest.approx(estimator @ estimator.T + values.shared @ values.shared.T)

    free, free_losses = fit(wide, np.eye(6))
    tied, tied_losses = fit(wide @ tie, tie)
    difference, sure, equal = tied_losses.response, ModelWeight(1.0, 0.0, 1.0), ModelWeight(0.0, 0.0, 0.0)
    assert_is(tied_losses.correct(quantities(tied), sure), tied + np.outer(tied_losses.effect, difference))
    assert_is(free_losses.correct(quantities(free), sure), free + np.outer(free_losses.effect, free_losses.response))
    free_losses = replace(free_losses, cov_with_tied=free @ difference)
    together = free + np.outer(free_losses.effect, difference)
    assert_is(free_losses.correct(quantities(free), sure, tied_losses), together)
    together = free + np.outer(free_losses.effect - tied_losses.effect, difference)
    values = free_losses.correct(quantities(free), equal, tied_losses)
    assert_is(values, together)
    if not keys:  # Hausman, for linear fits
        apart = (free_losses.effect - tied_losses.effect) * tied_losses.std
        assert values.cov == pytest.approx(free @ free.T - np.outer(apart, apart))


def test_errors_hold_on_average_over_losses_and_cameras_as_they_are_expected():
    """Losses are drawn from the prior. The tracks know the difference mostly by a key of the camera that is wrong."""
    rng = np.random.default_rng(5)
    effect, shared, std, scale, n = 2.0, 1.5, 0.6, 4.0, 4000
    wrong, noise = rng.normal(size=(2, n))
    true = np.where(rng.random(n) < 0.5, scale * rng.standard_cauchy(n), 0.0)
    measured = true + 0.8 * wrong + std * noise  # with an error of 1
    by = LossDifference(0.0, 1.0, np.array([std]), np.array([0.8]), scale, 0.0, np.full(1, effect), np.zeros(1))
    given = DerivedValues(np.zeros(1), np.full((1, 1), 1 + shared**2), np.full((1, 1), shared))
    z, plain = [], []
    for number in range(n):
        found = replace(by, value=measured[number])
        values = found.correct(given, found.weigh(1.0))
        off = values.value[0] + shared * wrong[number] + rng.normal() - effect * true[number]
        z.append(off / values.std[0])
        wider = effect**2 * found.weigh(1.0).variance
        plain.append(off / np.sqrt(given.cov[0, 0] + wider))
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.05)
    assert np.sqrt(np.mean(np.square(plain))) > 1.1  # without their correlation


@pytest.mark.parametrize("key", ["scale", "ball_diameter"])
@pytest.mark.parametrize("number", [1, 3])
def test_the_effect_of_a_key_of_the_camera_is_that_on_the_averaged_values(key, number):
    clip = synthcam.Scene.build("loss", **SHAKEN, effects={"rolling_mismatch": {"drag": 0.01}}).draw(number, 14)
    tracks, camera = follow_centres(clip, np.random.default_rng(number)), Camera.of(clip.camera_json)
    settings = FitSettings(local_window_s=0)
    row, more, less = (measure(tracks, doubt_key(camera, key, off), settings)[0] for off in (0.0, 0.1, -0.1))
    shared = json.loads(row["cov"])["shared"][key]
    for fit, suffix in (("tied", ""), ("free", "_free")):
        for name in ("v0", "r", "mu_k", "tau1"):
            effect = (more[name + suffix] - less[name + suffix]) / 0.2
            given = shared[fit][QUANTITY_NAMES.index(name)]
            assert given == pytest.approx(effect, abs=0.012 * row[f"{name}{suffix}_std"])


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
