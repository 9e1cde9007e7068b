"""The commands: from files to a verdict, and one clear line for bad input."""

import functools
import io
import json
import re
import shutil
import sys
from types import SimpleNamespace

import pandas as pd
import pytest
from discrepancy_clips import only
from discrepancy_files import SCENE, TRUTH, command, record
from report_pages import undrawn
from repository import ROOT
from rich.console import Console

import synthcam.cli
from discrepancy import cli
from discrepancy.data import reading
from synthcam.library import library
from synthcam.model import read_model

MODEL = ROOT / SCENE
RIVAL = ("restitution_speed",)  # the free law that describes what is hidden; others would only take time
pytestmark = pytest.mark.usefixtures("undrawn")


@pytest.fixture(scope="module")
def recorded():
    return record()


@pytest.fixture(scope="module")
def report(recorded, tmp_path_factory):
    output = tmp_path_factory.mktemp("found") / "report"
    with pytest.MonkeyPatch.context() as patch, undrawn():
        only(patch, RIVAL)
        assert command("find", recorded / "results", "--model", MODEL, "-o", output) == 0
    return output


def document(report):
    return json.loads((report / "discrepancy.json").read_text())


def test_find_names_what_was_hidden(report):
    found = document(report)
    assert found["verdict"] == "named"
    assert [n["effect"] for n in found["named"]] == ["velocity_restitution"]
    named = found["named"][0]
    value, std = named["parameters"]["velocity_restitution.e"], named["std"]["velocity_restitution.e"]
    assert abs(value - TRUTH) < 3.5 * std
    assert found["gap"]["closure"] > 0.99


def test_the_found_model_lacks_nothing(recorded, report, tmp_path, capsys, monkeypatch):
    only(monkeypatch, RIVAL)
    words = (recorded / "results", "--model", report / "model.yaml", "-o", tmp_path / "again", "--json")
    assert command("find", *words) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["verdict"] == "none"
    assert said["named"] == []


def test_the_found_model_is_a_scene(report, tmp_path, monkeypatch):
    words = ["generate", str(report / "model.yaml"), "-o", str(tmp_path / "set"), "--no-video"]
    monkeypatch.setattr(sys, "argv", ["synthcam", *words])
    with pytest.raises(SystemExit) as left:
        synthcam.cli.main()
    assert left.value.code == 0
    assert (tmp_path / "set/clips/000000").is_dir()


def test_the_ten_lines_of_the_docs_run_as_they_stand(recorded, tmp_path, monkeypatch, capsys):
    only(monkeypatch, RIVAL)
    code, *_ = re.findall(r"```python\n(.*?)```", (ROOT / "docs/discrepancy.md").read_text(), re.DOTALL)
    assert len(code.strip().splitlines()) <= 10
    (tmp_path / "out").mkdir()
    (tmp_path / "out/results").symlink_to(recorded / "results")
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "docs/discrepancy.md", "exec"), {})
    said = capsys.readouterr().out
    assert "velocity_restitution" in said
    assert (tmp_path / "out/search_py/index.html").is_file()


def test_add_fits_a_candidate(recorded, tmp_path, capsys, monkeypatch):
    only(monkeypatch, RIVAL)
    table = (recorded / "tracks.csv", "--camera", recorded / "camera.json")
    words = ("add", "velocity_restitution", "--model", MODEL, "-o", tmp_path / "new.yaml", "--json", "--fit", *table)
    assert command(*words) == 0
    fitted = json.loads(capsys.readouterr().out)["parameters"]["e"]
    assert fitted == pytest.approx(TRUTH, rel=0.02)
    assert read_model(tmp_path / "new.yaml").value("velocity_restitution.e") == fitted


