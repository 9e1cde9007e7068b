"""Errors of the camera file in all that is measured: held to draws of wrong cameras, and to units."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from tracker_noisy import BENCHMARK, dataset, noisy, scalars_of, truth_of

from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.measurement.estimate import fit_all, measure
from tracker.results import to_centres

CLIPS = 12
SHARE = 0.004
KEYS = ("scale", "fps", "ball_diameter")


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    return dataset(tmp_path_factory.mktemp("own") / "data", BENCHMARK, CLIPS)


def wrong(camera, key, off, share=SHARE):
    """The camera as a person knows it, one of its keys wrong by `off` of its standard errors."""
    given = {name: getattr(camera, name) for name in ("size", "exposure", "striker", *KEYS)}
    given |= {key: given[key] * (1 + share * off)}
    return Camera.from_dict(given | ({f"{key}_std": share * given[key]} if share else {}))


def drawn(data, key):
    rng, rows, truths = np.random.default_rng(5), [], scalars_of(data)
    for clip in range(CLIPS):
        truth, camera = truth_of(data, clip)
        (row,) = measure(noisy(truth, rng), wrong(camera, key, rng.normal()))
        rows.append(row | {f"{n}_true": truths[n].iloc[clip] for n in QUANTITY_NAMES})
    return pd.DataFrame(rows)


def unshared(table):
    """The rows as they would be without the errors that the camera's keys make, which the covariances list."""
    rows = table.to_dict("records")
    for row in rows:
        shared = [of["tied"] for of in json.loads(row["cov"])["shared"].values()]
        for name, added in zip(QUANTITY_NAMES, np.square(np.array(shared, float)).sum(axis=0), strict=True):
            row[f"{name}_std"] = np.sqrt(max(row[f"{name}_std"] ** 2 - added, 0.0))
    return pd.DataFrame(rows)


def dishonest(table, kind):
    """Quantities whose z has not the standard deviation 1, within 4 of its sampling errors; those without z too."""
    found = []
    for name in QUANTITY_NAMES:
        z = ((table[f"{name}{kind}"] - table[f"{name}_true"]) / table[f"{name}{kind}_std"]).to_numpy(float)
        z = z[np.isfinite(z)]
        if not (len(z) and abs(z.std() - 1) < 4 / np.sqrt(2 * len(z)) and abs(z.mean()) < 4 / np.sqrt(len(z))):
            found.append(name)
    return found


@pytest.mark.parametrize(
    ("key", "touched"),
    [("scale", "v0 r mu_k C tau1 v1f"), ("fps", "v0 t_c mu_k tau1 v1f"), ("ball_diameter", "b r mu_k C tau1")],
)
def test_a_camera_wrong_by_its_error_leaves_all_errors_true(own, key, touched):
    table = drawn(own, key)
    assert (table["status"] == "ok").all()
    assert table["chi2"].sum() / table["dof"].sum() == pytest.approx(1, abs=4 * np.sqrt(2 / table["dof"].sum()))
    assert dishonest(table, "") == ["w1n"]  # zero by the model
    assert dishonest(table, "_free") == []
    assert set(touched.split()) <= set(dishonest(unshared(table), ""))


LOW, OFF = 0.08, 0.012  # m: the lamp's height, and the error of each of its coordinates


def lit(data, rng):
    """Rows of clips whose glints are of one lamp, taken to centres by another, which a person has measured."""
    rows, truths = [], scalars_of(data)
    for clip in range(CLIPS):
        truth, camera = truth_of(data, clip)
        given = camera.to_dict() | {"lamp": {"position": [0.01, -0.01, LOW], "position_std": [OFF] * 3}}
        told = Camera.from_dict(given)
        place = np.array(told.lamp.position) + rng.normal(0, OFF, 3)
        true = replace(told, lamp=replace(told.lamp, position=tuple(place)))
        tracks = noisy(truth, rng)
        middle = true.unproject(np.column_stack([tracks.x, tracks.y]))[0]
        seen = true.glint_of_centre(middle)
        (row,) = measure(to_centres(replace(tracks, x=seen[:, 0], y=seen[:, 1]), told), told)
        rows.append(row | {f"{n}_true": truths[n].iloc[clip] for n in QUANTITY_NAMES})
    return pd.DataFrame(rows)


