"""The commands end to end: results that depend on nothing but the pictures, and clear words for bad input."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tifffile
from tracker_film import CAMERA, collision, film, write_clip, write_dataset
from typer.testing import CliRunner

from synthcam_shared.errors import InputError
from tracker import cli, pipeline, recording
from tracker.detection import detectors
from tracker.tables.read import read_tracks
from tracker.tables.table_options import TableOptions

COLUMNS = [
    "frame",
    "particle",
    "x",
    "y",
    "x_std",
    "y_std",
    "cov_xy",
    "flux",
    "flags",
    "glint_x",
    "glint_y",
    "x_fixed_std",
    "y_fixed_std",
    "cov_xy_fixed",
]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return write_dataset(tmp_path_factory.mktemp("data") / "set", np.random.default_rng(0))


@pytest.fixture(scope="module")
def tracked(dataset, tmp_path_factory):
    output = tmp_path_factory.mktemp("out") / "results"
    pipeline.run(dataset, output, "maximum_likelihood", 1)
    return output


def contents(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_results_are_as_the_contract_says(tracked):
    table = pd.read_parquet(tracked / "clips/000000/tracks.parquet")
    assert list(table.columns) == COLUMNS
    assert table["frame"].tolist() == [*range(40)] * 2
    assert table["particle"].tolist() == [0] * 40 + [1] * 40
    again = pd.read_csv(tracked / "clips/000000/tracks.csv", keep_default_na=False)
    assert np.allclose(again["x"], table["x"], atol=0, rtol=1e-15)
    motion = pd.read_parquet(tracked / "clips/000001/motion.parquet")
    assert list(motion.columns) == ["t_s", "particle", "vx", "vy", "energy", "p_along", "p_across"]
    estimates = pd.read_parquet(tracked / "estimates.parquet")
    assert estimates["clip"].tolist() == [0, 1]
    assert {"collision", "striker", "status", "r", "r_std", "r_free", "r_paper", "cov"} <= set(estimates.columns)
    assert estimates["r"].dtype == float
    json.loads((tracked / "fit.json").read_text())
    assert json.loads((tracked / "camera.json").read_text())["fps"] == 250


def test_tracks_are_the_balls_centres(dataset, tracked):
    """The film's paths are those of the glints: the centres stand off by what physics says, R (...) / 2."""
    for number in (0, 1):
        table = pd.read_parquet(tracked / f"clips/00000{number}/tracks.parquet")
        paths = collision(40, contact=18.4 + number, speed=2.5, angle=0.4 + number)
        free = np.abs(np.arange(40) - 18.4 - number) > 1.6
        for particle in (0, 1):
            own = table[table["particle"] == particle]
            seen = own[["glint_x", "glint_y"]].to_numpy()
            ball = int(np.argmin([np.abs(paths[0, b] - seen[0]).sum() for b in (0, 1)]))
            assert np.abs(seen[free] - paths[free, ball]).max() < 0.06
            x = (seen[:, 0] - 99.5) * 1.6e-4
            offset = 1.19e-3 * ((0.05 - x) / 0.45 + x / 0.5) / 2 / 1.6e-4
            assert np.abs(seen[:, 0] - own["x"] - offset).max() < 0.01


def test_workers_and_truth_change_nothing(dataset, tracked, tmp_path):
    copy = tmp_path / "elsewhere"
    shutil.copytree(dataset, copy)
    for truth in list(copy.rglob("truth")):
        shutil.rmtree(truth)
    pipeline.run(copy, tmp_path / "two", "maximum_likelihood", 2)
    assert contents(tmp_path / "two") == contents(tracked)


