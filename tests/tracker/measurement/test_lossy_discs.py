"""Matte balls in lossy video: errors as large as the residuals, and a misfit that names the codec."""

import dataclasses

import numpy as np
import pytest
from tracker_contacts import SoftHit
from tracker_discs import film, plate

import tracker
from tracker.camera.camera import Camera
from tracker.camera.film_in_memory import wrap_frames
from tracker.camera.recordings import Recording
from tracker.detection.detect import make_view
from tracker.measurement.collision.adequacy import Flag
from tracker.measurement.messages import list_messages

pytestmark = pytest.mark.usefixtures("not_local")

HIT = SoftHit(0.0, 0.85, v0=0.3, friction=0.2, b=0.2, fps=500.0)


def measure(step=0.0, sway=0.0):
    """A result of positions that a codec moves to a grid (m) and sways (m); errors are claimed as 2e-5 m."""
    table = dataclasses.replace(HIT, noise=2e-5).tracks(np.random.default_rng(0))
    if step:
        table[["x", "y"]] = np.round(table[["x", "y"]] / step) * step
    table["x"] += sway * np.sin(table["frame"] / 6)
    table["x_std"] = table["y_std"] = 2e-5
    return tracker.measure(table, HIT.camera | {"sensor": {"codec_noise": 1.0}}, unit="m")


def test_a_lossy_film_of_matte_balls_is_marked_as_encoded():
    camera = Camera.from_dict({"size": [200, 160], "fps": 60.0, "scale": 1e-3, "ball_diameter": 0.0186})
    rng = np.random.default_rng(0)
    ways = np.stack([np.tile([60.3, 50.2], (6, 1)), np.array([120.3, 90.4]) + np.outer(np.arange(6), [1.7, 0.1])])
    pictures = film(rng, ways, ground=plate(rng))
    for lossy in (False, True):
        frames = wrap_frames(pictures)
        frames.lossy = lossy
        view = make_view(Recording(0, camera, frames), "discs")
        assert (view.camera.sensor.codec_noise > 0) is lossy


@pytest.mark.parametrize("step", [0.0, 1.2e-4, 1.8e-4])
def test_residuals_give_the_errors_of_encoded_positions(step):
    row = measure(step).estimates.iloc[0]
    assert row["status"] == "ok"
    for name, true in (("v0", 0.3), ("r", 0.85), ("mu_k", 0.2)):
        assert abs(row[name] - true) < 4 * row[f"{name}_std"]


def test_a_misfit_of_an_encoded_film_keeps_v0_and_r_of_the_free_fit():
    result = measure(sway=1e-4)
    row = result.estimates.iloc[0]
    assert row["status"] == "misfit"
    assert Flag.ENCODED in row["flags"].split("|")
    assert np.isnan(row["r_std"])
    assert row["v0_free_std"] > 0
    for name, true in (("v0", 0.3), ("r", 0.85)):
        std = row[f"{name}_free_std"]
        assert not np.isfinite(std) or abs(row[f"{name}_free"] - true) < 4 * std
    assert any("codec" in str(note) for note in list_messages(result.estimates))
