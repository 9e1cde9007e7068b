"""The judges of the table of ordinary inputs say "not right" where a right value is wrong on purpose."""

import json
import sys

import numpy as np
import pandas as pd
import pytest

from benchmarks.harness import ROOT
from benchmarks.tracker import ordinary_inputs
from benchmarks.tracker.ordinary import case as cases
from benchmarks.tracker.ordinary.case import Case, Outcome, Program, judge_case, run_to_the_end
from benchmarks.tracker.ordinary.contacts import Impact, NotOk
from benchmarks.tracker.ordinary.judges import Either, Found, Measured, Printed, Refused, Said, Scored, Unchanged
from benchmarks.tracker.ordinary.large import Within

ROW = {"status": "ok", "r": 0.901, "r_std": 0.001, "v0": 0.3, "v0_std": 1e-4, "r_paper": 0.7, "r_paper_std": np.nan}
PLACES = np.array([[[10.0, 10.0]] * 5, [[30.0, 10.0]] * 5])


def outcome(folder, status=0, out="", err="tracker: 6 frames are missing\n"):
    return Outcome(status=status, out=out, err=err, folder=folder, seconds=0.5)


@pytest.fixture
def measured(tmp_path):
    """Results as a command writes them."""
    clip = tmp_path / "new/clips/000000"
    clip.mkdir(parents=True)
    pd.DataFrame([ROW]).to_parquet(tmp_path / "new/estimates.parquet")
    rows = [(k, x + 0.1, 10.0) for k in range(5) for x in (10.0, 30.0)] + [(2, 90.0, 90.0)]
    pd.DataFrame(rows, columns=["frame", "x", "y"]).to_parquet(clip / "tracks.parquet")
    score = {"localisation": {"missed": 0}, "tracking": {"hota": 1.0}}
    (tmp_path / "new/score.json").write_text(json.dumps({"detectors": {"found": score}}))
    return tmp_path


@pytest.mark.parametrize(
    ("judge", "right"),
    [
        (Measured({"r": 0.9, "v0": 0.3}), True),
        (Measured({"r": 0.905}), False),
        (Measured({"r": 0.9045}, off=1e-3), True),
        (Measured({"r": 0.9}, status=("misfit",)), False),
        (Measured({"r": 0.9}, says=("6 Frames",)), True),
        (Measured({"r": 0.9}, says=("7 frames",)), False),
        (Measured({"r_paper": 0.9}), False),  # a value without an error is no result
        (Measured({}, or_no_error={"r_paper": 0.9}), True),
        (Measured({}, or_no_error={"r": 0.905}), False),
        (Measured({"mu_k": 0.2}), False),
        (Either(Measured({"r": 0.8}), Measured({"r": 0.9})), True),
        (Either(Measured({"r": 0.8}), Measured({"r": 0.7})), False),
        (NotOk(("missing",)), False),
        (Within(Said(()), 1.0), True),
        (Within(Said(()), 0.1), False),
        (Within(Said(("7 frames",)), 1.0), False),
        (Found(PLACES, false=1), True),
        (Found(PLACES), False),
        (Found(PLACES + 2.0, false=99), False),
        (Found(PLACES + 2.0, false=99, near_px=3.0), True),
        (Scored({"hota": 1.0, "missed": 0}), True),
        (Scored({"hota": 1.0, "missed": 1}), False),
        (Said(("missing",)), True),
        (Said(("missing",), files=("new/*.png",)), False),
        (Said(("missing",), status=1), False),
    ],
)
def test_values_are_compared_with_what_is_right(judge, right, measured):
    verdict = judge(outcome(measured))
    assert verdict.right is right
    assert verdict.got
    assert judge.right


@pytest.mark.parametrize(("says", "right"), [(("missing",), True), (("impossible",), False)])
def test_a_misfit_that_is_explained_is_not_ok(says, right, measured):
    pd.DataFrame([ROW | {"status": "misfit"}]).to_parquet(measured / "new/estimates.parquet")
    assert NotOk(says)(outcome(measured)).right is right
    assert not NotOk(says)(outcome(measured, status=1)).right


def test_a_drawn_impact_keeps_momentum_and_ends_as_rolling_balls_do():
    """Velocities long after the hit by conservation at the contact with the plate: (5 v + 2 R w x z) / 7 stays."""
    r, c = 0.85, 0.35
    n, v = np.array([np.sqrt(0.91), 0.3]), np.array([3.0, 0.0])
    struck, striker = np.diff(Impact(r, mu=0.2, C=c).positions(np.array([-2.0, -1.0, 200.0, 201.0])), axis=1)[:, [0, 2]]
    np.testing.assert_allclose(struck[0], 0, atol=1e-12)
    np.testing.assert_allclose(striker[0], v, atol=1e-12)
    normal = (v @ n) * n
    kick = (1 + r) / 2 * normal + 0.4 * c * (v - normal)
    np.testing.assert_allclose(struck[1], (5 * kick - 2 * c * normal) / 7, atol=1e-9)
    np.testing.assert_allclose(striker[1], (5 * (v - kick) + 2 * (v - c * normal)) / 7, atol=1e-9)
    apart = np.diff(Impact(r).positions(np.array([5.0, 6.0])), axis=1)[:, 0]
    np.testing.assert_allclose((apart[0] - apart[1]) @ n, r * (v @ n), rtol=1e-12)