def test_an_interrupted_run_goes_on_to_the_same_bytes(dataset, tracked, tmp_path, monkeypatch):
    real = recording.track_clip

    def stop_at_second(clip, *rest):
        if clip.number == 1:
            raise KeyboardInterrupt
        return real(clip, *rest)

    monkeypatch.setattr(recording, "track_clip", stop_at_second)
    output = tmp_path / "results"
    with pytest.raises(KeyboardInterrupt):
        pipeline.run(dataset, output, "maximum_likelihood", 1)
    assert not output.exists()
    (tmp_path / "results.partial/clips/000001.tmp").mkdir()
    with pytest.raises(InputError, match=r"left by an interrupted run .*\(detector maximum_likelihood instead of cent"):
        pipeline.run(dataset, output, "centroid", 1)
    monkeypatch.setattr(recording, "track_clip", real)
    outcome = pipeline.run(dataset, output, "maximum_likelihood", 1)
    assert (outcome.clips, outcome.fresh) == (2, 1)
    assert contents(output) == contents(tracked)
    assert not (tmp_path / "results.partial").exists()
    assert pipeline.run(dataset, output, "maximum_likelihood", 1).fresh == 0


def test_interrupted_it_says_how_to_go_on(dataset, tmp_path, monkeypatch, capsys):
    def stop(*given):
        raise KeyboardInterrupt

    monkeypatch.setattr(recording, "track_clip", stop)
    words = ["tracker", "track", str(dataset), "-o", str(tmp_path / "out"), "--workers", "1"]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    assert stopped.value.code == 130
    assert capsys.readouterr().err == "tracker: interrupted; the same command continues where it stopped\n"


def test_results_of_anything_else_are_refused(dataset, tracked, tmp_path):
    with pytest.raises(InputError, match="another run"):
        pipeline.run(dataset, tracked, "centroid", 1)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("precious")
    with pytest.raises(InputError, match="something else"):
        pipeline.run(dataset, tmp_path / "mine", "maximum_likelihood", 1)
    assert (tmp_path / "mine" / "thesis.tex").read_text() == "precious"


def test_measure_takes_any_programs_table(tracked, tmp_path):
    camera = tracked / "camera.json"
    table = pd.read_parquet(tracked / "clips/000000/tracks.parquet")
    bare = table[["frame", "particle", "x", "y"]].sample(frac=1, random_state=1)
    bare.to_csv(tmp_path / "tracks.csv", index=False)
    outcome = pipeline.measure_tables(tmp_path / "tracks.csv", tmp_path / "out", camera)
    assert outcome.estimates["clip"].tolist() == [0]
    glints = table.assign(x=table["glint_x"], y=table["glint_y"], clip=7, striker="a").drop(columns=["glint_x"])
    glints.to_parquet(tmp_path / "glints.parquet")
    outcome = pipeline.measure_tables(tmp_path / "glints.parquet", tmp_path / "out2", camera, TableOptions("glint"))
    assert outcome.estimates["clip"].tolist() == [7]
    assert outcome.estimates["striker"].tolist() == ["a"]
    back = pd.read_parquet(tmp_path / "out2/clips/000007/tracks.parquet")
    assert np.allclose(back["x"], table["x"], atol=1e-9)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("frame,particle,x\n0,0,1\n", "no column y"),
        ("frame,particle,x,y\n0,0,left,2\n", "x: expected numbers"),
        ("frame,particle,x,y\n0.5,0,1,2\n", "frame: expected whole numbers"),
        ("frame,particle,x,y\n0,,1,2\n", "no row has a particle"),
        ("frame,particle,x,y\n0,0,1,2\n0,0,1,3\n", "twice in frame 0"),
        ("frame,particle,x,y,striker\n0,0,1,2,c\n", "striker"),
    ],
)
def test_bad_tables(tmp_path, text, word):
    path = tmp_path / "tracks.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=word) as error:
        read_tracks(path, CAMERA)
    assert str(error.value).startswith(str(path))


