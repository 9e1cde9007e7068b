"""Results that the page opens: with their film and without it, their tracks, and corrections of them."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest
import tifffile
import yaml
from tracker_film import CAMERA, collision, film, write_clip

pytest.importorskip("starlette", reason="the extra app is not installed")

from synthcam import Scene
from synthcam_shared.errors import InputError
from tracker.app import opened_results
from tracker.app.opened_results import OpenedResults, TracksAlone, find_film, show_tracks_alone
from tracker.app.workbench import OPENED, Workbench
from tracker.camera.camera import Camera
from tracker.camera.recordings import digest_films, open_source, read_ends
from tracker.edits import TrackEdits
from tracker.measurement.collision.adequacy import NO_DIAMETER, NOTHING_ROLLS
from tracker.measurement.estimate import make_empty_row
from tracker.pipeline import measure_tables, run
from tracker.results import read_clip

POINT = {"action": "remove_point", "ball": 1, "frame": 4}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A clip and its results, beside a camera file and a folder that have nothing to do with them."""
    folder = tmp_path_factory.mktemp("opened")
    write_clip(folder / "clip", film(np.random.default_rng(0), collision(40, contact=18.4, speed=2.5)))
    run(folder / "clip", folder / "results", None, 1)
    (folder / "a_folder").mkdir()
    (folder / "other.json").write_text("{}")
    return folder


@pytest.fixture
def bench(folder, tmp_path):
    opened = OpenedResults(folder / "results")
    bench = Workbench(open_source(folder / "clip"), tmp_path / "bench", opened)
    yield bench
    bench.close()


def test_the_film_of_results_is_found_by_its_files(folder, tmp_path):
    opened = OpenedResults(folder / "results")
    assert find_film(opened).path.name == "clip"
    assert find_film(opened, folder / "clip").path.name == "clip"
    (tmp_path / "results_3").symlink_to(folder / "results")  # resolved, so that its neighbours are those of the target
    assert find_film(OpenedResults(tmp_path / "results_3")).path.name == "clip"
    moved = tmp_path / "moved"
    moved.mkdir()
    (moved / "results_7").symlink_to(folder / "results")
    alone = show_tracks_alone(opened)
    number, frames = alone.open_film(0)
    assert (number, len(frames), frames.shape[1:]) == (0, 40, (160, 200))
    write_clip(tmp_path / "clips/000005", film(np.random.default_rng(0), collision(8)))
    with pytest.raises(InputError, match="has no clip 0, which"):
        find_film(opened, tmp_path / "clips/000005")


def test_a_film_that_is_named_has_the_camera_file_of_the_results(folder, tmp_path):
    opened = OpenedResults(folder / "results")
    shutil.copy(folder / "clip/frames.tif", tmp_path / "elsewhere.tif")
    (tmp_path / "own.json").write_text(json.dumps(CAMERA | {"fps": 100}))
    found = find_film(opened, tmp_path / "elsewhere.tif").open_clip(0).camera
    assert (found.scale, found.fps) == (CAMERA["scale"], CAMERA["fps"])
    assert find_film(opened, tmp_path / "elsewhere.tif", tmp_path / "own.json").open_clip(0).camera.fps == 100


def test_each_neighbour_is_read_once_whatever_the_number_of_camera_files(tmp_path, monkeypatch):
    pictures = film(np.random.default_rng(0), collision(4))
    for name in ("a", "b"):
        tifffile.imwrite(tmp_path / f"{name}.tif", pictures[: 3 if name == "a" else 4], imagej=True)
    for k in range(5):
        (tmp_path / f"{k}.json").write_text(json.dumps(CAMERA | {"fps": 100 + k}))
    results = tmp_path / "results"
    results.mkdir()
    mark = digest_films(open_source(tmp_path / "b.tif", tmp_path / "3.json"))
    (results / "run.json").write_text(json.dumps({"clips": 1, "input": mark}))
    asked = []
    monkeypatch.setattr(opened_results, "read_ends", lambda source: asked.append(source.path.name) or read_ends(source))
    found = find_film(OpenedResults(results))
    assert (found.path.name, found.camera.name, asked) == ("b.tif", "3.json", ["a.tif", "b.tif"])
    monkeypatch.setattr(opened_results, "MAX_SEARCH_S", -1.0)
    assert find_film(OpenedResults(results)) is None


