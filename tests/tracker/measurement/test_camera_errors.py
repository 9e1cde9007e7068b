"""Errors of the camera file in all that is measured: held to draws of wrong cameras, and to units."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from tracker_noisy import BENCHMARK, dataset, noisy, truth_of

from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.detection.link import to_centres
from tracker.measurement.camera_errors import CameraError, differentiate_residuals
from tracker.measurement.collision.contacts import find_contacts, prepare_contact
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.measurement.collision.least_squares import WhitenedResiduals
from tracker.measurement.estimate import fit_all_jointly, fit_collision, measure
from tracker.measurement.local.local_estimate import estimate_locally
from tracker.measurement.positions import to_ball_tracks
from tracker.settings import FitSettings

pytestmark = pytest.mark.usefixtures("not_local")

SHARE = 0.004
KEYS = ("scale", "fps", "ball_diameter")


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    return dataset(tmp_path_factory.mktemp("own") / "data", BENCHMARK, 1)


def wrong(camera, key, off, share=SHARE):
    """The camera as a person knows it, one of its keys wrong by `off` of its standard errors."""
    given = {name: getattr(camera, name) for name in ("size", "exposure", "striker", *KEYS)}
    given |= {key: given[key] * (1 + share * off)}
    return Camera.from_dict(given | ({f"{key}_std": share * given[key]} if share else {}))


LOW, OFF = 0.08, 0.012  # m: height of the lamp, error of each of its coordinates


@pytest.mark.parametrize("tied", [True, False])
def test_residuals_change_with_the_diameter_as_with_other_balls(own, tied):
    """Against residuals of the same motion of balls that are a little larger, and smaller."""
    truth, camera = truth_of(own, 0)
    balls = to_ball_tracks(noisy(truth, np.random.default_rng(0)), camera)
    [found] = find_contacts(balls, camera.ball_diameter)
    read = fit_collision(prepare_contact(found, camera.ball_diameter, {}, FitSettings()))
    fit, share = read.tied if tied else read.free, 1e-3

    def residual(size):
        problem = WhitenedResiduals(replace(fit.pair, diameter=size * fit.pair.diameter), tied)
        return problem.residual(fit.parameters[problem.index])

    by = differentiate_residuals(fit, [CameraError("ball_diameter", camera.ball_diameter, share)], camera)
    expected = (residual(1 + share) - residual(1 - share)) / 2
    assert by[:, 0] == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())
    assert np.abs(expected).max() > 0.1


def test_the_lamps_error_is_that_of_centres_from_glints(own):
    """The gate holds the errors of many such clips to their claims."""
    truth, camera = truth_of(own, 0)
    exact, told = (
        Camera.from_dict(camera.to_dict() | {"lamp": {"position": [0.01, -0.01, LOW]} | more})
        for more in ({}, {"position_std": [OFF] * 3})
    )
    tracks = noisy(truth, np.random.default_rng(0))
    x, y = told.glint_of_centre(told.unproject(np.column_stack([tracks.x, tracks.y]))[0]).T
    one_law = FitSettings(rolling_loss_difference=0, friction_change=0)  # otherwise errors of departures move all
    (without,), (row,) = (measure(to_centres(replace(tracks, x=x, y=y), c), c, one_law) for c in (exact, told))
    assert set(json.loads(row["cov"])["shared"]) == {f"lamp.position[{axis}]" for axis in range(3)}
    assert row["v0"] == pytest.approx(without["v0"], rel=1e-9)
    assert row["v0_std"] > 1.5 * without["v0_std"]
    assert row["b_std"] > 1.5 * without["b_std"]


def test_the_lamps_error_is_not_that_of_outlines(own):
    truth, camera = truth_of(own, 0)
    told = Camera.from_dict(camera.to_dict() | {"lamp": {"position": [0.01, -0.01, LOW], "position_std": [OFF] * 3}})
    tracks = noisy(truth, np.random.default_rng(0))  # centres, as a detector of outlines gives them
    (row,), (without,) = (measure(tracks, c) for c in (told, camera))
    assert row["v0_std"] == pytest.approx(without["v0_std"], rel=1e-6)


@cache
def measured_with(data, key):
    """The row of the first clip by a camera file that gives the error of a key; of "", none."""
    truth, camera = truth_of(data, 0)
    (row,) = measure(noisy(truth, np.random.default_rng(0)), wrong(camera, key or "fps", 0, SHARE if key else 0.0))
    return row


def power(data, key, name):
    """Compute what the error of a key adds to the standard error of a quantity, both relative."""
    without, row = measured_with(data, ""), measured_with(data, key)
    return np.sqrt(row[f"{name}_std"] ** 2 - without[f"{name}_std"] ** 2) / abs(row[name]) / SHARE


@pytest.mark.parametrize("kind", ["", "_free", "_paper"])
def test_velocities_go_with_scale_and_frame_rate(own, kind):
    for name in ("v0", "v1f", "v2f"):
        assert power(own, "fps", f"{name}{kind}") == pytest.approx(1, abs=0.02)
        assert power(own, "scale", f"{name}{kind}") == pytest.approx(1, abs=0.1)  # the contact's distance resists
    for name, times in (("tau1", 1), ("t_c", 1), ("mu_k", 2)):
        assert power(own, "fps", f"{name}{kind}") == pytest.approx(times, abs=0.02)


@pytest.mark.parametrize(("key", "powers"), [("scale", (1, 0, 1)), ("fps", (1, 1, 2)), ("ball_diameter", (0, 0, 0))])
def test_a_ball_alone(tmp_path, key, powers):
    data = dataset(tmp_path / "data", {"launch": {"kind": "single", "v0": 0.4}}, 1)
    for name, times in zip(("v0", "drag", "decel"), powers, strict=True):
        assert power(data, key, name) == pytest.approx(times, abs=0.01)


def test_covariances_and_what_is_shared_in_the_row(own):
    truth, camera = truth_of(own, 0)
    (row,) = measure(noisy(truth, np.random.default_rng(0)), wrong(camera, "scale", 0))
    table = json.loads(row["cov"])
    at = QUANTITY_NAMES.index("v0")
    assert np.sqrt(table["tied"][at][at]) == pytest.approx(row["v0_std"], rel=1e-12)
    assert table["shared"]["scale"]["of"] == camera.scale
    assert table["shared"]["scale"]["free"][at] == pytest.approx(SHARE * row["v0_free"], rel=0.1)


def stretch(camera, share):
    """The camera with a warp whose only error is a longer map, as that of the scale."""
    half = camera.scale * max(camera.size)
    knots = np.linspace(-half, half, 5)
    dx, dy = np.meshgrid(knots, knots)
    maps = {"errors": [{"dx": (share * dx).tolist(), "dy": (share * dy).tolist()}], "std": 1e-9, "length": half}
    zero = np.zeros((5, 5)).tolist()
    return Camera.from_dict(
        camera.to_dict() | {"warp": {"x": knots.tolist(), "y": knots.tolist(), "dx": zero, "dy": zero} | maps}
    )


def test_an_error_of_the_warp_that_lengthens_all_is_that_of_the_scale(own, monkeypatch):
    """In the tied fit, in the one without a law, in differences, and in the local estimate."""
    monkeypatch.setattr("tracker.measurement.estimate.estimate_locally", estimate_locally)
    truth, camera = truth_of(own, 0)
    tracks = noisy(truth, np.random.default_rng(0))
    (by_scale,), (by_warp,) = (measure(tracks, c) for c in (wrong(camera, "scale", 0), stretch(camera, SHARE)))
    shared = [json.loads(row["cov"])["shared"][key] for row, key in ((by_scale, "scale"), (by_warp, "warp.errors[0]"))]
    for fit in ("tied", "free"):
        np.testing.assert_allclose(*(np.array(one[fit], float) for one in shared), rtol=1e-3, atol=1e-6)
    for name in ("v0", "v0_free", "v0_paper"):
        assert by_warp[f"{name}_std"] == pytest.approx(by_scale[f"{name}_std"], rel=1e-3)
    local = json.loads(by_warp["local_shared"])["warp.errors[0]"]
    for name in ("v0", "v1ox", "v1oy", "v2ox", "v2oy"):
        off = local["effect"][name] / SHARE - by_warp[f"{name}_local"]
        assert abs(off) < 0.03 * by_warp["v0_local"]
    assert abs(local["effect"]["r"]) < 0.1 * SHARE


def test_what_clips_of_one_camera_share_does_not_average_away(tmp_path):
    """The gate holds the errors of many such fits to their claims."""
    data = dataset(tmp_path / "data", {k: v for k, v in BENCHMARK.items() if k != "model"}, 4)
    rng, rows = np.random.default_rng(2), []
    for truth, camera in (truth_of(data, clip) for clip in range(4)):
        rows += measure(noisy(truth, rng), wrong(camera, "fps", 1.0))
    fit = fit_all_jointly(pd.DataFrame(rows))
    alone = fit_all_jointly(pd.DataFrame([row | {"cov": row["cov"].replace("shared", "alone")} for row in rows]))
    assert "shared_std" not in alone["chi2"]
    # friction is an acceleration: twice the frame rate's relative error
    assert fit["chi2"]["shared_std"]["mu_k"] == pytest.approx(2 * SHARE * fit["chi2"]["mu_k"], rel=0.05)
    assert fit["scatter"]["r"]["shared_std"] < 0.01 * fit["scatter"]["r"]["std"]
    for part, std in (("chi2", "mu_k_std"), ("scatter", "std")):
        claimed, by_clips = (f[part] if part == "chi2" else f[part]["mu_k"] for f in (fit, alone))
        assert claimed[std] >= 0.99 * 2 * SHARE * fit["chi2"]["mu_k"] > by_clips[std]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"scale_std": 1e-4}, "camera: scale_std: expected the standard error of scale, at most 0.5 of what that is"),
        ({"ball_diameter_std": 1e-5}, "camera: ball_diameter_std: expected the standard error of ball_diameter"),
        (
            {"lamp": {"position": [0, 0, 0.4], "position_std": [0, 0, 0.3]}},
            "camera: lamp.position_std: expected at most",
        ),
        ({"lamp": {"position": [0, 0, 0.4], "position_std": 0.01}}, "camera: lamp.position_std: expected"),
        ({"fps_std": -1.0}, "camera: fps_std: expected a number from 0 to 1e"),
    ],
)
def test_errors_that_cannot_be_are_refused(given, said):
    with pytest.raises(InputError) as error:
        Camera.from_dict({"size": [640, 480], "fps": 250, "scale": 1.6e-4} | given)
    assert str(error.value).startswith(said)


def test_errors_stay_with_the_camera():
    given = {"size": [640, 480], "fps": 250, "scale": 1.6e-4, "ball_diameter": 2.38e-3}
    errors = {"scale_std": 1e-6, "fps_std": 0.1, "ball_diameter_std": 1e-6}
    written = Camera.from_dict(given | errors).to_dict()
    assert {key: written[key] for key in errors} == errors
    lamp = {"position": [0.0, 0.0, 0.4], "radius": 0.01, "position_std": [0.01, 0.0, 0.02]}
    assert Camera.from_dict(given | {"lamp": lamp}).to_dict()["lamp"] == lamp
    assert not set(errors) & set(Camera.from_dict(given).to_dict())