@pytest.mark.parametrize("text", ["", "\n", "frame,particle,x,y\n", '<Tracks spaceUnits="pixel"/>'])
@pytest.mark.parametrize("unit", ["", "mm"])
def test_an_empty_table_is_a_result_without_a_detection(tmp_path, text, unit):
    (tmp_path / "tracks.csv").write_text(text)
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA))
    outcome = pipeline.measure_tables(
        tmp_path / "tracks.csv", tmp_path / "out", tmp_path / "camera.json", TableOptions(unit=unit)
    )
    assert outcome.estimates["status"].tolist() == ["too few detections"]
    assert len(pd.read_parquet(tmp_path / "out/clips/000000/tracks.parquet")) == 0
    if not text.strip():
        assert any("an empty file, a result without a detection" in str(note) for note in outcome.notes)


def test_lost_rows_of_a_table_are_left_out(tmp_path):
    path = tmp_path / "tracks.csv"
    path.write_text("frame,particle,x,y\n0,0,1,2\n1,0,,\n2,0,3,4\n")
    tracks, striker = read_tracks(path, CAMERA).clips[0]
    assert tracks.frame.tolist() == [0, 2]
    assert striker is None


def test_status_two_and_one_line_from_a_process_that_knows_nothing_of_synthcam(tmp_path):
    """The whole command line is imported there, and synthcam is not."""
    write_clip(tmp_path / "clip", np.zeros((3, 160, 200), np.uint8), {**CAMERA, "fps": "fast"})
    code = (
        "import atexit, sys, tracker.detection.detectors.maximum_likelihood, tracker.detection.detectors.centroid\n"
        "from tracker import cli, pipeline\n"
        "atexit.register(lambda: print(sorted({m.split('.')[0] for m in sys.modules} & {'synthcam', 'discrepancy'})))\n"
        "cli.main()\n"
    )
    words = [sys.executable, "-c", code, "track", str(tmp_path / "clip"), "-o", str(tmp_path / "out")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "[]\n")
    assert done.stderr.startswith("tracker: ")
    assert done.stderr.count("\n") == 1
    assert "fps: expected a number from" in done.stderr
    assert Path(cli.__file__).parent.name == "tracker"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["track", "{tmp}/none", "-o", "{tmp}/out"], "no such file"),
        (["track", "{tmp}/one.tif", "-o", "{tmp}/out"], "one frame only"),
        (["track", "{tmp}/two.tif", "-o", "{tmp}/out", "--detector", "magic"], "no detector 'magic', expected one of"),
        (["track", "{tmp}/two.tif", "-o", "{tmp}/out", "--camera", "{tmp}/no.json"], "no such file"),
        (["compare", "{tmp}/none", "--detectors", "centroid,magic", "-o", "{tmp}/out"], "no detector 'magic'"),
        (["benchmark", "run", "--trackers", "synthcam,magic", "-o", "{tmp}/out"], "no detector 'magic'"),
        (
            ["compare", "{tmp}/none", "--detectors", "centroid,centroid", "-o", "{tmp}/out"],
            "--detectors: expected different",
        ),
        (["compare", "{tmp}/none", "--detectors", "centroid", "-o", "{tmp}/out"], "expected a dataset with its truth"),
        (["calibrate", "{tmp}/none", "--diameter", "2e-3", "--fps", "250", "-o", "{tmp}/out"], "no such file"),
        (["calibrate", "{tmp}/two.tif", "--diameter", "0", "--fps", "250", "-o", "{tmp}/out"], "--diameter: expected"),
        (["calibrate", "{tmp}/two.tif", "--diameter", "2e-3", "--fps", "nan", "-o", "{tmp}/out"], "--fps: expected"),
        (["calibrate", "{tmp}/two.tif", "--diameter", "2e-3", "--fps", "250", "-o", "{tmp}/out"], "0 glints found"),
        (["measure", "{tmp}/none.csv", "--camera", "{tmp}/no.json", "-o", "{tmp}/out"], "no such file"),
        (["score", "{tmp}/none", "--truth", "{tmp}/none", "-o", "{tmp}/out"], "no such file"),
        (["score", "{tmp}/none", "--truth", "{tmp}/none", "-o", "{tmp}"], "holds something else"),
        (["measure", "{tmp}/one.tif", "--camera", "{tmp}/no.json", "-o", "{tmp}/out", "--point", "rim"], "--point"),
    ],
)
def test_bad_input_by_command(tmp_path, words, said, monkeypatch, capsys):
    tifffile.imwrite(tmp_path / "one.tif", np.zeros((1, 32, 32), np.uint8))
    tifffile.imwrite(tmp_path / "two.tif", np.zeros((2, 32, 32), np.uint8))
    monkeypatch.setattr(sys, "argv", ["tracker", *(w.format(tmp=tmp_path) for w in words)])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_stack_without_a_camera_is_tracked_in_pixels(tmp_path):
    frames = film(np.random.default_rng(1), collision(20, contact=9.3, speed=4.0))
    tifffile.imwrite(tmp_path / "stack.tif", frames, imagej=True)
    outcome = pipeline.run(tmp_path / "stack.tif", tmp_path / "out", "maximum_likelihood", 1)
    table = pd.read_parquet(tmp_path / "out/clips/000000/tracks.parquet")
    assert len(table) == 40
    assert all("glint" in words for words in table["flags"])
    assert outcome.estimates["status"].tolist() != ["ok"]