def test_numbers_and_tracks_with_their_residuals(bench, folder):
    about = bench.describe()
    assert (about["results"], about["has_film"]) == (OPENED, True)
    assert about["opened"] == [{"clip": 0, "status": "ok"}]
    (found,) = bench.describe_results(OPENED)["collisions"]
    assert [row[0] for row in found["rows"]][:3] == ["v0", "b/2R", "r"]
    shown, (tracks, _) = bench.describe_tracks(), read_clip(folder / "results", 0)
    assert [len(track["x"]) for track in shown["tracks"]] == [int((tracks.particle == k).sum()) for k in (0, 1)]
    # the rms residual of a fit that holds is the error of the positions
    assert {value for track in shown["tracks"] for value in track["x_off"]} == {None}  # straight lines are no tied fit


def describe(folder, status, **values):
    """What the page says of a row of estimates with one status."""
    row = {"clip": 0} | make_empty_row(Camera.from_dict(CAMERA), status) | values
    pd.DataFrame([row]).to_parquet(folder / "estimates.parquet")
    return OpenedResults(folder).describe_collisions(0)["collisions"][0]


def test_a_ball_by_itself_has_its_speed_and_its_loss(tmp_path):
    cov = '{"rolling_loss": [[0.2, 0.03]]}'
    about = describe(tmp_path, "no_collision", v0=0.5, v0_std=0.01, decel=0.2, decel_std=0.03, drag=0.0, cov=cov)
    assert [row[:2] for row in about["rows"]] == [["v0", "50.0(10)"], ["Croll", "0"], ["Droll", "20.0(30)"]]
    assert about["why"] == "The rolling loss at that speed is 20.0(30) cm/s²"
    assert (about["title"], about["method"]) == ("Film", "one rolling ball")


def test_a_film_without_a_number_has_the_next_step(tmp_path):
    assert "mark the ball in each frame" in describe(tmp_path, "no_collision")["why"]
    assert "point at it by Ball" in describe(tmp_path, NOTHING_ROLLS)["why"]
    assert "remove the wrong tracks" in describe(tmp_path, NO_DIAMETER)["why"]
    other = describe(tmp_path, "too few frames after the contact", frame_last=9)
    assert (other["title"], other["why"]) == ("Collision 0", "")


def test_a_quantity_without_a_value_has_no_row(tmp_path):
    local = {f"{name}_local{end}": 0.5 for name in ("v0", "r") for end in ("", "_std")}
    rejected = describe(tmp_path, "misfit", recommended="local", mu_k_free=0.2, mu_k_free_std=0.01, **local)
    assert [row[0] for row in rejected["rows"]] == ["v0", "r"]


def test_residuals_are_positions_minus_the_tied_fit(tmp_path):
    clip = Scene.read("painter_behringer").draw(seed=1)
    table, noise = clip.tracks[["frame", "particle"]], np.random.default_rng(0).normal(0, 0.05, (2, len(clip.tracks)))
    table = table.assign(x=clip.tracks.x_mean_px + noise[0], y=clip.tracks.y_mean_px + noise[1], x_std=0.05, y_std=0.05)
    table.to_csv(tmp_path / "tracks.csv", index=False)
    (tmp_path / "camera.json").write_text(json.dumps(clip.camera_json))
    measure_tables(tmp_path / "tracks.csv", tmp_path / "out", tmp_path / "camera.json")
    for track in OpenedResults(tmp_path / "out").list_tracks(clip.number, TrackEdits()):
        one = {key: np.array(values, dtype=float) for key, values in track.items() if key not in ("flags", "particle")}
        true = noise[:, clip.tracks.particle == track["particle"]]
        for axis, name in enumerate("xy"):  # the fit is known better than a position: its residual is nearly the noise
            assert np.std(one[f"{name}_off"] - true[axis]) < 0.3 * 0.05
        assert np.allclose(one["x_off_um"], one["x_off"] * clip.camera_json["scale"] * 1e6, rtol=1e-3, atol=0.02)