def test_a_lamp_that_stands_elsewhere_by_its_error_leaves_all_errors_true(own):
    table = lit(own, np.random.default_rng(11))
    assert (table["status"] == "ok").all()
    assert dishonest(table, "") == ["w1n"]
    assert dishonest(table, "_free") == []
    assert set(json.loads(table["cov"][0])["shared"]) == {f"lamp.position[{axis}]" for axis in range(3)}
    assert {"v0", "b"} <= set(dishonest(unshared(table), ""))


def test_the_lamps_error_is_not_that_of_outlines(own):
    truth, camera = truth_of(own, 0)
    told = Camera.from_dict(camera.to_dict() | {"lamp": {"position": [0.01, -0.01, LOW], "position_std": [OFF] * 3}})
    tracks = noisy(truth, np.random.default_rng(0))  # centres, as a detector of outlines gives them
    (row,), (without,) = (measure(tracks, c) for c in (told, camera))
    assert row["v0_std"] == pytest.approx(without["v0_std"], rel=1e-6)


def power(data, key, name):
    """What the error of a key adds to a quantity's standard error, both relative."""
    truth, camera = truth_of(data, 0)
    tracks = noisy(truth, np.random.default_rng(0))
    (without,), (row,) = (measure(tracks, wrong(camera, key, 0, share)) for share in (0.0, SHARE))
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


CAMERAS, EACH = 12, 8


def cameras(data):
    """Rows of the clips of each of some wrong cameras."""
    rng = np.random.default_rng(2)
    for number in range(CAMERAS):
        off, rows = rng.normal(), []
        for clip in range(number * EACH, (number + 1) * EACH):
            truth, camera = truth_of(data, clip)
            rows += measure(noisy(truth, rng), wrong(camera, "fps", off))
        yield rows


def joint(measured, truths, shared):
    """z of all that fit.json has, (cameras, quantities), clips of each camera in common; shared: as the rows say."""
    out = []
    for rows in measured:
        told = [row if shared else row | {"cov": row["cov"].replace("shared", "alone")} for row in rows]
        fit = fit_all(pd.DataFrame(told))
        found = {n: (fit["chi2"][n], fit["chi2"][f"{n}_std"]) for n in ("r", "mu_k", "C")}
        found |= {f"{n} mean": (fit["scatter"][n]["mean"], fit["scatter"][n]["std"]) for n in ("r", "mu_k", "C")}
        found |= {f"{n} rolling": (fit["rolling"][n], fit["rolling"][f"{n}_std"]) for n in ("drag", "decel")}
        out.append({k: (v - truths[k.split()[0]].iloc[0]) / std for k, (v, std) in found.items()})
        assert ("shared_std" in fit["chi2"]) == shared
        if shared:  # friction is an acceleration: twice the frame rate's relative error
            assert fit["chi2"]["shared_std"]["mu_k"] == pytest.approx(2 * SHARE * fit["chi2"]["mu_k"], rel=0.05)
            assert fit["scatter"]["r"]["shared_std"] < 0.01 * fit["scatter"]["r"]["std"]
    return pd.DataFrame(out)


def test_what_clips_of_one_camera_share_does_not_average_away(tmp_path):
    data = dataset(tmp_path / "data", {k: v for k, v in BENCHMARK.items() if k != "model"}, CAMERAS * EACH)
    widest = 1 + 4 / np.sqrt(2 * CAMERAS)
    measured, truths = list(cameras(data)), scalars_of(data)
    z = joint(measured, truths, shared=True)
    assert (z.std(ddof=0) < widest).all()
    assert (joint(measured, truths, shared=False).std(ddof=0)[["mu_k", "mu_k mean"]] > widest).all()


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
