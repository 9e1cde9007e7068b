"""Residuals that a search has written, as the page draws them: in pixels, at the positions of the tracks."""

import json

import numpy as np
import pandas as pd
import pytest

pytest.importorskip("starlette", reason="the extra app is not installed")

from synthcam import Scene
from synthcam_shared.errors import InputError
from tracker.app.opened_results import OpenedResults, SearchedResiduals, show_tracks_alone
from tracker.app.workbench import OPENED, Workbench
from tracker.pipeline import measure_tables
from tracker.results import read_clip

BASE_M, BEST_M = (3e-6, -2e-6), (1e-6, 0.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Results of one clip, and the report of a search of them that knows one ball, and no position of frame 7."""
    folder = tmp_path_factory.mktemp("searched")
    clip = Scene.read("painter_behringer").draw(seed=1)
    tracks = clip.tracks[["frame", "particle"]].assign(x=clip.tracks.x_mean_px, y=clip.tracks.y_mean_px)
    tracks.assign(x_std=0.05, y_std=0.05).to_csv(folder / "tracks.csv", index=False)
    (folder / "camera.json").write_text(json.dumps(clip.camera_json))
    measure_tables(folder / "tracks.csv", folder / "out", folder / "camera.json")
    found, camera = read_clip(folder / "out", 0)
    rows = pd.DataFrame({"clip": 0, "ball": 1, "frame": found.frame, "held_out": True})
    rows[["x", "y"]] = camera.unproject(found.xy)[0]
    rows[["x_base", "y_base"]], rows[["x_best", "y_best"]] = BASE_M, BEST_M
    rows = rows[(found.particle == 1) & (found.frame != 7)].sample(frac=1, random_state=1)
    report = folder / "search"
    report.mkdir()
    pd.concat([rows, rows.assign(clip=5, held_out=False)]).to_parquet(report / "residuals.parquet")
    (report / "discrepancy.json").write_text(json.dumps({"models": ["base model", "with plate_tilt"]}))
    return folder


def test_metres_become_pixels_at_the_tracks_of_the_same_ball(folder):
    about = SearchedResiduals(folder / "search", OpenedResults(folder / "out")).describe(0)
    assert about["held_out"]
    scale = json.loads((folder / "camera.json").read_text())["scale"]
    for model, name, metres in zip(about["models"], ("base model", "with plate_tilt"), (BASE_M, BEST_M), strict=True):
        assert model["name"] == name
        assert model["rms_um"] == pytest.approx(1e6 * np.sqrt(np.mean(np.square(metres))), rel=0.01)
        other, own = model["tracks"]
        assert (other["particle"], set(other["x_off"])) == (0, {None})
        for frame, *off in zip(own["frame"], own["x_off"], own["y_off"], strict=True):
            if frame == 7:
                assert off == [None, None]
            else:  # y is up in metres and down in pixels
                assert off == pytest.approx([metres[0] / scale, -metres[1] / scale], rel=0.02, abs=2e-4)


def test_without_a_claim_there_is_one_model(folder, tmp_path):
    for file in (folder / "search").iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "discrepancy.json").write_text('{"models": ["base model"]}')
    (model,) = SearchedResiduals(tmp_path, OpenedResults(folder / "out")).describe(0)["models"]
    assert model["name"] == "base model"


def test_a_table_that_is_damaged_or_not_there(folder, tmp_path):
    search = SearchedResiduals(tmp_path, OpenedResults(folder / "out"))
    assert not search.is_there
    (tmp_path / "residuals.parquet").write_text("none")
    with pytest.raises(InputError, match=r"residuals\.parquet: expected the residuals of a search"):
        search.describe(0)


def test_the_page_gets_the_residuals_of_the_clip_in_view(folder, tmp_path):
    opened = OpenedResults(folder / "out")
    bench = Workbench(show_tracks_alone(opened), tmp_path / "bench", opened)
    try:
        bench.searches[3] = SearchedResiduals(folder / "search", bench.results[OPENED])
        assert bench.describe()["search"] == 3
        assert len(bench.describe_search(3)["models"]) == 2
        with pytest.raises(InputError, match="search 4: not one of this page"):
            bench.describe_search(4)
        bench.searches[4] = SearchedResiduals(tmp_path, bench.results[OPENED])  # a search that failed
        assert bench.describe()["search"] == 3
    finally:
        bench.close()


def test_a_clip_that_the_search_left_out_has_no_model(folder, tmp_path):
    table = pd.read_parquet(folder / "search/residuals.parquet")
    table[table["clip"] == 5].to_parquet(tmp_path / "residuals.parquet")
    about = SearchedResiduals(tmp_path, OpenedResults(folder / "out")).describe(0)
    assert about == {"clip": 0, "models": [], "held_out": False}


def test_frames_that_the_tracks_do_not_have_leave_no_residuals(folder, tmp_path):
    table = pd.read_parquet(folder / "search/residuals.parquet")
    table.assign(frame=table["frame"] + 100_000).to_parquet(tmp_path / "residuals.parquet")
    (tmp_path / "discrepancy.json").write_text('{"models": ["base model"]}')
    about = SearchedResiduals(tmp_path, OpenedResults(folder / "out")).describe(0)
    assert json.loads(json.dumps(about, allow_nan=False))["models"][0]["rms_um"] is None
