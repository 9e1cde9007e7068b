"""The report stands alone, its figures carry axes with units, and it says what it lacks."""

import base64
import re
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from tracker_noisy import BENCHMARK, dataset, results, truth_of

from tracker.scoring import score_page
from tracker.scoring.score import score
from tracker.scoring.score_page import choose_example_clip, draw_score_figures, make_quantity_tables, write_report

FIGURE_NAMES = {"frame", "tracks", "separation", "energy", "tied", "free", "local", "paper", "honesty"}

CLIPS = 2


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    data = dataset(tmp_path_factory.mktemp("report") / "data", BENCHMARK, CLIPS, seed=6)
    return data, results(tmp_path_factory.mktemp("results"), data, CLIPS)


@pytest.fixture(scope="module")
def drawn(folders):
    data, found = folders
    verdict = score(found, data)
    clip = choose_example_clip(verdict)
    film(data, clip)
    return verdict, draw_score_figures(verdict, found, data)


def film(data, clip):
    """A stand-in for the video: dots where the balls are."""
    truth, camera = truth_of(data, clip)
    frames = np.full((100, camera.size[1], camera.size[0]), 8, np.uint8)
    for row in truth[truth["visible"]].itertuples():
        frames[row.frame, round(row.y_px), round(row.x_px)] = 200
    tifffile.imwrite(data / "clips" / f"{clip:06d}" / "frames.tif", frames)


def test_page_is_one_file_without_network(folders, drawn, tmp_path, monkeypatch):
    data, found = folders
    verdict, shown = drawn
    few = {name: figure for name, figure in shown.items() if name in ("frame", "separation", "tied")}
    monkeypatch.setattr(score_page, "draw_score_figures", lambda *_: few)
    page = write_report(verdict, found, data, tmp_path / "report")
    assert [p.name for p in page.parent.iterdir()] == ["index.html"]
    html = page.read_text(encoding="utf-8")
    assert not re.search(r"https?://|<script|<link|@import", html)
    sources = re.findall(r'src="([^"]*)"', html)
    assert len(sources) == len(few)
    for source in sources:
        kind, _, body = source.partition(",")
        assert kind == "data:image/svg+xml;base64"
        assert b"<svg" in base64.b64decode(body)
    assert "r_free" in html
    assert "energy_fraction_paper" in html


def test_figures_have_labelled_axes_with_units(drawn):
    _, shown = drawn
    assert set(shown) == set(score_page.FIGURES) == FIGURE_NAMES
    units = {"frame": "px", "tracks": "mm", "separation": "ms", "energy": "ms"}
    for name, unit in units.items():
        labels = [a.get_xlabel() for a in shown[name].axes]
        assert any(label.endswith(f"/ {unit}") for label in labels), name
    for name in ("tied", "free", "local", "paper"):
        assert all("error / " in a.get_title() for a in shown[name].axes if a.axison)
        assert "cm/s" in shown[name].get_supxlabel()
    assert shown["separation"].axes[0].get_legend() is not None


def test_a_quantity_that_no_clip_measures_has_no_panel(folders, drawn):
    data, found = folders
    verdict, shown = drawn
    table = verdict.table.copy()
    table[[name for name in table if name.endswith("_local")]] = np.nan
    table["s_std"] = np.nan
    fewer = draw_score_figures(replace(verdict, table=table), found, data)
    assert set(shown) - set(fewer) == {"local"}
    assert len(shown["tied"].axes) - len(fewer["tied"].axes) == 1
    assert all(axes.axison for figure in fewer.values() for axes in figure.axes)


def test_detections_are_drawn_where_they_were_found(folders, drawn):
    verdict, shown = drawn
    circles = [p.center for p in shown["frame"].axes[0].patches if hasattr(p, "center")]
    truth, camera = truth_of(folders[0], choose_example_clip(verdict))
    frame = int(re.search(r"frame (\d+)", shown["frame"].axes[0].get_title())[1])
    true = truth[truth["frame"] == frame][["x_mean_px", "y_mean_px"]].to_numpy()
    assert len(circles) == 2
    apart = np.linalg.norm(np.array(circles)[:, None] - true[None], axis=-1).min(axis=1)
    assert (apart < 0.1).all()
    assert frame / camera.fps > verdict.table.set_index("clip")["t_c"][choose_example_clip(verdict)]


def test_fitted_curve_goes_through_the_measured_separation(drawn):
    """The residual panel shows noise of the size of the detections', no trend."""
    _, shown = drawn
    panel = shown["separation"].axes[1]
    residual = panel.containers[0].lines[0].get_ydata()
    assert np.std(residual) == pytest.approx(0.015 * 160 * np.sqrt(2), rel=0.25)  # px in um, two balls
    assert abs(np.mean(residual)) < 4 * np.std(residual) / np.sqrt(len(residual))


def test_residual_panels_show_estimate_less_truth(drawn):
    verdict, shown = drawn
    panel = next(a for a in shown["tied"].axes if a.get_title().startswith("$r$"))
    points = panel.containers[0].lines[0].get_ydata()
    np.testing.assert_allclose(sorted(points), sorted((verdict.table["r"] - verdict.table["r_true"]) * 1e3))


def test_table_holds_the_scores(drawn):
    verdict, _ = drawn
    table = make_quantity_tables(verdict)[0]
    (row,) = [dict(zip(table.heads, cells, strict=True)) for cells in table.rows if cells[0] == "r"]
    ratio, error = re.fullmatch(r"([\d.]+)\((\d+)\)", row["rmse / bound"]).groups()
    true = verdict.quantities["r"]["ratio"]
    assert float(ratio) == pytest.approx(true, abs=0.06)
    assert int(error) * 10.0 ** -len(ratio.partition(".")[2]) == pytest.approx(true / np.sqrt(2 * CLIPS), rel=0.05)
    assert float(row["rmse"]) == pytest.approx(verdict.quantities["r"]["rmse"] * 1e3, rel=0.01)


@pytest.mark.usefixtures("undrawn", "not_local")
def test_without_video_or_collision_it_says_so(tmp_path):
    settings = {"launch": {"kind": "single", "v0": 0.3}}
    data = dataset(tmp_path / "data", settings, 1)
    found = results(tmp_path / "results", data, 1)
    verdict = score(found, data)
    assert verdict.statuses == {"n": 1, "no_collision": 1}
    html = write_report(verdict, found, data, tmp_path / "report").read_text(encoding="utf-8")
    assert "No clip shows a collision" in html
    pair = dataset(tmp_path / "pair", BENCHMARK, 1)
    seen = results(tmp_path / "seen", pair, 1)
    html = write_report(score(seen, pair), seen, pair, tmp_path / "other").read_text(encoding="utf-8")
    assert "the dataset holds no video" in html
