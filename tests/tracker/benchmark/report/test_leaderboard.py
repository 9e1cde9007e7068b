"""The leaderboard: means over crowds, and entries of a suite without them."""

import pytest

from synthcam_shared.errors import InputError
from tracker.benchmark.report.leaderboard import make_leaderboard_row, read_entries, write_entry
from tracker.benchmark.report.page import make_benchmark_tables, make_crowd_tables
from tracker.benchmark.suite.definition import parse_definition

PARTS = {"bright": {"n": 9, "missed": 1, "false": 0, "ratio": 1.5, "hota": 0.8}}
NEW = {"truth_sha256": "new", "truth_sha256_without_crowds": "old"}


def entry(name, truth, **more):
    suite = {"version": "1", "split": "open", "truth_sha256": truth}
    about = {"tracker": {"name": name, "made": "submitted"}, "suite": suite, "score": 50.0}
    return about | {"parts": PARTS, "quantities": {}, "defects": {}} | more


def crowds(**values):
    return {"tray": values, "dense": {"hota": 0.5, "contacts_found": None, "temperature_error": None}}


def test_a_line_has_the_means_over_all_crowds():
    one = entry("one", "new", crowds=crowds(hota=0.9, contacts_found=0.8, temperature_error=0.1))
    line = make_leaderboard_row(1, one)
    found = [line[f"crowd_{name}"] for name in ("hota", "contacts_found", "temperature_error")]
    assert found[:2] == pytest.approx([0.7, 0.4])
    assert found[2] is None  # half of the crowds have no temperature
    assert line["hota"] == 0.8  # of two balls alone


def test_an_entry_made_before_there_were_crowds_stays_with_dashes(tmp_path):
    write_entry(tmp_path, entry("earlier", "old"))
    write_entry(tmp_path, entry("later", "new", crowds=crowds(hota=0.9)))
    entries = read_entries(tmp_path, NEW)
    assert [one["tracker"]["name"] for one in entries] == ["earlier", "later"]
    assert [make_leaderboard_row(1, one)["crowd_hota"] for one in entries] == [None, pytest.approx(0.7)]
    with pytest.raises(InputError, match="scores another suite"):
        read_entries(tmp_path, {"truth_sha256": "new"})
    tables = make_crowd_tables(entries, DEFINITION)
    assert [str(cell) for row in tables[0].rows for cell in row] == ["earlier", "–", "–", "later", "0.9", "0.5"]
    (first, *_) = make_benchmark_tables(entries, DEFINITION)
    assert first.heads == ["tracker", "bright"]  # no column of a crowd


DEFINITION = parse_definition(
    """
name: tiny
version: "1"
seed: 5
licence: CC0-1.0
films: {two: {clips: 1, scenes: {bright: {}}}, many: {clips: 1, scenes: {tray: {}, dense: {}}}}
axes: {}
headline: {bright: bright}
near: bright
phase: []
measured: []
physics: bright
trackers: []
sampled: {}
crowds: {axes: {}, parts: {tray: tray, dense: dense}}
""",
    "full",
    "tiny.yaml",
)