@pytest.mark.parametrize(
    ("status", "err", "written", "right"),
    [
        (2, "tracker: t.csv: no\n", False, True),
        (1, "tracker: t.csv: no\n", False, False),
        (None, "tracker: t.csv: no\n", False, False),
        (2, "tracker: x.csv: no\n", False, False),
        (2, "Traceback\ntracker: t.csv: no\n", False, False),
        (2, "", False, False),
        (2, "tracker: t.csv: no\n", True, False),
    ],
)
def test_a_refusal_is_one_line_with_status_2_and_leaves_nothing(status, err, written, right, tmp_path):
    if written:
        (tmp_path / "new").mkdir()
    assert Refused(("t.csv",))(outcome(tmp_path, status, err=err)).right is right


def test_a_file_that_is_overwritten_is_not_right(tmp_path):
    (tmp_path / "mine").write_bytes(b"mine")
    given = outcome(tmp_path, 2, err="one line\n")
    assert Unchanged(("one",), {"mine": b"mine"})(given).right
    verdict = Unchanged(("one",), {"mine": b"yours"})(given)
    assert (verdict.right, "mine is overwritten" in verdict.got) == (False, True)


@pytest.mark.parametrize(
    ("out", "right"), [('{"a": 3, "b": "Text"}', True), ('{"a": 3.2, "b": "text"}', False), ("", False)]
)
def test_printed_values_are_compared(out, right, tmp_path):
    assert Printed({"a": 3.0, "b": "tex"}, near=0.1)(outcome(tmp_path, out=out)).right is right


def make(folder):
    return ["python", "-c", "print('{\"a\": 1}')"]


def fail(folder):
    raise ValueError("no such film")


def need(folder):
    raise ImportError("No module named 'tables'")


CASES = {
    "right": Case("topic", "fine", make, Printed({"a": 1})),
    "wrong value": Case("topic", "wrong value", make, Printed({"a": 2})),
    "fault": Case("topic", "fault", fail, Printed({})),
    "package": Case("topic", "package", need, Printed({}), needs="tables"),
    "other package": Case("topic", "other package", need, Printed({}), needs="openpyxl"),
}


@pytest.mark.parametrize(
    ("name", "verdict", "got"),
    [
        ("right", "right", "a 1"),
        ("wrong value", "NOT RIGHT", "a 1"),
        ("fault", "NOT RIGHT", "the case failed: ValueError: no such film"),
        ("package", "not made", "needs tables"),
        ("other package", "NOT RIGHT", "the case failed"),
    ],
)
def test_each_case_is_a_row_whatever_happens(name, verdict, got, tmp_path):
    row = judge_case(CASES[name], Program(ROOT), tmp_path)
    assert row.verdict == verdict
    assert row.got.startswith(got)


@pytest.mark.parametrize(("names", "status"), [(("right", "package"), 0), (("right", "wrong value", "fault"), 1)])
def test_the_table_ends_with_counts_and_status_1_if_any_is_not_right(names, status, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(ordinary_inputs, "TOPICS", (lambda: [CASES[name] for name in names],))
    monkeypatch.setattr(sys, "argv", ["ordinary_inputs", "-o", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as ended:
        ordinary_inputs.main()
    assert ended.value.code == status
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith(f"{len(names)} cases: 1 right, {2 * status} NOT RIGHT, {1 - status} not made;")
    table = pd.read_csv(tmp_path / "out/results.csv")
    assert table["kind"].tolist() == [CASES[name].kind for name in names]
    assert last in (tmp_path / "out/results.md").read_text()


def test_a_command_without_an_end_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(cases, "LIMIT_S", 0.3)
    ended = run_to_the_end(Program(ROOT), tmp_path, ["python", "-c", "while True: pass"])
    assert ended.status is None
    assert not Said(())(ended).right


def test_the_commands_are_those_of_the_program(tmp_path):
    """Another checkout's sources are imported before those of the environment."""
    (tmp_path / "src").mkdir()
    (tmp_path / "src/tracker.py").write_text('print(\'{"a": "older"}\')\n')
    ended = run_to_the_end(Program(tmp_path), tmp_path, ["tracker", "--version"])
    assert Printed({"a": "older"})(ended).right
