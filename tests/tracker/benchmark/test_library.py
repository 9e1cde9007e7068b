"""The detector of ten lines in the docs runs as it stands; what comes back is what the files say."""

import re

import matplotlib as mpl
import numpy as np
import pytest
from benchmark_suite import simulated, suite
from repository import ROOT

import tracker
from synthcam_shared.errors import InputError
from tracker.benchmark import TrackerRun, library, run

mpl.use("Agg")


@pytest.fixture(autouse=True)
def known_bound(monkeypatch):
    """The clips at the bound are measured once."""
    monkeypatch.setattr(
        "tracker.benchmark.judging.entry.simulate_at_bound", lambda made, part, clip: simulated(part.name, clip)
    )


def test_the_ten_lines_of_the_docs_run_as_they_stand(monkeypatch, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/benchmark.md").read_text(), re.DOTALL)
    monkeypatch.setattr(library, "_suite", lambda given: suite())
    names = {}
    exec(compile(code, "docs/benchmark.md", "exec"), names)
    assert re.match(r"brightest: score \d+ of 100, median \S+ times the bound", capsys.readouterr().out)
    table = names["trial"].table
    assert list(table.index) == ["bright", "dim"]
    assert table.loc["bright", "found"] > 0.9
    assert 1 < table.loc["bright", "ratio"] < 10
    assert names["trial"].quantities.loc[("bright", "r"), "n"] >= 1
    assert len([line for line in code.partition("def ")[2].partition("\ntrial")[0].splitlines() if line.strip()]) <= 12
    mpl.pyplot.close("all")


@pytest.mark.usefixtures("unfitted", "not_local")
def test_a_detector_by_name_is_the_one_that_runs_from_files():
    trial = run("centroid", suite().path)
    own = run(tracker.detection.detect.load_detector("centroid"), suite().path, name="mine")
    assert own.table.equals(trial.table)
    assert trial.entry["tracker"]["name"] == "centroid"
    assert own.entry["tracker"]["name"] == "mine"
    axes = trial.plot()
    assert [text.get_text() for text in axes.get_yticklabels()] == ["bright", "dim"]
    assert "<table" in trial._repr_html_()
    mpl.pyplot.close("all")


def test_what_finds_centres_is_compared_with_centres_and_all_else_with_glints(monkeypatch):
    seen = []
    monkeypatch.setattr(library, "track_and_measure", lambda clip, used: None)
    monkeypatch.setattr(
        library, "make_entry", lambda made, tracked, about: seen.append((tracked.own, about["point"])) or {}
    )
    for detector, point in ((three, "either"), (three, "glint"), (three, "centre"), ("centroid", "centre")):
        run(detector, suite().path, point=point)
    assert seen == [("glint", "glint"), ("glint", "glint"), ("centre", "centre"), ("glint", "glint")]


def test_the_scores_of_crowds_are_a_table_without_those_that_were_not_run():
    table = TrackerRun({"crowds": {"dense": {"hota": 0.9, "ratio": None}, "fast": None}}, {}).crowds
    assert table.loc["dense"].to_dict() == pytest.approx({"hota": 0.9, "ratio": np.nan}, nan_ok=True)
    assert list(table.index) == ["dense"]
    assert TrackerRun({}, {}).crowds.empty


def test_what_is_no_list_of_places_is_said():
    with pytest.raises(InputError, match=r"three: returned an array \(2, 5\), expected positions \(n, 2\)"):
        run(three, suite().path)
    with pytest.raises(InputError, match="point: expected either, glint or centre"):
        run(three, suite().path, point="edge")


def three(frame):
    return np.zeros((2, 5))
