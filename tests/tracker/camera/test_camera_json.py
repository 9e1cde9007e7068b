"""camera.json beyond the plain camera: what is used is right, what is not is said, what is nonsense is refused."""

import json
import math
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from tracker_film import CAMERA, collision
from tracker_noisy import NOISE, dataset, noisy, scalars_of, truth_of

from synthcam_shared.errors import InputError
from tracker import cli
from tracker.camera.camera import Camera
from tracker.measurement.estimate import measure


def camera(**sections):
    return Camera.from_dict({**CAMERA, **{k: CAMERA.get(k, {}) | v for k, v in sections.items()}}, "camera.json")


def test_what_does_not_matter_is_not_mentioned():
    plain = camera()
    other = camera(
        lens={"vignetting": 0.3},
        lamp={"facing": "centre", "flicker": {"depth": 0.2, "frequency": 100, "phase": 0}},
        surface={"steel": "iron", "plate_gloss": 0.1, "plate_texture": 0.1, "plate_shadow": True},
        sensor={"hot_pixels": 1e-4, "hot_dark": 1e6},
        shutter={"kind": "global"},
    )
    assert other.to_dict() == plain.to_dict()
    assert other.unmodelled == ()


@pytest.mark.parametrize(
    ("section", "keys"),
    [
        ("psf", {"defocus_px": 2.0}),
        ("psf", {"f_number": 8.0, "pixel_pitch": 5e-6, "wavelength": 5.5e-7}),
        ("surface", {"roughness": 0.02}),
        ("surface", {"scratches": 0.3, "scratch_slope": 0.1}),
    ],
)
def test_what_widens_a_glint_has_its_width_measured(section, keys):
    known = camera(**{section: keys})
    assert known.psf_sigma is None
    assert "psf.sigma_px" in known.assumed
    assert known.unmodelled == (
        f"{section}.{next(iter(keys))}: glints are taken as Gaussian, with the width that the film shows",
    )
    assert camera(**{section: dict.fromkeys(keys, 0)}).psf_sigma == 1.0


def spread(points):
    """Standard deviation, m, of a lamp's points along an axis, the mean of both axes."""
    return math.sqrt(points.var(axis=0).mean())


def test_rings_and_bars_are_as_wide_as_their_light():
    rng = np.random.default_rng(0)
    square = rng.uniform(-1, 1, (400_000, 2))
    reach = np.hypot(*square.T)
    lamps = {
        "disc": ({"radius": 0.03}, 0.03 * square[reach < 1]),
        "ring": ({"radius": 0.03, "inner": 0.02}, 0.03 * square[(reach < 1) & (reach > 2 / 3)]),
        "bar": ({"length": 0.1, "width": 0.02, "angle": 0.4}, square * [0.05, 0.01]),
    }
    for shape, (keys, points) in lamps.items():
        lamp = camera(lamp={"shape": shape, **keys}).lamp
        assert lamp.radius / 2 == pytest.approx(spread(points), rel=0.005)
    assert "lamp.shape bar" in camera(lamp={"shape": "bar", "length": 0.1, "width": 0.02}).unmodelled[0]


def test_a_second_lamp_is_said_to_be_left_out():
    second = {"position": [-0.1, 0, 0.4], "radius": 0.01, "radiance": 1.0}
    assert "lamp.second" in camera(lamp={"second": second}).unmodelled[0]


@pytest.mark.parametrize(
    ("section", "keys", "said"),
    [
        ("shutter", {"kind": "sideways"}, "shutter.kind"),
        ("shutter", {"kind": "rolling"}, "shutter.line_time"),
        ("shutter", {"kind": "rolling", "line_time": -1e-5}, "shutter.line_time"),
        ("lamp", {"shape": "star"}, "lamp.shape"),
        ("lamp", {"shape": "ring", "inner": -1}, "lamp.inner"),
        ("psf", {"defocus_px": "much"}, "psf.defocus_px"),
        ("surface", {"roughness": math.nan}, "surface.roughness"),
    ],
)
def test_nonsense_is_refused_by_its_key(section, keys, said):
    with pytest.raises(InputError, match=f"camera.json: {said}: expected"):
        camera(**{section: keys})


