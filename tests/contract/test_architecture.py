"""Who may import whom: arrows run one way."""

import ast
from graphlib import TopologicalSorter

import pytest
from repository import ROOT

SRC = ROOT / "src"
FILES = sorted(SRC.rglob("*.py"))
PACKAGES = ("synthcam", "tracker", "discrepancy")

# The spine of synthcam: a file may lean on those of earlier rows, be it by way of files not named here,
# never on one of its own row or of a later one.
ROWS = [
    "settings effect kinematics spectral reflections lamp",
    "distribution model trajectory optics",
    "launch impact sliding picture",
    "rolling sensor render",
    "pulled",
    "coupled",
    "pairing",
    "dynamics scene",
    "batch view",
    "truth",
    "dataset",
    "generate",
    "preview sketch",
    "cli",
]
LAZY = {("effect", "effects")}  # the folder scan of `library`, when it is called


def module(path):
    parts = path.relative_to(SRC).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path):
    """Dotted names a file imports; `from a import b` counts as a.b, relative ones resolved."""
    here = module(path).split(".")
    inside = here if path.name == "__init__.py" else here[:-1]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = inside[: len(inside) - node.level + 1] if node.level else []
            base = ".".join([*base, *([node.module] if node.module else [])])
            yield from (f"{base}.{alias.name}" for alias in node.names)


def tops(path):
    return {name.partition(".")[0] for name in imports(path)}


def ours(path):
    """The modules of its own package a file imports."""
    known = {module(p) for p in FILES}
    for name in imports(path):
        while name and name not in known:
            name = name.rpartition(".")[0]
        if name and name != module(path):
            yield name


def test_there_is_something_to_read():
    names = {module(p) for p in FILES}
    assert {"synthcam.dynamics.solve", "tracker.measurement.collision_model", "discrepancy"} <= names
    assert "synthcam.dynamics.kinematics" in set(ours(SRC / "synthcam/dynamics/impact.py"))


@pytest.mark.parametrize("path", FILES, ids=module)
def test_packages_keep_apart(path):
    package = module(path).partition(".")[0]
    forbidden = {
        "synthcam": {"tracker", "discrepancy"},
        "tracker": {"synthcam", "discrepancy"},
        "discrepancy": set(),
    }
    assert not tops(path) & forbidden[package]
    if package == "discrepancy":
        assert not any(name.startswith("synthcam.camera.render") for name in ours(path))


@pytest.mark.parametrize("path", FILES, ids=module)
def test_only_render_knows_opengl(path):
    if not module(path).startswith("synthcam.camera.render."):
        assert not tops(path) & {"pyrender", "trimesh", "OpenGL", "pyglet"}


@pytest.mark.parametrize("package", PACKAGES)
def test_no_circles(package):
    graph = {
        module(p): {n for n in ours(p) if n.startswith(f"{package}.")} for p in FILES if module(p).startswith(package)
    }
    for importer, scanned in LAZY:
        graph.get(f"synthcam.{importer}", set()).discard(f"synthcam.{scanned}")
    TopologicalSorter(graph).prepare()  # raises CycleError


def leans_on(name, arrows):
    """Everything a file imports, directly or by way of others."""
    found, todo = set(), [name]
    while todo:
        for other in arrows.get(todo.pop(), set()) - found:
            found.add(other)
            todo.append(other)
    return found


def test_synthcams_arrows_run_one_way():
    row = {f"synthcam.{name}": k for k, names in enumerate(ROWS) for name in names.split()}
    arrows = {module(p): {n for n in ours(p) if n.startswith("synthcam.")} for p in FILES}
    for importer, scanned in LAZY:
        arrows[f"synthcam.{importer}"].discard(f"synthcam.{scanned}")
    for name in row:
        assert name in arrows, f"{name} is gone: take it out of ROWS"
        back = [other for other in leans_on(name, arrows) if row.get(other, -1) >= row[name]]
        assert not back, f"{name} may not lean on {', '.join(back)}"
    for name in arrows:
        if name.startswith("synthcam.effects."):
            assert arrows[name] == {"synthcam.effect"}, f"{name}: an effect knows of effect alone"


def test_effects_are_listed_nowhere():
    """No file but its own names an effect's module."""
    for path in (SRC / "synthcam").rglob("*.py"):
        if path.parent.name != "effects":
            assert not [n for n in imports(path) if n.startswith("synthcam.effects.")]
    assert not list(imports(SRC / "synthcam/effects/__init__.py"))


@pytest.mark.parametrize("path", FILES, ids=module)
def test_files_stay_small_and_well_named(path):
    assert path.stem not in {"utils", "helpers", "types", "base", "constants", "common", "misc"}
    assert len(path.read_text().splitlines()) < 400
