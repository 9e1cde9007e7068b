"""Trackers run on a suite: scored, on one page, on a leaderboard; what is done is kept, and the truth is not seen."""

import csv
import json
import shutil
import sys
from dataclasses import replace

import pytest
from benchmark_suite import simulated, suite

from synthcam_shared.errors import InputError
from tracker.benchmark import contest as module
from tracker.benchmark.contest import run_contest
from tracker.benchmark.report.leaderboard import make_leaderboard_row
from tracker.benchmark.trackers import Entrant, make_entrants, run_tracker


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("contest") / "report"
    with pytest.MonkeyPatch.context() as patch:
        simulate = "tracker.benchmark.judging.entry.simulate_at_bound"
        patch.setattr(simulate, lambda made, part, clip: simulated(part.name, clip))
        entries, notes = run_contest(suite(), folder, how="tracker benchmark run -o report")
    assert notes == []
    return folder, entries


@pytest.mark.gate
def test_the_likelihood_is_ahead_of_the_centroid_and_at_the_bound(report):
    _, entries = report
    assert [one["tracker"]["name"] for one in entries] == ["synthcam", "centroid"]
    best = entries[0]
    assert best["score"] > 85
    for part in ("bright", "dim"):
        assert best["parts"][part]["ratio"] == pytest.approx(1.0, abs=0.25)
        assert best["parts"][part]["found"] == 1.0
    assert best["quantities"]["bright"]["measured"] == 2
    assert best["tracker"]["ms_per_frame"] > 0
    assert abs(best["defects"]["size"]["glint"]) < 0.02  # it takes glints to centres itself
    assert entries[1]["defects"]["size"]["glint"] == pytest.approx(1.0, abs=0.05)


def test_leaderboard_and_page(report):
    folder, entries = report
    found = list(csv.DictReader((folder / "leaderboard.csv").read_text().splitlines()))
    assert list(found[0]) == list(make_leaderboard_row(1, entries[0]))
    assert [(line["rank"], line["name"]) for line in found] == [("1", "synthcam"), ("2", "centroid")]
    assert found[0]["truth"] == "open to the tracker's authors"
    page = (folder / "index.html").read_text()
    for word in (
        "synthcam",
        "centroid",
        "Leaderboard",
        "CC0-1.0",
        entries[0]["suite"]["truth_sha256"],
        "HOTA",
        "run -o report",
    ):
        assert word in page
    assert page.count("data:image/svg+xml") == 5
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "https://" not in page


@pytest.mark.usefixtures("undrawn")
def test_the_same_call_does_nothing_twice(report, monkeypatch):
    folder, entries = report
    monkeypatch.setattr(module, "make_entry", lambda *words: pytest.fail("scored again"))
    monkeypatch.setattr("tracker.pipeline._track_clip", lambda *words: pytest.fail("tracked again"))
    assert run_contest(suite(), folder)[0] == entries


def test_a_tracker_needs_no_truth(report, tmp_path):
    blind = replace(suite(), path=tmp_path / "films_only", truth=tmp_path / "none")
    shutil.copytree(suite().path / "films", blind.path / "films")
    run_tracker(blind, Entrant("centroid"), tmp_path / "out", 1)
    for path in (tmp_path / "out").rglob("tracks.parquet"):
        assert (
            path.read_bytes() == (report[0] / "results" / "centroid" / path.relative_to(tmp_path / "out")).read_bytes()
        )


def test_an_unknown_tracker_and_another_suites_report(report, tmp_path):
    with pytest.raises(InputError, match=r"no detector 'centriod'.*did you mean"):
        make_entrants(suite(), "centriod")
    other = replace(suite(), about={**suite().about, "truth_sha256": "0"})
    copy = shutil.copytree(report[0], tmp_path / "copy")
    with pytest.raises(InputError, match="scores another suite"):
        module.write_contest_report(other, copy, "")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("")
    with pytest.raises(InputError, match="holds something else"):
        run_contest(suite(), tmp_path / "full", "centroid")


def test_a_peer_that_is_not_installed_is_left_out_and_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "trackpy", None)
    made = suite()
    data = {**made.definition.data, "trackers": ["synthcam", "trackpy_locate"]}
    found, notes = make_entrants(replace(made, definition=replace(made.definition, data=data)))
    assert [one.name for one in found] == ["synthcam"]
    assert "trackpy_locate: left out" in notes[0]
    assert json.dumps(notes).count("pip install synthcam[peers]") == 1
