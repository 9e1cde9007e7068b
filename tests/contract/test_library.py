"""The packages as libraries: public names with examples that run, docs/library.md as it stands, light imports."""

import doctest
import inspect
import re
import subprocess
import sys
from importlib import import_module

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from repository import ROOT

import synthcam
import tracker
from discrepancy.data.collisions import read_measured
from synthcam.dataset.generate import Plan, run
from tracker import pipeline

mpl.use("Agg")
PACKAGES = ("synthcam", "tracker", "discrepancy")
PUBLIC = [(p, n) for p in PACKAGES for n in import_module(p).__all__ if n != "__version__"]
SHOWN = {"Scene", "Clip", "Motion", "Model", "track", "measure", "find"}  # those whose docstrings hold examples
HEAVY = ("numpy", "pandas", "cv2", "scipy", "matplotlib", "pydantic", "OpenGL")


@pytest.mark.parametrize(("package", "name"), PUBLIC)
def test_public_names_are_there_and_documented(package, name):
    thing = getattr(import_module(package), name)
    assert thing.__module__.partition(".")[0] in PACKAGES
    assert len(inspect.getdoc(thing).splitlines()[0]) > 20
    assert name in dir(import_module(package))


@pytest.mark.parametrize("package", PACKAGES)
def test_a_name_that_is_none_is_said(package):
    with pytest.raises(AttributeError, match=f"module '{package}' has no attribute 'no_such'"):
        _ = import_module(package).no_such
    assert re.fullmatch(r"\d+\.\d+\.\d+\S*", import_module(package).__version__)


@pytest.mark.parametrize(("package", "name"), [p for p in PUBLIC if p[1] in SHOWN])
def test_the_examples_of_the_docstrings_run(package, name):
    thing = getattr(import_module(package), name)
    tests = [t for t in doctest.DocTestFinder().find(thing, name) if t.examples]
    assert tests
    for test in tests:
        said = []
        assert doctest.DocTestRunner().run(test, out=said.append).failed == 0, "".join(said)


@pytest.mark.parametrize("package", PACKAGES)
def test_parameters_stand_in_the_docstring(package):
    """Of public functions and methods, each parameter by its name."""
    for name in import_module(package).__all__[:-1]:
        thing = getattr(import_module(package), name)
        methods = vars(thing) if inspect.isclass(thing) else {name: thing}
        for method, function in methods.items():
            call = function.__func__ if isinstance(function, classmethod) else function
            if not inspect.isfunction(call) or method.startswith("_") or "Parameters\n" not in (call.__doc__ or ""):
                continue
            for parameter in list(inspect.signature(call).parameters):
                assert parameter in ("self", "cls") or re.search(rf"^\s+\**{parameter}\b.*$", call.__doc__, re.M), (
                    f"{name}.{method}: {parameter}"
                )


@pytest.mark.parametrize("package", PACKAGES)
def test_an_import_is_light(package):
    """What a command's --help would pay for is loaded when it is used."""
    code = f"import sys, {package}; print([m for m in {HEAVY} if m in sys.modules])"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout == "[]\n"


@pytest.mark.parametrize("module", [f"{p}{end}" for p in PACKAGES for end in ("", ".cli")])
def test_a_package_and_its_cli_run_as_the_command(module):
    done = subprocess.run([sys.executable, "-m", module, "no-such"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert "No such command 'no-such'" in done.stderr


def test_the_page_runs_as_it_stands(tmp_path, monkeypatch, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/library.md").read_text(), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(code, "docs/library.md", "exec"), names)
    assert "named plate_tilt 0.99" in capsys.readouterr().out
    assert {p.name for p in tmp_path.iterdir()} == {"model.yaml", "report"}
    assert abs(names["found"].model.effects[0].x - 1e-3) < 5 * names["found"].named[0].std["plate_tilt.x"]
    pd.testing.assert_frame_equal(names["again"].estimates, names["result"].estimates)
    mpl.pyplot.close("all")


def test_filmed_collisions_reach_the_search_alike_from_memory_and_from_files(tmp_path):
    """Written standard errors, squared again, differ from the covariances in memory; the search must not see it."""
    small = {"camera": {"size": [200, 160], "scale": 3e-4}, "timing": {"frames": 60, "contact_frame": 20}}
    scene = synthcam.Scene.read("painter_behringer", **small)
    run(Plan((scene,), 2, 3), tmp_path / "data", 1, lambda done, of: None)
    pipeline.run(tmp_path / "data", tmp_path / "results", None, "maximum_likelihood", 1)
    clips = [scene.draw(k, 3) for k in range(2)]
    one, _ = read_measured([tracker.track(c.film(), c.camera_json) for c in clips])
    other, _ = read_measured(tmp_path / "results")
    assert len(one) == len(other) == 2
    for a, b in zip(one, other, strict=True):
        for name in ("clip", "frame", "ball", "xy", "covariance", "launch", "ends", "offset"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), name)
