"""Inputs that ended in a traceback, or were accepted without a word: each is one line with status 2."""

import sys
from pathlib import Path

import pytest
from refused_inputs import REFUSED, write_refused_inputs

import discrepancy.cli
import synthcam.cli
import tracker.cli
from synthcam.library import add_effects, check_name
from synthcam.model import as_model, read_model
from synthcam.scene.scene import check_scene, read_scene
from synthcam_shared.application import make_command_line, run
from synthcam_shared.errors import InputError, PluginError
from synthcam_shared.outputs import check_writable

MAINS = {"synthcam": synthcam.cli.main, "tracker": tracker.cli.main, "discrepancy": discrepancy.cli.main}


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    write_refused_inputs(folder)
    return folder


def files_in(folder):
    """All but the bytecode that Python keeps beside a module."""
    return sorted(path for path in folder.rglob("*") if "__pycache__" not in path.parts)


@pytest.mark.parametrize("typed", REFUSED, ids=[f"{k}-{typed[:40]!a}" for k, typed in enumerate(REFUSED)])
def test_one_line_and_nothing_written(typed, bench, monkeypatch, capsys):
    before = files_in(bench)
    monkeypatch.chdir(bench)
    monkeypatch.setattr(sys, "argv", typed.split())
    with pytest.raises(SystemExit) as stopped:
        MAINS[sys.argv[0]]()
    err = capsys.readouterr().err
    assert (err.count("\n"), stopped.value.code) == (1, 2), err
    assert REFUSED[typed] in err
    assert len(err) < 400
    assert files_in(bench) == before


def test_an_exit_of_a_users_file_is_reported(monkeypatch, capsys):
    """Status 0 would say that all is well."""
    app = make_command_line("tool", "Does nothing.")
    app.command("work")(lambda: sys.exit(0))
    app.command("other")(lambda: None)
    monkeypatch.setattr(sys, "argv", ["tool", "work"])
    with pytest.raises(SystemExit) as ended:
        run(app, "tool", (InputError,))
    assert ended.value.code == 2
    assert "test_refused_inputs.py, line" in (err := capsys.readouterr().err)
    assert "ends the program" in err


@pytest.mark.parametrize("name", ["class", "lambda", "if"])
def test_an_effect_has_no_name_of_pythons_grammar(name):
    with pytest.raises(PluginError, match=f"word of Python's grammar; choose another name, such as {name}_effect"):
        check_name(name, "--name")


def test_an_effect_file_that_exits(bench):
    with pytest.raises(PluginError, match=r"my_effect\.py: SystemExit: 0"):
        add_effects(bench / "leaving")


def test_models_that_are_fine_stay_so(tmp_path):
    assert as_model({}).restitution == 0.903
    (tmp_path / "m.yaml").write_text("model: {}\nfree: [restitution, mu_k]\n")
    assert read_model(tmp_path / "m.yaml").free == ("restitution", "sliding_friction")
    (tmp_path / "s.yaml").write_text("")
    assert read_scene(tmp_path / "s.yaml").name == "scene"
    assert check_scene({"model": {"sliding_friction": 4.0}, "name": "grüße 🎱"}, "s").name == "grüße 🎱"


def test_a_name_in_another_script_is_written(tmp_path):
    check_writable(tmp_path / "grüße 🎱.json")
    assert not list(Path(tmp_path).iterdir())
