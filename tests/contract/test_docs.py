"""Code in the docs: cheap pages run as they stand, every command and option is one that there is."""

import ast
import dataclasses
import importlib.util
import re
import runpy
import shlex
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import typer
from repository import ROOT

from discrepancy.free_laws import laws, library
from discrepancy.free_laws.law_kinds import SeriesEffect
from discrepancy.free_laws.ranges import Axis
from discrepancy.policy import SearchPolicy
from synthcam import tabulated_law
from synthcam.scene.scene import check_scene
from synthcam_shared.settings import parse_yaml

TOOL = runpy.run_path(str(ROOT / "tools/doc_blocks.py"))
PAGES = TOOL["pages"]()
BLOCKS = [block for page in PAGES for block in TOOL["blocks"](page)]
CHEAP = (
    ("background/physics.md", "background/statistics.md", "howto/effect.md"),
    pytest.param(("howto/detector.md",), marks=pytest.mark.gate),
    pytest.param(("howto/many_bodies.md",), marks=pytest.mark.gate),
)
NAMES = ("synthcam", "tracker", "discrepancy")
PROGRAMS = {name: typer.main.get_command(import_module(f"{name}.cli").app) for name in NAMES}
OTHERS = ("git", "cd", "pip", ".")  # commands of a shell, not looked into
INLINE = re.compile(r"(?<!`)`((?:synthcam|tracker|discrepancy|make|python -m) [^`]+)`")


def wrong_in(line, whole=True):
    """List what a command line names that does not exist; for a complete one also what it lacks."""
    words = shlex.split(line, comments=True)
    if not words or words[0] in OTHERS:
        return []
    program = words[0].rpartition("/")[2]
    if program == "make":
        return wrong_in_make(words[1:])
    return wrong_in_python(words[2:]) if program == "python" else wrong_in_program([program, *words[1:]], whole)


def wrong_in_make(words):
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    studies = {f"bench-{p.stem.replace('_', '-')}" for p in (ROOT / "benchmarks").glob("*/*.py")}
    return [w for w in words if "=" not in w and w not in targets | studies | {"bench-NAME"}]


def wrong_in_python(words):
    """List what `python -m` lacks: its module, or options that the module's text does not have."""
    module, *rest = words
    if module == "pytest":
        return [p for p in rest if p.startswith("tests/") and not (ROOT / p).exists()]
    found = importlib.util.find_spec(module)
    if found is None:
        return [module]
    text = Path(found.origin).read_text()
    return [w for w in rest if w.startswith("--") and w.partition("=")[0] not in text]


def wrong_in_program(words, whole):
    command, rest = PROGRAMS[words[0]], words[1:]
    while hasattr(command, "commands") and rest and not rest[0].startswith("-"):
        if rest[0] not in command.commands:
            return [rest[0]]
        command = command.commands[rest.pop(0)]
    options = {name: p for p in command.params if p.param_type_name == "option" for name in p.opts}
    wrong, given, named = [], 0, set()
    while rest:
        name, equals, _ = rest.pop(0).partition("=")
        if not name.startswith("-"):
            given += 1
        elif name in options:
            named.add(options[name].name)
            if not (equals or options[name].is_flag):
                rest[:1] = []
        elif name != "--help":
            wrong.append(name)
    if not whole or wrong:
        return wrong
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    most = 99 if any(p.nargs == -1 for p in arguments) else len(arguments)
    lacks = {f"no {p.opts[0]}" for p in options.values() if p.required and p.name not in named}
    return [*([] if sum(p.required for p in arguments) <= given <= most else [f"{given} arguments"]), *sorted(lacks)]


def test_each_command_of_a_block_is_there():
    lines = [(block.where, line) for block in BLOCKS if block.language == "sh" for line in block.text.splitlines()]
    assert len(lines) > 100
    assert [(where, line, wrong) for where, line in lines if (wrong := wrong_in(line))] == []