@pytest.mark.parametrize("clips", [1, pytest.param(4, marks=pytest.mark.gate)])
def test_a_rolling_shutter_is_accounted_for(tmp_path, clips):
    """Each row later than the one above: speeds down and up the picture differ by a per cent if that is left out."""
    settings = {
        "camera": {"shutter": "rolling", "line_time": 8e-6},
        "launch": {"v0": 0.3, "b": 0.1, "heading": {"uniform": [1.0, 2.0]}},
    }
    data = dataset(tmp_path / "data", settings, clips)
    quantities = ["v0", "t_c", "r", "tau1", "v1f"]
    used, left_out = [], []
    for clip in range(clips):
        truth, known = truth_of(data, clip)
        assert Camera.from_dict(known.to_dict()).line_time == known.line_time == 8e-6
        true = scalars_of(data).iloc[clip]
        seen = noisy(truth, np.random.default_rng(clip), NOISE)
        (right,), (wrong,) = measure(seen, known), measure(seen, replace(known, line_time=0.0))
        for scores, row in ((used, right), (left_out, wrong)):
            scores.append([(row[q] - true[q]) / right[f"{q}_std"] for q in quantities])
        assert (right["status"], wrong["status"]) == ("ok", "misfit")
    assert np.abs(used).max() < 4
    assert np.abs(left_out).max() > 30


DIGITS, DEEP = "1" + "0" * 400, "[" * 200_000 + "]" * 200_000
LARGE = "ball_diameter: expected a ball that the picture can show, not one of 1.49e+04 px"
VIEW = "K, dist, R, t: expected a view of about 0.00016 m/px"


@pytest.mark.parametrize(
    ("key", "text", "said"),
    [
        *((key, DIGITS, f"{key}: expected a number from") for key in ("fps", "exposure", "scale", "ball_diameter")),
        ("fps", "1" * 5000, "cannot be read as JSON"),
        ("size", f"[{DIGITS}, 160]", "size: expected two whole numbers"),
        ("size", "[1000000000, 1000000000]", "size: expected two whole numbers"),
        ("size", "[32000, 31250]", "size: expected at most"),
        ("t", f"[0, 0, {DIGITS}]", "t: expected 3 numbers"),
        ("assumed", "5", "assumed: expected a list"),
        ("metric", '"no"', "metric: expected true or false"),
        ("K", DEEP, "cannot be read as JSON (nested too deeply)"),
        ("K", "[[1e308, 0, 99], [0, 1e308, 79], [0, 0, 1]]", "K: expected 3 x 3 numbers"),
        ("K", "[[1e-300, 0, 99], [0, 1e-300, 79], [0, 0, 1]]", "K: expected focal lengths"),
        ("K", '[["3117", 0, 99], [0, 3117, 79], [0, 0, 1]]', "K: expected 3 x 3 numbers"),
        ("K", "[[31175, 0, 99], [0, 31175, 79], [0, 0, 1]]", VIEW),
        ("dist", "[1e300, 0, 0, 0, 0]", "dist: expected 5 numbers"),
        ("dist", "[1e9, 0, 0, 0, 0]", VIEW),
        ("dist", "[-1e3, 0, 0, 0, 0]", VIEW),  # the picture folds over itself
        ("fps", "1e-300", "fps: expected a number from"),
        ("fps", "1e300", "fps: expected a number from"),
        ("R", "[[1, 0, 0], [0, 1, 0], [0, 0, -1]]", "R: expected a rotation matrix"),
        ("R", "[[1, 0, 0], [0, 1, 0], [0, 0, 1]]", "R, t: expected a camera above the plate"),
        ("R", "[[1e200, 0, 0], [0, 1e200, 0], [0, 0, 1e200]]", "R: expected 3 x 3 numbers"),
        ("ball_diameter", "2.38", f"{LARGE}; it is in m, did you mean 0.00238?"),
        ("lamp", '{"position": [0, 0, -0.45]}', "lamp.position: expected a lamp above the plate"),
        ("psf", '{"sigma_px": 1e300}', "psf.sigma_px: expected a number from"),
        ("sensor", '{"gain": 1e-300}', "sensor.gain: expected a number from"),
        ("shutter", '{"kind": "rolling", "line_time": 1e300}', "shutter.line_time: expected a number from"),
        ("striker", '"b", "fps": 100', "cannot be read as JSON (key 'fps' given twice)"),
    ],
)
def test_hostile_numbers_are_one_line(tmp_path, monkeypatch, capsys, key, text, said):
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(CAMERA | {key: "HERE"}).replace('"HERE"', text))
    (tmp_path / "tracks.csv").write_text("frame,particle,x,y\n0,0,1,2\n1,0,2,3\n")
    status, err = measured(tmp_path, monkeypatch, capsys)
    assert status == 2
    assert err.startswith(f"tracker: {path}: {said}")
    assert (err.count("\n"), len(err) < 400) == (1, True)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["camera.json", "tracks.csv"]


