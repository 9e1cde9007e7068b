"""The packages as libraries: public names with examples that run, docs/library.md as it stands, light imports."""

import ast
import dataclasses
import doctest
import inspect
import re
import runpy
import subprocess
import sys
from functools import cached_property
from importlib import import_module

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from discrepancy_clips import only
from repository import ROOT

import synthcam
import tracker
from discrepancy.data.reading import read_collisions
from synthcam.dataset.generate import GenerationPlan, generate_dataset
from synthcam.library import library
from tracker import pipeline

mpl.use("Agg")
PACKAGES = ("synthcam", "tracker", "discrepancy")
NAMES = [(p, n) for p in (*PACKAGES, "tracker.benchmark") for n in import_module(p).__all__ if n != "__version__"]
PUBLIC = [(p, n) for p, n in NAMES if not inspect.ismodule(getattr(import_module(p), n))]
# without an example of their own
SILENT = {"NoGL", "InputError", "Finding", "Plan", "run", "TrackerRun", "describe_rejection", "describe_search"}
HEAVY = ("numpy", "pandas", "cv2", "scipy", "matplotlib", "pydantic", "OpenGL", "importlib.metadata")


def test_public_names_are_there_and_documented():
    assert len(PUBLIC) > 30
    for package, name in PUBLIC:
        thing = getattr(import_module(package), name)
        assert thing.__module__.partition(".")[0] in ("synthcam_shared", *PACKAGES), name
        assert len(inspect.getdoc(thing).splitlines()[0]) > 20, name
        assert name in dir(import_module(package))


@pytest.mark.parametrize("package", PACKAGES)
def test_a_name_that_is_none_is_said(package):
    with pytest.raises(AttributeError, match=f"No {package} attribute no_such"):
        _ = import_module(package).no_such
    assert re.fullmatch(r"\d+\.\d+\.\d+\S*", import_module(package).__version__)


def own_methods(thing):
    """Name and function of each public method that a class of these packages defines or inherits from one."""
    for base in reversed(thing.__mro__):
        if base.__module__.partition(".")[0] in PACKAGES:
            for name, member in vars(base).items():
                function = member.__func__ if isinstance(member, classmethod | staticmethod) else member
                if not name.startswith("_") and inspect.isfunction(function):
                    yield name, function


CALLS = {f"{p}.{n}": getattr(import_module(p), n) for p, n in PUBLIC}
CLASSES = {name: thing for name, thing in CALLS.items() if inspect.isclass(thing)}
CALLS = {name: thing for name, thing in CALLS.items() if name not in CLASSES}
CALLS |= {f"{name}.{method}": call for name, thing in CLASSES.items() for method, call in own_methods(thing)}


def section(doc, title):
    """The lines of a section of a numpydoc docstring; None where there is none."""
    found = re.search(rf"^{title}\n-+\n(.*?)(?=^\w+\n---|\Z)", doc, re.MULTILINE | re.DOTALL)
    return found and found[1].splitlines()


def names_in(lines):
    """List the names in a section: "x, y : float" is x and y, "**more" is more."""
    heads = [line.partition(" : ")[0] for line in lines or () if line and not line[0].isspace()]
    return [name.strip().lstrip("*") for head in heads for name in head.split(",")]


def test_a_docstring_says_what_goes_in_and_what_comes_out():
    wrong = []
    for name, call in CALLS.items():
        doc, signature = inspect.getdoc(call) or "", inspect.signature(call)
        taken = [p for p in signature.parameters if p not in ("self", "cls")]
        returns = signature.return_annotation != "None"
        if names_in(section(doc, "Parameters")) != taken:
            wrong.append(f"{name} takes {taken}")
        if bool(section(doc, "Returns") or section(doc, "Yields")) != returns:
            wrong.append(f"{name} returns {signature.return_annotation}")
    assert wrong == []
    assert len(CALLS) > 40


def test_a_section_of_parameters_is_that_of_the_signature():
    wrong, sections = [], 0
    for path in sorted((ROOT / "src").rglob("*.py")):
        text = path.read_text()
        if not re.search(r"^ *Parameters\n *-+$", text, re.MULTILINE):
            continue  # most files have no such section, and need not be parsed
        for node in ast.walk(ast.parse(text)):
            doc = isinstance(node, ast.FunctionDef) and ast.get_docstring(node)
            if doc and (lines := section(doc, "Parameters")):
                a = node.args
                every = [*a.posonlyargs, *a.args, *filter(None, [a.vararg]), *a.kwonlyargs, *filter(None, [a.kwarg])]
                sections += 1
                if names_in(lines) != [each.arg for each in every if each.arg not in ("self", "cls")]:
                    wrong.append(f"{path}: {node.name}")
    assert wrong == []
    assert sections > 40


