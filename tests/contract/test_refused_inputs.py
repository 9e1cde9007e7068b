"""Inputs that ended in a traceback, or were accepted without a word: each is one line with status 2."""

import json
import os
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tracker_film import CAMERA

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
LATIN = os.fsdecode(b"gr\xf6\xdfe")  # no UTF-8


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    (folder / "s.yaml").write_text("timing: {frames: 5, contact_frame: 2}\ncamera: {size: [64, 48]}\n")
    (folder / "surrogate.yaml").write_text('timing: {frames: 5}\nname: "\\ud800"\n')
    (folder / "empty.yaml").write_text("# nothing yet\n")
    (folder / "huge.yaml").write_text("model: {sliding_friction: 1e300}\n")
    (folder / "drag.yaml").write_text("model: {rolling_drag: 1e300}\n")
    (folder / "twice.yaml").write_text("free: [restitution, sliding_friction, r]\n")
    (folder / "camera.json").write_text(json.dumps(CAMERA))
    rows = pd.DataFrame({"frame": np.arange(20), "particle": 0, "x": np.nan, "y": np.nan})
    rows.to_csv(folder / "blank.csv", index=False)
    (folder / "loop").symlink_to("loop")
    (folder / "leaving").mkdir()
    (folder / "leaving/my_effect.py").write_text("raise SystemExit(0)\n")
    return folder


DEEP = ".".join(["a"] * 5000)
REFUSED = {
    f"tracker measure blank.csv --camera camera.json -o {LATIN}": "its name is not UTF-8; rename it, or choose another",
    f"synthcam generate s.yaml -o {LATIN}": "its name is not UTF-8",
    f"synthcam preview s.yaml -o {LATIN}.mp4": "its name is not UTF-8",
    f"tracker calibrate film.tif --diameter 2e-3 --fps 250 -o {LATIN}.json": "its name is not UTF-8",
    "tracker measure blank.csv --camera camera.json -o new": "blank.csv: x, y: blank in all 20 rows",
    "tracker calibrate film.tif --diameter 2e-3 --fps 250 -o loop": "loop: exists and was not made by",
    "synthcam generate s.yaml -o loop": "a link that leads to itself, expected another path",
    "synthcam generate s.yaml -o loop/new": "a link that leads to itself",
    "discrepancy plan s.yaml -o loop": "a link that leads to itself",
    "discrepancy find blank.csv --camera camera.json --model s.yaml -o loop": "a link that leads to itself",
    "synthcam generate surrogate.yaml -o new": "surrogate.yaml, line 2: not plain YAML (",
    'synthcam generate s.yaml -o new --set name="\\ud800"': "the value is not plain YAML (",
    f"synthcam generate s.yaml -o new --set {DEEP}=1": "5000 keys deep, expected at most 9",
    f"synthcam generate s.yaml -o new --set timing={'[' * 5000}": "not plain YAML (nested too deeply)",
    "synthcam effects --effects leaving": "my_effect.py: SystemExit: 0",
    "synthcam preview s.yaml -o new.png --frame 99999999999": "--frame 99999999999: expected 0 to 4; the clip has 5",
    "discrepancy find blank.csv --camera camera.json --model empty.yaml -o new": "empty.yaml: empty; expected a model",
    "discrepancy find blank.csv --camera camera.json --model huge.yaml -o new": "expected a number of 100 or less",
    "discrepancy find blank.csv --camera camera.json --model drag.yaml -o new": "expected a number of 10000 or less",
    "discrepancy find blank.csv --camera camera.json --model twice.yaml -o new": "free: restitution is given twice",
    "discrepancy adopt report --name class": "--name class: a word of Python's grammar; choose another name",
}


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