def test_what_was_assumed_and_what_is_not_modelled_is_said(tmp_path):
    second = {"position": [-0.1, 0.0, 0.4], "radius": 0.01}
    camera = {**CAMERA, "lamp": CAMERA["lamp"] | {"second": second}, "psf": CAMERA["psf"] | {"defocus_px": 0.5}}
    frames = film(np.random.default_rng(2), collision(20, contact=9.3, speed=4.0))
    write_clip(tmp_path / "clip", frames, camera)
    words = ["track", str(tmp_path / "clip"), "-o", str(tmp_path / "out"), "--workers", "1", "--no-pages"]
    done = CliRunner().invoke(cli.app, words)
    assert done.exit_code == 0
    assert "assumed or estimated: psf.sigma_px" in done.stderr
    assert "lamp.second: positions are biased towards its glints" in done.stderr
    assert "psf.defocus_px: glints are taken as Gaussian" in done.stderr
    kept = json.loads((tmp_path / "out/clips/000000/camera.json").read_text())
    assert kept["psf"]["sigma_px"] == pytest.approx(1.0, rel=0.05)  # as wide as drawn


def test_summaries_and_help(dataset, tmp_path):
    runner = CliRunner()
    done = runner.invoke(
        cli.app, ["track", str(dataset), "-o", str(tmp_path / "out"), "--workers", "1", "--no-pages", "--json"]
    )
    summary = json.loads(done.stdout)
    assert (summary["clips"], summary["fresh"], summary["frames"]) == (2, 2, 80)
    assert sum(summary["status"].values()) == 2
    rows = pd.read_parquet(tmp_path / "out/estimates.parquet").to_dict("records")
    for told, row in zip(summary["collisions"], rows, strict=True):
        assert [told[k] for k in ("clip", "collision", "status")] == [row[k] for k in ("clip", "collision", "status")]
        for name in ("v0", "r", "mu_k", "C", "tau1", "energy_fraction"):
            known = [None if np.isnan(v) else v for v in (row[name], row[f"{name}_std"])]
            assert [told[name]["value"], told[name]["std"]] == known
    for name in ("track", "measure", "score", "compare", "calibrate"):
        told = runner.invoke(cli.app, [name, "--help"])
        assert told.exit_code == 0
        assert f"Example: tracker {name}" in told.stdout
    for name in ("track", "compare"):
        words = runner.invoke(cli.app, [name, "--help"], env={"COLUMNS": "200"}).stdout.replace(",", " ").split()
        assert {p.stem for p in Path(detectors.__file__).parent.glob("*.py")} - {"__init__"} <= set(words)
