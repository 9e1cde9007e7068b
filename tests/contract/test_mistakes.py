"""Mistakes that newcomers make: each ends with status 2 and one line that says what is wrong, and leaves nothing."""

import json
import shlex
import sys
from importlib.metadata import version

import numpy as np
import pandas as pd
import pytest
import tifffile
from tracker_film import CAMERA, write_clip, write_dataset

import discrepancy.cli
import synthcam.cli
import synthcam_shared.application
import tracker.cli
from synthcam_shared.outputs import lock_folder
from tracker import pipeline

MAINS = {"synthcam": synthcam.cli.main, "tracker": tracker.cli.main, "discrepancy": discrepancy.cli.main}
CAMERAS = {
    "scale_in_mm": {**CAMERA, "scale": 0.16},
    "fps_text": {**CAMERA, "fps": "250"},
    "ball_in_mm": {**CAMERA, "ball_diameter": 2.38},
    "other_size": {**CAMERA, "size": [640, 480]},
    "units": {**CAMERA, "ball_diameter": "2.38mm"},
    "size_text": {**CAMERA, "size": "200x160"},
    "no_fps": {k: v for k, v in CAMERA.items() if k != "fps"},
    "a_list": [CAMERA],
}
SCENES = {
    "s": "timing: {frames: 5, contact_frame: 2}",
    "comma": "launch: {v0: 0,3}",
    "comma_text": "launch:\n  v0: 0,3",
    "units": "ball: {diameter: 2.38mm}",
    "in_mm": "ball: {diameter: 2.38}",
    "degrees": "launch: {heading: 90}",
    "no_frames": "timing: {frames: 0}",
    "section": "lanuch: {v0: 0.3}",
    "key": "launch: {vo: 0.3}",
    "elsewhere": "v0: 0.3",
    "effect": "effects: {plate_tillt: {x: 1.0e-3}}",
    "tabs": "launch:\n\tv0: 0.3",
    "model_section": "effcts: {plate_tilt: {x: 1.0e-3}}",
}


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with a dataset, its results, tables, cameras and scenes, right and wrong."""
    folder = tmp_path_factory.mktemp("bench")
    write_dataset(folder / "dataset", np.random.default_rng(0), clips=1)
    pipeline.run(folder / "dataset", folder / "results", "maximum_likelihood", 1)
    table = pd.read_parquet(folder / "results/clips/000000/tracks.parquet")[["frame", "particle", "x", "y"]]
    table.insert(0, "clip", 0)
    table.to_csv(folder / "tracks.csv", index=False)
    for name, data in {**CAMERAS, "camera": CAMERA}.items():
        (folder / f"{name}.json").write_text(json.dumps(data))
    for name, text in SCENES.items():
        (folder / f"{name}.yaml").write_text(text)
    (folder / "unknown.xml").write_text("<gpx/>")
    table.rename(columns={"x": "u", "y": "v"}).to_csv(folder / "other_names.csv", index=False)
    table[["x", "y"]].to_csv(folder / "no_header.csv", index=False, header=False)
    table.drop(columns="particle").to_csv(folder / "no_particle.csv", index=False)
    table.assign(frame=table.frame + 0.5).to_csv(folder / "half_frames.csv", index=False)
    table.assign(x=table.x * 1.6e-4, y=table.y * 1.6e-4).to_csv(folder / "metres.csv", index=False)
    table.assign(x="a").to_csv(folder / "text.csv", index=False)
    pd.concat([table, table]).to_csv(folder / "twice.csv", index=False)
    (folder / "data.zip").write_bytes(b"PK\3\4" + bytes(100))
    (folder / "table.xlsx").write_bytes(b"PK\3\4" + bytes(100))
    (folder / "notes.docx").write_bytes(b"PK\3\4" + bytes(100))
    (folder / "broken.avi").write_bytes(b"RIFF" + bytes(100))
    (folder / "not.json").write_text("{fps: 250}")
    (folder / "empty").mkdir()
    (folder / "truthful/clips").mkdir(parents=True)
    (folder / "truthful/truth").mkdir()
    (folder / "truthful/truth/clips.parquet").touch()
    (folder / "full").mkdir()
    (folder / "full/notes.txt").write_text("mine")
    write_clip(folder / "no_camera", np.zeros((3, 160, 200), np.uint8))
    (folder / "no_camera/camera.json").unlink()
    tifffile.imwrite(folder / "film.tif", np.zeros((3, 160, 200), np.uint8), imagej=True)
    return folder


MISTAKES = {
    # commands and options
    "synthcam genrate s.yaml -o new": "Did you mean 'generate'",
    "tracker trak dataset -o new": "Did you mean 'track'",
    "discrepancy fnd results -o new": "Did you mean 'find'",
    "tracker track dataset -o new --detectr centroid": "--detector",
    "tracker track dataset": "Missing option '-o'",
    "tracker track dataset new -o results2": "unexpected extra argument",
    "synthcam generate s.yaml -o new --clips many": "--clips",
    "synthcam generate s.yaml -o new --clips -3": "--clips",
    "synthcam generate s.yaml -o new --seed today": "--seed",
    "tracker track dataset -o new --workers 0": "--workers",
    "tracker calibrate film.tif --diameter 2.38mm --fps 250 -o new": "--diameter",
    "tracker calibrate film.tif --diameter 2.38e-3 -o new": "Missing option '--fps'",
    "tracker calibrate film.tif --diameter 2,38 --fps 250 -o new": "--diameter",
    "discrepancy find results -o new": "Missing option '--model'",
    "synthcam doctr": "Did you mean 'doctor'",
    "synthcam find results -o new": "No such command 'find'",
    "tracker track dataset -o new --detector centriod": "did you mean centroid?",
    # paths
    "synthcam generate sceen.yaml -o new": "sceen.yaml: no such file",
    "synthcam generate dataset -o new": "dataset: a folder, expected",
    "synthcam generate film.tif -o new": "film.tif",
    "synthcam generate s.yaml -o full": "full: holds something else",
    "synthcam generate s.yaml -o s.yaml": "s.yaml",
    "synthcam export dataset --format moot -o new": "there are",
    "synthcam verify results": "results",
    "synthcam preview s.yaml -o frame.png --from-above --frame 1": "--frame: of a film",
    "synthcam preview s.yaml -o frame.jpg": "expected a name that ends in .png, .gif or .mp4",
    "synthcam stream sceen.yaml -o new": "sceen.yaml: no such file",
    "synthcam stream s.yaml -o new --format tar": "--format tar: no such format; there are webdataset, zarr",
    "synthcam stream s.yaml -o new --frames 9 --clips 2": "--clips 2: beside --frames; expected one of the two",
    "synthcam stream s.yaml -o new --clips 2000000": "--clips 2000000: expected at most 1000000",
    "synthcam stream s.yaml -o new --every 0": "--every",
    "synthcam stream s.yaml -o full --clips 1": "full: exists and holds something else",
    "synthcam effects plate_tlt": "did you mean plate_tilt?",
    "tracker track datset -o new": "datset: no such file or folder",
    "tracker track s.yaml -o new": "not a .yaml file",
    "tracker track data.zip -o new": "not a .zip file",
    "tracker track notes.docx -o new": "not a .docx file",
    "tracker track broken.avi --camera camera.json -o new": "broken.avi",
    "tracker track empty -o new": "empty: nothing to track in it, expected clips/",
    "tracker track full -o new": "full: nothing to track in it, expected clips/",
    "tracker track dataset -o dataset": "dataset: exists",
    "tracker track dataset -o dataset/new": "expected a folder outside",
    "tracker track dataset -o full": "full: exists and holds something else",
    "tracker track dataset -o s.yaml": "s.yaml: exists",
    "tracker track dataset -o new --camera dataset": "dataset",
    "tracker open results film.tif": "film.tif: expected one film, or several RESULTS",
    "tracker open film.tif --film film.tif": "--film: expected RESULTS before it, and film.tif are none",
    "tracker open results --film datset": "datset: no such file or folder",
    "tracker open results -o results/new": "results/new: lies in results, expected a folder outside it",
    "tracker open datset": "datset: no such file or folder",
    "tracker open s.yaml": "not a .yaml file",
    "tracker open film.tif --camera other_size.json": "frames are 200x160, expected 640x480",
    "tracker open film.tif -o s.yaml": "s.yaml: a file, expected a folder",
    "tracker open dataset -o dataset/new": "expected a folder outside",
    "tracker combine -o new": "Missing argument 'RESULTS...'",
    "tracker combine dataset -o new": "dataset: no estimates.parquet in it, expected RESULTS",
    "tracker combine results -o results": "results: the command reads results/estimates.parquet in it",
    "tracker combine results -o new --quantities restitution": "--quantities: restitution: not measured, expected some",
    "tracker score results --truth results -o new": "results/truth",
    "tracker score dataset --truth dataset -o new": "truth/clips.parquet",
    "tracker calibrate film.tif --diameter 2.38 --fps 250 -o new": "--diameter",
    "tracker calibrate film.tif --diameter 2.38e-3 --fps 250 -o camera.json": "exists and was not made by",
    "discrepancy find dataset --model s.yaml -o new": "expected RESULTS",
    "discrepancy find results --model s.yaml -o new": "no clip with a measured collision",
    "discrepancy find results --model results -o new": "results: a folder, expected",
    "discrepancy find tracks.csv --model s.yaml -o new": "expected --camera",
    "discrepancy find results --model s.yaml -o results": "results: the command reads it",
    "discrepancy find results --model model_section.yaml -o new": "effcts: unknown key; did you mean effects?",
    "discrepancy add plate_tlt --model s.yaml --fit results -o new.yaml": "plate_tlt",
    "synthcam merge dataset s.yaml -o new": "not a finished shard",
    "synthcam verify film.tif": "film.tif",
    "tracker track camera.json -o new": "not a .json file",
    "tracker track film.tif --camera tracks.csv -o new": "tracks.csv: cannot be read as JSON",
    "tracker measure camera.json --camera tracks.csv -o new": "camera.json: JSON, expected a table of tracks",
    "tracker measure dataset --camera camera.json -o new": "dataset: a folder, expected",
    "tracker score results --truth nowhere -o new": "nowhere/truth/clips.parquet: no such file",
    "tracker score results --truth s.yaml -o new": "s.yaml/truth/clips.parquet: no such file",
    "tracker compare dataset --detectors centroid;discs -o new": "no detector",
    "tracker compare results --detectors centroid,discs -o new": "truth/clips.parquet",
    "discrepancy find film.tif --model s.yaml --camera camera.json -o new": "film.tif",
    "discrepancy find results --model camera.json -o new": "unknown key; expected a model or a scene",
    "discrepancy find results --model film.tif -o new": "film.tif: not text",
    "discrepancy add s.yaml --model s.yaml --fit results -o new.yaml": "s.yaml: no such effect",
    "discrepancy add hop --model s.yaml --fit results -o full": "full: a folder",
    # camera files
    "tracker track film.tif --camera scale_in_mm.json -o new": "0.00016",
    "tracker track film.tif --camera fps_text.json -o new": "fps: expected a number",
    "tracker track film.tif --camera ball_in_mm.json -o new": "did you mean 0.00238?",
    "tracker track film.tif --camera other_size.json -o new": "640",
    "tracker track film.tif --camera units.json -o new": "ball_diameter: expected a number",
    "tracker track film.tif --camera size_text.json -o new": "size: expected [width, height]",
    "tracker track film.tif --camera no_fps.json -o new": "fps: expected",
    "tracker track film.tif --camera a_list.json -o new": "expected a table of keys",
    "tracker track film.tif --camera not.json -o new": "not.json",
    "tracker track film.tif --camera film.tif -o new": "film.tif",
    # tables
    "tracker measure tracks.csv --camera camera.json -o new --columns x=x": "no column frame, particle, y, expected",
    "tracker measure tracks.csv --camera camera.json -o new --unit furlong": "--unit: 'furlong': expected a unit",
    "tracker measure unknown.xml --camera camera.json -o new": "XML of <gpx>, expected one of TrackMate",
    "tracker export results --format moot -o new": "did you mean mot?",
    "tracker export dataset --format mot -o new": "expected RESULTS",
    "tracker export results --format mot -o full": "full: exists, expected a new file",
    "tracker measure other_names.csv --camera camera.json -o new": "no column x, y, expected frame",
    "tracker measure no_header.csv --camera camera.json -o new": "--columns frame=1,track=2,x=3,y=4",
    "tracker measure no_particle.csv --camera camera.json -o new": "particle",
    "tracker measure half_frames.csv --camera camera.json -o new": "frame",
    "tracker measure metres.csv --camera camera.json -o new": "expected pixels, not metres",
    "tracker measure text.csv --camera camera.json -o new": "x",
    "tracker measure twice.csv --camera camera.json -o new": "frame",
    "tracker measure table.xlsx --camera camera.json -o new": "save it as CSV",
    "tracker measure results --camera camera.json -o new": "results",
    "tracker measure film.tif --camera camera.json -o new": "film.tif",
    # scenes
    "synthcam generate comma.yaml -o new": "comma.yaml",
    "synthcam generate comma_text.yaml -o new": "v0",
    "synthcam generate units.yaml -o new": "ball.diameter",
    "synthcam generate in_mm.yaml -o new": "two ball diameters (2.38 m)",
    "synthcam generate degrees.yaml -o new": "launch.heading: expected radians",
    "synthcam generate no_frames.yaml -o new": "timing.frames",
    "synthcam generate section.yaml -o new": "did you mean launch?",
    "synthcam generate key.yaml -o new": "did you mean launch.v0?",
    "synthcam generate elsewhere.yaml -o new": "did you mean launch.v0?",
    "synthcam generate effect.yaml -o new": "did you mean effects.plate_tilt?",
    "synthcam generate tabs.yaml -o new": "tabs.yaml, line 2",
    "synthcam generate s.yaml -o new --set launch.v0": "expected key=value",
    "synthcam generate s.yaml -o new --set launch.speed=0.3": "launch.speed: unknown key",
    "synthcam generate s.yaml -o new --set launch.v0=0.3m": "launch.v0",
}


@pytest.mark.parametrize("typed", MISTAKES)
def test_a_mistake_is_one_line(typed, bench, monkeypatch, capsys):
    before = sorted(bench.rglob("*"))
    monkeypatch.chdir(bench)
    monkeypatch.setattr(sys, "argv", shlex.split(typed))
    with pytest.raises(SystemExit) as stopped:
        MAINS[sys.argv[0]]()
    out, err = capsys.readouterr()
    assert (out, err.count("\n"), stopped.value.code) == ("", 1, 2), err
    assert err.startswith(sys.argv[0])
    assert MISTAKES[typed] in err
    assert sorted(bench.rglob("*")) == before


@pytest.mark.parametrize("name", MAINS)
def test_every_command_tells_its_version(name, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [name, "--version"])
    with pytest.raises(SystemExit) as stopped:
        MAINS[name]()
    assert stopped.value.code == 0
    assert capsys.readouterr().out == f"{name} {version('synthcam')}\n"


def test_without_a_terminal_progress_is_lines(monkeypatch, capsys):
    clock = iter([0.0, 4.0, 30.0, 32.0, 90.0, 150.0])
    monkeypatch.setattr(synthcam_shared.application.time, "monotonic", lambda: next(clock))
    with synthcam_shared.application.progress_bar("clips") as progress:
        for done in (20, 21, 22, 23, 30):  # 20 of an earlier run
            progress(done, 30)
    out, err = capsys.readouterr()
    assert out == ""
    assert err == "clips: 21 of 30 after 30 s, about 234 s left\nclips: 23 of 30 after 90 s, about 201 s left\n"


def test_progress_without_an_end(monkeypatch, capsys):
    clock = iter([0.0, 4.0, 40.0])
    monkeypatch.setattr(synthcam_shared.application.time, "monotonic", lambda: next(clock))
    with synthcam_shared.application.progress_bar("clips") as progress:
        progress(0, 0)
        progress(7, 0)
    assert capsys.readouterr().err == "clips: 7 after 40 s\n"


def test_two_at_one_output(bench, monkeypatch, capsys):
    """The folder in which an export or a report is made is locked, and stays with who came first."""
    monkeypatch.chdir(bench)
    for typed, made in (
        ("synthcam export truthful --format mot -o new", "new.tmp"),
        ("discrepancy find results --model s.yaml -o new", "new.tmp"),
        ("tracker track dataset -o new", "new.partial"),
        ("tracker score results --truth dataset -o new", "new"),
    ):
        monkeypatch.setattr(sys, "argv", shlex.split(typed))
        with lock_folder(bench / made), pytest.raises(SystemExit) as stopped:
            MAINS[sys.argv[0]]()
        err = capsys.readouterr().err
        assert (stopped.value.code, err.count("\n")) == (2, 1)
        assert f"{made}: another process is at work there" in err
        (bench / made).rmdir()
