"""One rolling loss for both balls: what the tied fit does where it does not hold."""

import numpy as np
import pytest

import synthcam
from benchmarks.regression.error_bars import SHAKEN, follow_centres
from tracker.camera.camera import Camera
from tracker.measurement import estimate
from tracker.measurement.collision.adequacy import Flag
from tracker.measurement.estimate import measure
from tracker.settings import FitSettings


def measure_hit(number, seed, *, drag):
    """The row of one drawn hit whose striker loses more speed by `drag`, 1/s, and its truth."""
    effects = {"rolling_mismatch": {"drag": drag}}
    clip = synthcam.Scene.build("loss", **SHAKEN, effects=effects).draw(number, seed)
    tracks = follow_centres(clip, np.random.default_rng([seed, number]))
    (row,) = measure(tracks, Camera.of(clip.camera_json), FitSettings(local_window_s=0))
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


@pytest.mark.parametrize(("number", "widens"), [(0, False), (7, True)])
def test_equal_losses_leave_the_values_and_seldom_widen_their_errors(number, widens, monkeypatch):
    row, _ = measure_hit(number, 12, drag=0.0)
    monkeypatch.setattr(estimate, "compare_losses", lambda *_: None)
    alone, _ = measure_hit(number, 12, drag=0.0)
    assert (row["status"], row["flags"], row["v0"]) == ("ok", "", alone["v0"])
    assert (row["v0_std"] > alone["v0_std"]) == widens
    assert row["v0_std"] < 2.5 * alone["v0_std"]
