"""One rolling loss for both balls: what both fits do where it does not hold."""

import json
from dataclasses import replace

import numpy as np
import pytest

import synthcam
from benchmarks.regression.error_bars import SHAKEN, doubt_key, follow_centres
from tracker.camera.camera import Camera
from tracker.measurement import estimate
from tracker.measurement.collision.adequacy import Flag
from tracker.measurement.collision.collision_model import TIED
from tracker.measurement.collision.departures import compare_losses, derive_quantities
from tracker.measurement.collision.derived import QUANTITY_NAMES
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


def test_averaged_values_of_an_uncertain_scale_keep_a_covariance():
    """The mean of both balls has weights by the scale's error; so must what a departure does to that mean."""
    for number in (0, 3):
        clip = synthcam.Scene.build("scale", **SHAKEN).draw(number, 7)
        tracks = follow_centres(clip, np.random.default_rng([7, number]), 0.005)
        camera = Camera.of(clip.camera_json | {"scale_std": 3e-3 * clip.camera_json["scale"]})
        (row,) = measure(tracks, camera, FitSettings(local_window_s=0))
        cov = np.array(json.loads(row["cov"])["free"], dtype=float)
        size = np.sqrt(np.diag(cov))
        known = np.isfinite(size) & (size > 0)
        least = np.linalg.eigvalsh((cov / np.outer(size, size))[np.ix_(known, known)])[0]
        assert least > -1e-4


def test_a_setting_of_zero_keeps_the_fit_of_one_loss(monkeypatch):
    names = ("v0", "v0_std", "mu_k", "mu_k_std")
    kept, _ = measure_hit(0, 14, drag=0.02, rolling_loss_difference=0)
    changed, _ = measure_hit(0, 14, drag=0.02)
    monkeypatch.setattr(estimate, "compare_losses", lambda *_: None)
    alone, _ = measure_hit(0, 14, drag=0.02)
    assert [kept[name] for name in names] == pytest.approx([alone[name] for name in names], rel=1e-12)
    assert changed["v0"] != alone["v0"]


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


def test_losses_that_noise_makes_small_do_not_count_as_equal(monkeypatch):
    """A loss of 0.00 +- 0.10 m/s^2 says no more about a tenth of it than one of 0.10 +- 0.00 m/s^2."""
    clip = synthcam.Scene.build("loss", **SHAKEN).draw(1, 21)
    found = []

    def compare(*given):
        (old,) = [compare_losses(*given)]
        found.append(given[0])
        return old

    monkeypatch.setattr(estimate, "compare_losses", compare)
    measure(follow_centres(clip, np.random.default_rng(1)), Camera.of(clip.camera_json), FitSettings(local_window_s=0))
    fit = found[0]
    none = fit.parameters.copy()
    none[[TIED.index("drag"), TIED.index("decel")]] = 0.0
    unsure = compare_losses(replace(fit, parameters=none))
    at = [TIED.index(name) for name in ("decel", "drag")]
    slope = np.array([1.0, derive_quantities(fit).value[QUANTITY_NAMES.index("v1f")]])
    std = np.sqrt(slope @ fit.cov[np.ix_(at, at)] @ slope)
    assert unsure.typical == pytest.approx(0.1 * std, rel=0.05)


def test_a_free_fit_whose_slide_hardly_ends_in_the_film_keeps_errors_that_hold():
    """The difference of the tied fit, taken for independent of the free fit, left negative variances there."""
    clip = synthcam.Scene.build("loss", **SHAKEN).draw(50, 21)
    tracks = follow_centres(clip, np.random.default_rng([21, 50]), noise_px=0.05)
    settings = FitSettings(local_window_s=0, broken_law=0)  # the errors of the tied fit, if its laws hold
    (row,) = measure(tracks, Camera.of(clip.camera_json), settings)
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