def measured(folder, monkeypatch, capsys):
    words = ["measure", folder / "tracks.csv", "--camera", folder / "camera.json", "-o", folder / "out"]
    monkeypatch.setattr(sys, "argv", ["tracker", *map(str, words)])
    status = 0
    try:
        cli.main()
    except SystemExit as stop:
        status = stop.code or 0
    return status, capsys.readouterr().err


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (
            "frame,particle,x,y\n10000000000000000000,0,1,2\n",
            "line 2, frame: expected whole numbers from 0 to 2147483647",
        ),
        (
            "frame,particle,x,y\n0,1e19,1,2\n",
            "line 2, particle: expected whole numbers from 0 to 2147483647, not 1e+19",
        ),
        ("clip,frame,particle,x,y\n1e18,0,1,1,2\n", "line 2, clip: expected whole numbers"),
        ("frame,particle,x,y\n0,1,1e300,2\n", "line 2, x: expected positions in px, not 1e+300"),
        ("frame,particle,x,y,x_std,y_std\n0,1,1,2,1,1e300\n", "y_std: expected standard errors"),
        ("frame,particle,x,y,x_std,y_std,cov_xy\n0,1,1,2,1,1,1e300\n", "cov_xy: expected covariances"),
    ],
)
def test_numbers_of_a_table_that_would_wrap_or_overflow(tmp_path, monkeypatch, capsys, table, said):
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA))
    (tmp_path / "tracks.csv").write_text(table)
    status, err = measured(tmp_path, monkeypatch, capsys)
    assert status == 2
    assert err.startswith(f"tracker: {tmp_path / 'tracks.csv'}: {said}")
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_misspelt_key_is_named(tmp_path, monkeypatch, capsys):
    """And no diameter is put in the place of one that is not given: the collision is then not measured."""
    known = {k: v for k, v in CAMERA.items() if k != "ball_diameter"}
    known |= {"ball_diametre": 2.38e-3, "psf": {"sigma": 1.0}, "operator": "me"}
    (tmp_path / "camera.json").write_text(json.dumps(known))
    paths = collision(50, contact=22.3, speed=3.0)
    rows = [(k, ball, *paths[k, ball]) for k in range(50) for ball in (0, 1)]
    pd.DataFrame(rows, columns=["frame", "particle", "x", "y"]).to_csv(tmp_path / "tracks.csv", index=False)
    status, err = measured(tmp_path, monkeypatch, capsys)
    assert status == 0
    assert err.splitlines() == [
        "tracker: ball_diameter: not given; collisions are not measured, and glints are not taken to centres",
        "tracker: ball_diametre: not a key of camera.json; did you mean ball_diameter?",
        "tracker: operator: not a key of camera.json",
        "tracker: psf.sigma: not a key of camera.json; did you mean psf.sigma_px?",
    ]
    (row,) = pd.read_parquet(tmp_path / "out/estimates.parquet").to_dict("records")
    assert row["status"].startswith("no ball_diameter in the camera file")
    assert all(math.isnan(row[name]) for name in ("v0", "b", "t_c", "r", "mu_k", "C", "tau1"))
    motion = pd.read_parquet(tmp_path / "out/clips/000000/motion.parquet")
    assert motion["vx"].max() == pytest.approx(3.0 * math.cos(0.4) * 1.6e-4 * 250, rel=0.01)
    assert "ball_diameter" not in json.loads((tmp_path / "out/camera.json").read_text())


@pytest.mark.parametrize("keys", [("K", "t", "scale"), ("scale",), ("K", "scale")])
def test_without_a_diameter_positions_are_still_in_metres(keys):
    least = {k: CAMERA[k] for k in ("size", "fps", *keys)}
    position, slope = Camera.from_dict(least).unproject([[199.5, 29.5]])
    assert np.allclose(position, [[100 * 1.6e-4, 50 * 1.6e-4]], rtol=1e-9)
    assert np.allclose(slope, [[[1.6e-4, 0], [0, -1.6e-4]]], rtol=1e-9)


def test_a_lens_alone_gives_no_lengths():
    least = {k: CAMERA[k] for k in ("size", "fps", "K")}
    with pytest.raises(InputError, match="scale: expected m/px, or K and t"):
        Camera.from_dict(least)
    with pytest.raises(InputError, match="K: expected the 3x3 camera matrix beside dist"):
        Camera.from_dict({k: CAMERA[k] for k in ("size", "fps", "scale", "dist")})