@pytest.mark.parametrize("name", ["find", "add"])
def test_a_misspelt_key_of_the_tables_camera_is_named_as_the_tracker_names_it(name, recorded, tmp_path, capsys):
    camera = json.loads((recorded / "camera.json").read_text()) | {"exposre": 5e-4, "operator": "me"}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    few = tmp_path / "few.csv"  # refused later: what is said of the camera comes first
    pd.read_csv(recorded / "tracks.csv").query("clip < 2").to_csv(few, index=False)
    words = ["--model", MODEL, "--camera", tmp_path / "camera.json", "-o", tmp_path / "out"]
    words += [few] if name == "find" else ["velocity_restitution", "--fit", few]
    assert command(name, *words) == 2
    assert capsys.readouterr().err.splitlines()[:2] == [
        "discrepancy: exposre: not a key of camera.json; did you mean exposure?",
        "discrepancy: operator: not a key of camera.json",
    ]


def test_add_tells_what_it_fitted(recorded, tmp_path, capsys, monkeypatch):
    only(monkeypatch, RIVAL)
    words = ("--model", MODEL, "-o", tmp_path / "new.yaml", "--fit", recorded / "results")
    assert command("add", "velocity_restitution", *words, "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert abs(said["parameters"]["e"] - TRUTH) < 3.5 * said["std"]["e"] < 0.1 * TRUTH
    assert said["sigma"] > 100
    assert said["chi2"]["before"] > 10 > said["chi2"]["after"]
    assert command("add", "velocity_restitution", *words) == 0
    told = capsys.readouterr().out
    strength = r"velocity_restitution \(.*\): the restitution falls with the speed, e \+0\.\d+ \+- 0\.\d+ \(\d+ sigma\)"
    assert re.search(rf"{strength}; chi\^2 per degree of freedom falls from \d\S* to \d", told)
    assert "(6 of 6)" in told


def test_add_of_what_cannot_be_told_is_one_line(recorded, tmp_path, capsys, monkeypatch):
    only(monkeypatch, clock_error=library()["clock_error"])
    words = ("add", "clock_error", "--model", MODEL, "--fit", recorded / "results", "-o", tmp_path / "new.yaml")
    assert command(*words) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def swapped(recorded, tmp, *clips):
    """The table and its first clip once more, balls exchanged in some clips: where that divides by zero if measured."""
    table = pd.read_csv(recorded / "tracks.csv")
    table = pd.concat([table, table[table["clip"] == 0].assign(clip=6)])
    late = table["clip"].isin(clips) & (table["frame"] >= 39)
    table.assign(particle=table["particle"].where(~late, 1 - table["particle"])).to_csv(tmp / "t.csv", index=False)
    return tmp / "t.csv", "--camera", recorded / "camera.json"


def leave_exchanges(monkeypatch):
    """Let no exchange of numbers be undone, so that such a clip is left out."""
    monkeypatch.setattr(
        reading, "repair_tracks", lambda tracks, camera, number: SimpleNamespace(tracks=tracks, notes=())
    )


def test_a_table_gives_what_results_give_and_tells_of_the_clips_left_out(
    recorded, report, tmp_path, capsys, monkeypatch
):
    """The table has one clip more than the results, which is left out; there is no truth beside it."""
    only(monkeypatch, RIVAL)
    leave_exchanges(monkeypatch)
    monkeypatch.setenv("SYNTHCAM_PROGRESS_S", "100000")  # no lines on how far it is
    table, why = swapped(recorded, tmp_path, 6), "clip 6: the two balls exchange their numbers at frame 39"
    assert command("find", *table, "--model", MODEL, "-o", tmp_path / "report") == 0
    out, err = capsys.readouterr()
    assert f"Left out: {why}\n" in out
    assert "(6 of 7 collisions, " in out
    assert "Most" not in out
    assert err == ""
    assert document(tmp_path / "report")["clips"]["left_out"] == [why]
    assert why in (tmp_path / "report/index.html").read_text()
    one, other = document(report), document(tmp_path / "report")
    assert one["verdict"] == other["verdict"]
    assert one["named"][0]["parameters"] == pytest.approx(other["named"][0]["parameters"], rel=1e-4)
    for gap in (one["gap"], other["gap"]):
        gap.pop("by_phase")
        gap.pop("by_claim")
    assert one["gap"] == pytest.approx(other["gap"], rel=1e-4)
    words = ("add", "velocity_restitution", "--model", MODEL, "-o", tmp_path / "a/new.yaml", "--fit", *table)
    assert command(*words) == 0
    assert f"(6 of 7)\nLeft out: {why}\n" in capsys.readouterr().out


def test_the_camera_is_doubted_when_most_collisions_are_left_out(recorded, tmp_path, capsys, monkeypatch):
    only(monkeypatch, RIVAL)
    leave_exchanges(monkeypatch)
    table = pd.read_csv(recorded / "tracks.csv")
    copies = [table.assign(clip=table["clip"] + 6 * k) for k in range(3)]
    copies[1:] = [c.assign(particle=c["particle"].where(c["frame"] < 39, 1 - c["particle"])) for c in copies[1:]]
    pd.concat(copies).to_csv(tmp_path / "t.csv", index=False)
    words = (tmp_path / "t.csv", "--camera", recorded / "camera.json", "--model", MODEL, "-o", tmp_path / "report")
    assert command("find", *words) == 0
    out = capsys.readouterr().out
    assert "Most collisions are left out. Check fps, scale and ball_diameter in the camera file.\n" in out
    assert "(6 of 18 collisions, " in out


def test_the_bar_goes_through_the_stages_and_back(monkeypatch):
    screen = io.StringIO()
    monkeypatch.setattr(cli, "Console", functools.partial(Console, file=screen, force_terminal=True, width=80))
    for told, shown in (
        (("noise", "fit", "free laws", "search", "free laws"), r"free laws .* 3/7 "),
        (("noise", "fit", "fit", "search", "fit"), r"fit, round 2 .* 1/7 "),
    ):
        screen.truncate(0)
        with cli.show_stages(("noise", "fit", "free laws", "search", "gap", "where", "report")) as progress:
            for stage in told:
                progress(stage)
        assert re.search(shown, re.sub(r"\x1b\[[0-9;?]*\w", "", screen.getvalue()))


def test_the_time_left_is_bounded_by_the_limit(monkeypatch, capsys):
    """80 s of 10 min are over; the fit before the search has no limit."""
    times = iter([0.0, 40.0, 80.0])
    monkeypatch.setattr(cli.time, "monotonic", lambda: next(times))
    with cli.show_stages(("fit", "search"), 600.0) as progress:
        progress("fit")
        progress("search")
    assert capsys.readouterr().err.splitlines() == ["fit after 40 s", "search after 80 s, at most 8.7 min left"]


def test_the_time_left_follows_from_the_level_before(monkeypatch, capsys):
    """A level of 50 s begins again. The environment asks for a line every 20 s."""
    monkeypatch.setenv("SYNTHCAM_PROGRESS_S", "20")
    times = iter([0.0, 1.0, 21.0, 51.0, 60.0, 75.0])
    monkeypatch.setattr(cli.time, "monotonic", lambda: next(times))
    with cli.show_stages(("fit", "free laws", "search"), 600.0) as progress:
        for stage in ("search", "free laws", "search", "search", "free laws"):
            progress(stage)
    assert capsys.readouterr().err.splitlines() == [
        "free laws after 21 s, about 55 s, at most 9.7 min left",
        "search after 51 s, about 75 s, at most 9.2 min left",
        "free laws after 75 s, about 57 s, at most 8.8 min left",
    ]


def test_an_earlier_report_is_replaced_and_nothing_else(recorded, report, tmp_path):
    old = shutil.copytree(report, tmp_path / "report")
    (old / "notes.txt").write_text("mine")
    assert command("find", recorded / "results", "--model", MODEL, "-o", old) == 2
    assert (old / "notes.txt").read_text() == "mine"


def no_folder(recorded, tmp):
    return tmp / "nowhere", (), "no such file or folder"


def no_estimates(recorded, tmp):
    (tmp / "empty").mkdir()
    return tmp / "empty", (), "no estimates.parquet"


def damaged(recorded, tmp):
    results = shutil.copytree(recorded / "results", tmp / "results")
    (results / "estimates.parquet").write_bytes(b"PAR1 no more")
    return results, (), "cannot be read as Parquet"


def a_column_short(recorded, tmp):
    results = shutil.copytree(recorded / "results", tmp / "results")
    table = pd.read_parquet(results / "estimates.parquet").drop(columns="t_c")
    table.to_parquet(results / "estimates.parquet")
    return results, (), "no column t_c"


def a_clip_short(recorded, tmp):
    results = shutil.copytree(recorded / "results", tmp / "results")
    shutil.rmtree(results / "clips" / "000002")
    return results, (), "tracks.parquet"


def few(recorded, tmp):
    pd.read_csv(recorded / "tracks.csv").query("clip < 2").to_csv(tmp / "t.csv", index=False)
    return tmp / "t.csv", ("--camera", recorded / "camera.json"), "2 measured collisions: expected 6"


def none_at_all(recorded, tmp):
    alone = pd.read_csv(recorded / "tracks.csv").query("clip < 2 and particle == 1 and frame < 15")
    alone.to_csv(tmp / "t.csv", index=False)
    return tmp / "t.csv", ("--camera", recorded / "camera.json"), "no_collision"


def nothing_finite(recorded, tmp):
    pd.read_csv(recorded / "tracks.csv").query("clip < 2").assign(x=float("nan")).to_csv(tmp / "t.csv", index=False)
    return tmp / "t.csv", ("--camera", recorded / "camera.json"), "x, y: blank in all 368 rows"


def no_camera(recorded, tmp):
    return recorded / "tracks.csv", (), "expected --camera"


def one_camera_too_many(recorded, tmp):
    return recorded / "results", ("--camera", recorded / "camera.json"), "contains its own"


def all_swapped(recorded, tmp):
    table, *camera = swapped(recorded, tmp, *range(7))
    return table, camera, "exchange their numbers"


BAD = [no_folder, no_estimates, damaged, a_column_short, a_clip_short, few, none_at_all, nothing_finite, no_camera]


@pytest.mark.parametrize("bad", [*BAD, one_camera_too_many, all_swapped], ids=lambda f: f.__name__)
def test_bad_input_is_one_line_and_leaves_nothing(bad, recorded, tmp_path, capsys, monkeypatch):
    leave_exchanges(monkeypatch)
    measured, more, expected = bad(recorded, tmp_path)
    before = sorted(tmp_path.rglob("*"))
    assert command("find", measured, *more, "--model", MODEL, "-o", tmp_path / "report") == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith("discrepancy: ")
    assert expected in err
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("text", "expected"),
    [("effects: {plate_tillt: {x: 1.0e-3}}", "plate_tillt"), ("free: [weight]", "weight"), ("{", "YAML")],
)
def test_a_bad_model(recorded, tmp_path, capsys, text, expected):
    (tmp_path / "model.yaml").write_text(text)
    words = ("find", recorded / "results", "--model", tmp_path / "model.yaml", "-o", tmp_path / "report")
    assert command(*words) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert expected in err
    assert not (tmp_path / "report").exists()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("min_collision: 5", "unknown key; did you mean min_collisions?"),
        ("max_effects: many", "expected a whole number"),
        ("min_collisions: 7", "6 measured collisions: expected 7 or more"),
    ],
)
def test_a_policy_file_is_read_and_used(recorded, tmp_path, capsys, text, expected):
    (tmp_path / "policy.yaml").write_text(text)
    words = ("find", recorded / "results", "--model", MODEL, "--policy", tmp_path / "policy.yaml", "-o", tmp_path / "r")
    assert command(*words) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert expected in err
    assert not (tmp_path / "r").exists()


def test_an_output_that_holds_something_else(recorded, tmp_path, monkeypatch, capsys):
    (tmp_path / "notes.txt").write_text("mine")
    monkeypatch.chdir(tmp_path)
    for output in (tmp_path, ".", "notes.txt"):
        assert command("find", recorded / "results", "--model", MODEL, "-o", output) == 2
        assert "holds something else" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


def test_an_unknown_candidate(recorded, tmp_path, capsys):
    words = ("add", "gremlins", "--model", MODEL, "--fit", recorded / "results", "-o", tmp_path / "new.yaml")
    assert command(*words) == 2
    assert "gremlins: no such effect" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