def test_each_command_within_a_sentence_is_there():
    found = []
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *PAGES):
        text = " ".join(re.sub(r"^ *```.*?^ *```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE).split())
        found += [(page.name, re.sub(r"[\[\]]|\.\.\.", "", line)) for line in INLINE.findall(text)]
    assert len(found) > 50
    assert [(page, line, wrong) for page, line in found if (wrong := wrong_in(line, whole=False))] == []


@pytest.mark.parametrize(
    ("line", "wrong"),
    [
        ("synthcam generat scenes/oblique.yaml -o out", ["generat"]),
        ("tracker track film.mp4 --kamera camera.json -o out", ["--kamera"]),
        ("tracker track film.mp4", ["no -o"]),
        ("discrepancy find --model m.yaml -o out", ["0 arguments"]),
        ("make bench-nothing", ["bench-nothing"]),
        ("python -m benchmarks.tracker.discs --reels 4", ["--reels"]),
        ("python -m benchmarks.tracker.nothing", ["benchmarks.tracker.nothing"]),
    ],
)
def test_a_command_that_is_none_is_seen(line, wrong):
    assert wrong_in(line) == wrong


def read_block(block):
    """Check what a block says that it is, and read it as that."""
    assert block.language in TOOL["LANGUAGES"]
    assert {name for name, _ in block.orders} <= set(re.findall(r"<!-- docs-test: (\w+)", TOOL["__doc__"]))
    if block.language == "python" and not block.asked("after"):
        ast.parse(block.text)
    if block.language == "yaml":
        settings = parse_yaml(block.text)
        SearchPolicy(**settings) if "policy.yaml" in block.asked("file") else check_scene(settings, block.where)


def test_a_block_says_what_it_is_and_can_be_read():
    wrong = []
    for block in BLOCKS:
        try:
            read_block(block)
        except Exception as error:
            wrong.append((block.where, str(error)))
    assert wrong == []


def test_output_on_a_page_that_no_command_prints_is_seen():
    printed = "4 clips: 4 ok\nr        6.6·10⁻⁵   0.77(27)\nx -3e-07 +- 7e-07 rad\n"
    find = TOOL["find_missing_lines"]
    assert find("4 clips: 3 ok\n\nr  0.0012   0.7(3)\nx 1.5e-07 +- 6e-7 rad\n", printed) == []
    assert find("4 films: 4 ok\nr  0.0012   0.7(3) 1.1\n", printed) == ["4 films: 4 ok", "r  0.0012   0.7(3) 1.1"]


def test_searches_of_a_page_have_an_hour_unless_they_say_otherwise():
    allow = TOOL["allow_for_load"]
    assert allow("tracker track a -o b\ndiscrepancy find b -o c\n") == (
        "tracker track a -o b\ndiscrepancy find --minutes 60 b -o c\n"
    )
    assert allow("discrepancy find b --minutes 2 -o c") == "discrepancy find b --minutes 2 -o c"


@pytest.mark.parametrize("pages", CHEAP, ids=" ".join)
def test_a_page_runs_as_it_stands(pages, tmp_path):
    """Its files and its Python; in another process, since effects that are added stay, as they do in the last page."""
    code = """
import runpy, sys, pathlib
tool = runpy.run_path(sys.argv[1])
for page in sys.argv[2:]:
    names = {}
    for block in tool["blocks"](pathlib.Path(page)):
        if block.language == "python" or block.asked("file"):
            tool["run"](block, names)
"""
    files = [ROOT / "tools/doc_blocks.py", *(ROOT / "docs" / name for name in pages)]
    words = [sys.executable, "-W", "error", "-c", code, *files]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_free_law_of_the_page_is_found_and_a_model_holds_it(tmp_path, monkeypatch):
    """In a folder beside the package's own; make docs-test puts it where the page says."""
    page = [b for b in BLOCKS if b.where.startswith("howto/free_law.md")]
    (tmp_path / "friction_radius.py").write_text(page[0].text)
    monkeypatch.setattr(laws, "__path__", [*laws.__path__, str(tmp_path)])
    library.list_free_laws.cache_clear()
    try:
        (found_law,) = (law for law in library.list_free_laws() if law.base_name == "friction_radius")
    finally:
        library.list_free_laws.cache_clear()
        sys.modules.pop("discrepancy.free_laws.laws.friction_radius", None)
    (line,) = (b.text for b in page if b.asked("after"))
    held = eval(f"{{{line}}}", vars(tabulated_law))["friction_radius"]
    assert ((held.law, held.what), held.owners, held.unit) == (found_law.bends, found_law.owners, found_law.unit)
    axes = (Axis("distance from the middle", "m", 0.0, 0.05, 6),)
    series = SeriesEffect(dataclasses.replace(found_law, axes=axes), tuple(1e-3 * np.arange(1.0, 7.0)))
    ((law, bend, asks),) = series.bends
    assert (law, asks) == ("friction", ("position",))
    found = bend(np.full((1, 3), 0.2), np.array([[[0.03, 0.0], [0.0, -0.03], [0.01, 0.02]]]))[0]
    assert found[0] == pytest.approx(found[1], abs=1e-15)
    assert abs(found[2] - found[0]) > 1e-6


def imports_of(path):
    """The names that a file imports from our packages, as (module, name)."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module.partition(".")[0] in (*NAMES, "synthcam_shared"):
            yield from ((node.module, alias.name) for alias in node.names)


@pytest.mark.parametrize("folder", ["docs/extensions", "tools"])
def test_imports_of_the_site_and_the_tools_exist(folder):
    found = [entry for path in sorted((ROOT / folder).glob("*.py")) for entry in imports_of(path)]
    missing = [f"{module}.{name}" for module, name in found if not hasattr(import_module(module), name)]
    assert not missing
    assert folder == "tools" or len(found) > 3  # the site documents our packages


def test_files_in_blocks_have_a_language_that_is_run():
    """A block of text is output that nobody runs: a file in it would never be written."""
    assert not [b.where for b in BLOCKS if b.language == "text" and (b.asked("file") or b.asked("after"))]