def test_edits_are_saved_at_once_shown_and_undone(bench):
    before = bench.describe_tracks()
    after = bench.mend({"edit": POINT})
    assert [4 in about["tracks"][1]["frame"] for about in (before, after)] == [True, False]
    assert after["pending"] == 1
    assert f"--edits {bench.folder}/edits_1.yaml" in after["plan"]["command"]
    assert yaml.safe_load((bench.folder / "edits.yaml").read_text()) == {"edits": [POINT]}
    again = Workbench(bench.source, bench.folder, bench.results[OPENED])  # the page is started again
    assert again.describe_tracks()["edits"] == [POINT]
    again.close()
    assert bench.mend({"step": "undo"})["tracks"] == before["tracks"]
    assert "--edits" not in bench.describe_plan()["command"]
    assert bench.mend({"step": "redo"})["edits"] == [POINT]
    for wrong, said in (
        ({"step": "redo"}, "nothing to do again"),
        ({"edit": POINT}, "ball 1 has no position in frame 4"),
        ({"edit": {"action": "remove"}}, "edits"),
        ({}, "edits"),
        ({"step": "back"}, "step"),
        (7, "edits"),
    ):
        with pytest.raises(InputError, match=said):
            bench.mend(wrong)
    assert bench.mending.edits == [POINT]
    (bench.folder / "edits.yaml").write_text("edits: []\n")
    with pytest.raises(InputError, match="changed by another program"):
        bench.mend({"step": "undo"})


def test_a_run_has_its_own_copy_of_the_edits_and_becomes_their_base(bench, folder, monkeypatch):
    started = []
    monkeypatch.setattr(bench.process, "start", lambda number, words: started.append(words))
    bench.mend({"edit": POINT})
    bench.start_run()
    (words,) = started
    copy = words[words.index("--edits") + 1]
    assert copy.endswith("edits_1.yaml")
    run(folder / "clip", bench.folder / "results_1", None, 1, edits=copy)  # what the command does
    shown = bench.describe_tracks()
    assert (shown["pending"], 4 in shown["tracks"][1]["frame"]) == (0, False)
    assert bench.describe()["results"] == 1
    assert bench.mend({"step": "undo"})["pending"] == 0  # the results without edits are shown again
    assert 4 in bench.describe_tracks()["tracks"][1]["frame"]


def test_tracks_without_their_film_are_measured_again(folder, tmp_path, monkeypatch):
    opened, started = OpenedResults(folder / "results"), []
    bench = Workbench(show_tracks_alone(opened), tmp_path / "bench", opened)
    assert isinstance(bench.source, TracksAlone)
    assert "not here" in bench.describe_status()["detector"]["error"]
    monkeypatch.setattr(bench.process, "start", lambda number, words: started.append(words))
    bench.mend({"edit": POINT})
    bench.start_run()
    own = folder / "results/clips/000000"
    assert started[0][:5] == ["tracker", "measure", f"{own / 'tracks.parquet'}", "--camera", f"{own / 'camera.json'}"]
    with pytest.raises(InputError, match="is not here"):
        bench.start_calibration({"fps": 250, "ball_diameter": 2e-3})
    bench.close()


def test_a_set_and_a_search_are_started_and_their_pages_shown(bench, folder, monkeypatch):
    started = []
    monkeypatch.setattr(bench.process, "start", lambda number, words: started.append(words))
    bench.others = [folder / "other"]
    bench.start_combination()
    results = f"{folder / 'results'}"
    assert started[0] == ["tracker", "combine", results, f"{folder / 'other'}", "-o", f"{bench.folder / 'set_1'}"]
    with pytest.raises(InputError, match="expected one folder of results, there are 2"):
        bench.start_search("")
    bench.others = []
    bench.start_search("")
    model = bench.folder / "model_2.yaml"
    assert yaml.safe_load(model.read_text()) == {"model": {}}
    assert started[1][:5] == ["discrepancy", "find", results, "--model", f"{model}"]
    for wrong in ("../model.yaml", "none.yaml", 7, "--help"):
        with pytest.raises(InputError, match="search: "):
            bench.start_search(wrong)
    assert bench.find_page_folder(2) == bench.folder / "search_2"


def test_tracks_of_too_many_frames_are_not_shown_without_their_film(folder, monkeypatch):
    monkeypatch.setattr(opened_results, "MAX_FRAMES_ALONE", 39)
    with pytest.raises(InputError, match="frame 39: expected one below 39, or the film"):
        show_tracks_alone(OpenedResults(folder / "results")).open_film(0)


def test_results_that_are_not_complete(folder, tmp_path):
    (tmp_path / "run.json").write_text(json.dumps({"input": "x"}))
    with pytest.raises(InputError, match="expected the estimates of a complete run"):
        OpenedResults(tmp_path).describe_clips()
    (tmp_path / "run.json").write_text("[]")
    with pytest.raises(InputError, match="damaged"):
        find_film(OpenedResults(tmp_path))
