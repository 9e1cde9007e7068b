"""Plans from Python and by the command: tables, reports, and bad input in one line."""

import html
import json
import re
import sys

import numpy as np
import pytest
from discrepancy_clips import EFFECTS
from discrepancy_plans import few, scene

import discrepancy
from discrepancy import cli
from discrepancy.planning.changes import CHANGES
from discrepancy.planning.limits import count_draws
from synthcam.scene.scene import Scene

FILE = "launch: {v0: {uniform: [0.1, 0.6]}, b: {uniform: [-0.6, 0.6]}, heading: {uniform: [0, 6.2832]}}\n"
FILE += "timing: {frames: 60, contact_frame: 20}\n"
FLAGS = ["--clips", "6", "--effects", "rolling_quadratic", "--limit", "rolling_quadratic=0.5"]


@pytest.fixture(scope="module")
def planned():
    with pytest.MonkeyPatch.context() as patch:
        few(patch)
        return discrepancy.plan(scene(), clips=8, limits={"rolling_quadratic.K": 0.01})


def command(*words):
    """Exit status, in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["discrepancy", "plan", *map(str, words)])
        with pytest.raises(SystemExit) as left:
            cli.main()
    return left.value.code


def test_a_row_for_each_strength_the_clearest_first(planned):
    table = planned.table
    assert set(table["effect"]) == set(EFFECTS)
    assert (np.diff(table["limit"] / table["typical"]) > 0).all()
    assert (table["naming_limit"] >= table["limit"]).all()
    assert (table["naming_then"].dropna() < table["naming_limit"][table["naming_then"].notna()]).all()


@pytest.mark.gate
def test_what_a_change_does_to_a_large_experiment_is_scaled_from_some_of_it(planned, monkeypatch):
    """Changes are tried on 24 collisions at most, here of 30 fitted, and must gain as they do of six."""
    few(monkeypatch)
    table = discrepancy.plan(scene(), clips=40).table
    assert (table["naming_then"] < table["naming_limit"]).all()
    ratio, before = (t["naming_then"] / t["naming_limit"] for t in (table, planned.table))
    assert ratio.to_numpy() == pytest.approx(before.to_numpy(), rel=0.4)


def test_every_change_is_ranked(planned):
    possible = {c.name for c in CHANGES} - {"tilted"}  # which that library does not know
    assert set(planned.changes["name"]) == possible | {"together"}
    assert planned.changes["naming"].is_monotonic_decreasing
    assert planned.changes.set_index("name")["limit"]["more"] == pytest.approx(np.sqrt(2), rel=0.02)


def test_the_number_of_collisions_brings_the_limit_down_to_what_is_wanted(planned, monkeypatch):
    few(monkeypatch, count_draws)
    (wanted,) = planned.wanted
    there = discrepancy.plan(scene(), ["rolling_quadratic"], wanted.clips, changes=False).table
    assert there["limit"][0] == pytest.approx(0.01, rel=0.05)


def test_both_numbers_of_collisions_are_given(planned):
    (wanted,) = planned.wanted
    sentence = wanted.sentence()
    assert f" {wanted.clips} collisions detect it" in sentence
    assert f" {wanted.clips_to_name} distinguish it" in sentence


def test_the_sentence_and_the_repr_are_short(planned):
    assert repr(planned) == planned.sentence()
    assert planned.sentence().startswith("8 collisions of oblique, positions to 0.0088 px (1.4 um): 2 of 2 effects")
    assert "<table" in planned._repr_html_()


def test_a_report_holds_two_files_and_needs_no_network(planned, tmp_path):
    page = planned.report(tmp_path / "plan").read_text()
    assert sorted(p.name for p in (tmp_path / "plan").iterdir()) == ["index.html", "plan.json"]
    assert json.loads((tmp_path / "plan/plan.json").read_text()) == json.loads(json.dumps(planned.document()))
    assert re.findall(r'(?:src|href)\s*=\s*["\'](?!data:)', page) == []
    assert page.count("data:image/svg+xml;base64,") == 2
    text = html.unescape(page)
    assert planned.sentence() in text
    for words in planned.changes["words"]:
        assert words in text


@pytest.mark.usefixtures("undrawn")
def test_a_report_replaces_a_plan_and_nothing_else(planned, tmp_path):
    planned.report(tmp_path / "plan")
    planned.report(tmp_path / "plan")
    (tmp_path / "plan/notes.txt").write_text("mine")
    with pytest.raises(discrepancy.InputError, match="holds something else; expected an earlier plan"):
        planned.report(tmp_path / "plan")
    assert (tmp_path / "plan/notes.txt").read_text() == "mine"


@pytest.mark.usefixtures("undrawn")
def test_the_command_writes_what_python_gives(tmp_path, monkeypatch, capsys):
    few(monkeypatch, lambda _: 1)
    path = tmp_path / "mine.yaml"
    path.write_text(FILE)
    assert command(path, *FLAGS, "-o", tmp_path / "plan", "--json") == 0
    said = json.loads(capsys.readouterr().out)
    written = json.loads((tmp_path / "plan/plan.json").read_text())
    same = discrepancy.plan(path, ["rolling_quadratic"], 6, limits={"rolling_quadratic": 0.5}, changes=False).document()
    assert written["wanted"] == json.loads(json.dumps(same["wanted"]))
    assert written["effects"][0]["limit"] == same["effects"][0]["limit"]
    assert {k: v for k, v in said.items() if k != "seconds"} == written
    assert [row["strength"] for row in written["effects"]] == ["rolling_quadratic.K"]
    assert written["effects"][0]["rivals"][0]["effect"] == "velocity_restitution"  # asked for or not


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--effects", "plate_tlt"], "plate_tlt: no such effect; did you mean plate_tilt?"),
        (["--clips", "0"], "clips: expected 6 or more"),
        (["--noise", "0"], "noise: expected an error of positions over 0 px"),
        (["--limit", "hop"], "--limit hop: expected EFFECT=STRENGTH"),
        (["--limit", "hop.shar=1"], "limit hop.shar: no such strength; hop has hop.share"),
        (["--limit", "hop=-1"], "limit hop: expected a strength over 0"),
        (["--set", "launch.kind=single"], "launch.kind: expected pair, found single"),
        (["--set", "launch.kid=single"], "launch.kid: unknown key"),
        (["--set", "timing.contact_frame=300"], "in 0 of 30 clips"),
        (["--set", "free=[hop.share]", "--effects", "hop"], "hop: free in this scene"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(tmp_path, capsys, words, message):
    path = tmp_path / "mine.yaml"
    path.write_text(FILE)
    assert command(path, *words, "-o", tmp_path / "plan") == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["mine.yaml"]


def test_a_foreign_folder_stays(tmp_path, capsys):
    (tmp_path / "mine.yaml").write_text(FILE)
    assert command(tmp_path / "mine.yaml", "-o", tmp_path) == 2
    assert "the command reads" in capsys.readouterr().err
    assert (tmp_path / "mine.yaml").exists()


@pytest.mark.parametrize("effects", ["hop", []])
def test_effects_are_a_list(effects):
    with pytest.raises(
        discrepancy.InputError, match=r"effects: (of type str, expected Sequence|expected a list of names)"
    ):
        discrepancy.plan("oblique", effects)


def test_a_scene_by_its_name_is_its_file(monkeypatch):
    few(monkeypatch, lambda _: 1)
    given = "oblique", Scene.read("scenes/oblique.yaml")
    one, two = (discrepancy.plan(s, ["rolling_quadratic"], 6, 0.05, changes=False) for s in given)
    assert one.document() == two.document()


def test_without_changes_limits_are_the_same(planned, monkeypatch):
    few(monkeypatch)
    quick = discrepancy.plan(scene(), clips=8, changes=False)
    assert quick.table[["strength", "limit", "naming_limit"]].equals(
        planned.table[["strength", "limit", "naming_limit"]]
    )
    assert quick.changes.empty
    assert not quick.table["best_change"].any()


def test_the_physics_may_be_a_model_file_and_effects_of_ones_own(tmp_path, monkeypatch, capsys):
    (tmp_path / "mine.yaml").write_text(FILE + "model: {restitution: {uniform: [0.8, 0.9]}}\n")
    (tmp_path / "model.yaml").write_text("model: {restitution: 0.7}\n")
    assert command(tmp_path / "mine.yaml", "-o", tmp_path / "plan") == 2
    assert "expected numbers, as by --model MODEL.yaml" in capsys.readouterr().err
    few(monkeypatch, lambda _: 1)
    (tmp_path / "effects").mkdir()
    words = [tmp_path / "mine.yaml", "--model", tmp_path / "model.yaml", "--clips", "6", "-o", tmp_path / "plan"]
    assert command(*words, "--effects", tmp_path / "effects") == 2
    assert "effects: holds no effect" in capsys.readouterr().err
    assert command(*words, "--effects", "velocity_restitution") == 0
    rows = json.loads((tmp_path / "plan/plan.json").read_text())["effects"]
    assert [row["effect"] for row in rows] == ["velocity_restitution"]