def test_a_class_lists_its_fields_and_documents_its_properties():
    classes = {name: thing for name, thing in CLASSES.items() if dataclasses.is_dataclass(thing)}
    assert len(classes) > 10
    for name, thing in classes.items():
        listed = names_in(section(inspect.getdoc(thing), "Attributes"))
        assert listed == [field.name for field in dataclasses.fields(thing)], name
        properties = [m for m in vars(thing).values() if isinstance(m, property | cached_property)]
        assert all(inspect.getdoc(p.fget if isinstance(p, property) else p.func) for p in properties), name


@pytest.mark.parametrize(("package", "name"), [p for p in PUBLIC if p[1] not in SILENT])
def test_the_examples_of_the_docstrings_run(package, name, monkeypatch):
    """Of an experiment that is planned, one draw is looked at."""
    monkeypatch.setattr("discrepancy.plan_experiment.count_draws", lambda _: 1)
    thing = getattr(import_module(package), name)
    tests = [t for t in doctest.DocTestFinder().find(thing, name) if t.examples]
    assert tests
    for test in tests:
        said = []
        assert doctest.DocTestRunner().run(test, out=said.append).failed == 0, "".join(said)


@pytest.mark.parametrize("package", PACKAGES)
def test_an_import_is_light(package):
    """Slow imports are made when they are used, so that --help stays quick."""
    code = f"import sys, {package}; print([m for m in {HEAVY} if m in sys.modules])"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout == "[]\n"


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_runs_as_the_command(package):
    done = subprocess.run([sys.executable, "-m", package, "no-such"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert "No such command 'no-such'" in done.stderr


@pytest.mark.filterwarnings("ignore:.*found in sys.modules after import of package")
@pytest.mark.parametrize("package", PACKAGES)
def test_its_cli_runs_as_the_command_too(package, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [package, "no-such"])
    with pytest.raises(SystemExit) as left:
        runpy.run_module(f"{package}.cli", run_name="__main__")
    assert left.value.code == 2
    assert "No such command 'no-such'" in capsys.readouterr().err


@pytest.mark.usefixtures("undrawn")
@pytest.mark.gate
def test_the_page_runs_as_it_stands(tmp_path, monkeypatch, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/library.md").read_text(), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    few = {name: library()[name] for name in ("plate_tilt", "rolling_quadratic")}
    only(monkeypatch, ("force_place",), **few)
    names = {}
    exec(compile(code, "docs/library.md", "exec"), names)
    assert "named plate_tilt 0.99" in capsys.readouterr().out
    assert {p.name for p in tmp_path.iterdir()} == {"model.yaml", "report"}
    assert abs(names["found"].model.effects[0].x - 1e-3) < 5 * names["found"].named[0].std["plate_tilt.x"]
    again, result = (
        names[key].estimates.drop(columns="local") for key in ("again", "result")
    )  # a text of rounded numbers
    pd.testing.assert_frame_equal(again, result)
    mpl.pyplot.close("all")


def test_filmed_collisions_reach_the_search_alike_from_memory_and_from_files(tmp_path):
    """Written standard errors, squared again, differ from the covariances in memory; the search must not see it."""
    small = {"camera": {"size": [200, 160], "scale": 3e-4}, "timing": {"frames": 60, "contact_frame": 20}}
    scene = synthcam.Scene.read("painter_behringer", **small)
    generate_dataset(GenerationPlan((scene,), 2, 3), tmp_path / "data", 1, lambda done, of: None)
    pipeline.run(tmp_path / "data", tmp_path / "results", "maximum_likelihood", 1)
    clips = [scene.draw(k, 3) for k in range(2)]
    one, _ = read_collisions([tracker.track(c.film(), c.camera_json) for c in clips])
    other, _ = read_collisions(tmp_path / "results")
    assert len(one) == len(other) == 2
    for a, b in zip(one, other, strict=True):
        for name in ("clip", "frame", "ball", "xy", "covariance", "launch", "slide_ends", "offset"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), name)
