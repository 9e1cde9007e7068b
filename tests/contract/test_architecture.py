"""Who may import whom: packages, rooms and files in layers, with the imports made by name counted too."""

import ast
import pkgutil
import re
import runpy
from collections import Counter
from functools import cache
from graphlib import TopologicalSorter

import pytest
from repository import ROOT

SRC = ROOT / "src"
FILES = sorted(SRC.rglob("*.py"))

# Rooms and files of each package, from the bottom up: one may import from rows above its own, never from its own row or
# from one below. A file that stands in no row counts as its folder.
LAYERS = {
    "synthcam_shared": [
        "arrays errors interruption job_result json_values lazy_names steps track_formats",
        "arguments outputs settings application start dask_cluster",
        "jobs",
        "report",
    ],
    "synthcam": [
        "settings effect table",
        "effects tabulated_law",
        "library",
        "model",
        "dynamics camera",
        "scene",
        "dataset",
        "cli",
        "__main__",
    ],
    "tracker": [
        "settings notes",
        "camera",
        "detection",
        "measurement tables",
        "results edits",
        "report export",
        "recording calibration",
        "pipeline sets gas",
        "scoring",
        "benchmark app",
        "cli",
        "__main__",
    ],
    "discrepancy": [
        "policy time_left",
        "data",
        "noise",
        "fitting",
        "free_laws",
        "select",
        "planning",
        "validate",
        "preparation adopt",
        "outcome",
        "wording",
        "add report",
        "results plan_experiment",
        "search",
        "cli",
        "__main__",
    ],
    "synthcam.dynamics": [
        "kinematics collocation",
        "trajectory forces",
        "integrated_motion orientation supports",
        "propagate launch contacts",
        "start_from_rest segments tabletop",
        "interacting_pair",
        "solve",
        "batch",
    ],
    "synthcam.dynamics.contacts": ["walls", "impact contact_time", "calendar"],
    "synthcam.camera": [
        "lamp psf",
        "reflections surface",
        "pinhole",
        "glints plate exposure occlusion",
        "renderer sensor",
        "render room",
    ],
    "synthcam.scene": [
        "distribution materials film_time",
        "apparatus ground_truth",
        "motion",
        "clip",
        "scene",
        "visibility",
    ],
    "discrepancy.free_laws": [
        "ranges",
        "law_kinds",
        "laws",
        "library marginal_likelihood",
        "fitted_law",
        "credible_band formula",
        "law_summary",
    ],
    "tracker.measurement": [
        "noise",
        "positions track_repair random_effects",
        "stretch_cuts",
        "collision",
        "camera_errors messages",
        "joint_fit painter_behringer lone_ball",
        "local",
        "estimate",
    ],
    "tracker.measurement.local": [
        "stretches",
        "local_problem",
        "lasting_errors",
        "descents",
        "local_fit",
        "push_fit",
        "local_estimate",
        "recommendation",
        "local_columns",
    ],
    "tracker.measurement.collision": [
        "collision_model",
        "least_squares derived",
        "contacts adequacy",
        "noise_correlation striker departures",
        "collision_fit untested_laws",
    ],
    "tracker.benchmark": [
        "suite",
        "judging",
        "report trackers",
        "contest library",
        "commands",
    ],
    "tracker.tables": [
        "dialect",
        "content rows",
        "table",
        "column_names unit_check",
        "formats",
        "read",
    ],
    "tracker.app": [
        "film_view track_process local_only",
        "frame_detector run_settings",
        "workbench",
        "server",
    ],
    "tracker.sets": [
        "combined_quantity",
        "set_page",
        "combined_set",
    ],
    "tracker.report": [
        "quantities collision_figures overlay",
        "estimates_text",
        "pages",
    ],
    "tracker.detection": [
        "candidates motion_blur",
        "glints background",
        "detector outlines",
        "own_detector",
        "likelihood following",
        "link autocalibrate",
        "detectors linkers",
        "detect",
    ],
}
PEERS = {  # found by their being there
    "synthcam.effects",
    "synthcam.dataset.exports",
    "tracker.detection.detectors",
    "tracker.detection.linkers",
    "tracker.tables.formats",
    "discrepancy.free_laws.laws",
}


def module(path):
    parts = path.relative_to(SRC).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


KNOWN = {module(p) for p in FILES}


@cache
def parsed(path):
    return [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Import | ast.ImportFrom | ast.Call)]


def imported(path):
    """Dotted names that a file imports; `from a import b` counts as a.b."""
    here = module(path).split(".")
    inside = here if path.name == "__init__.py" else here[:-1]
    for node in parsed(path):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = inside[: len(inside) - node.level + 1] if node.level else []
            base = ".".join([*base, *([node.module] if node.module else [])])
            yield from (f"{base}.{alias.name}" for alias in node.names)


def by_name(path):
    """Modules that a file imports by name: a constant, or every file of a folder whose __name__ begins the name."""
    folders = {name.rpartition(".")[2]: name for name in imported(path) if name in PEERS}
    for node in parsed(path):
        called = getattr(node.func, "attr", getattr(node.func, "id", "")) if isinstance(node, ast.Call) else ""
        if called == "import_module":
            (name,) = node.args
            if isinstance(name, ast.Constant):
                yield name.value
                continue
            said = ast.unparse(name)
            assert "__name__" in said, f"{module(path)} imports {said}: of which folder cannot be seen"
            for folder in folders.values():
                yield from (m for m in KNOWN if m.startswith(f"{folder}."))


@cache
def found_by_name():
    """Modules that each module imports by name."""
    return {module(p): set(by_name(p)) for p in FILES}


def ours(path):
    """The modules of these packages that a file imports."""
    for name in {*imported(path), *found_by_name()[module(path)]}:
        while name and name not in KNOWN:
            name = name.rpartition(".")[0]
        if name and name != module(path):
            yield name


@cache
def arrows():
    """Modules of these packages that each module imports: read when a test asks, not when tests are collected."""
    return {module(p): set(ours(p)) for p in FILES}


def tops(path):
    return {name.partition(".")[0] for name in imported(path)}


def test_there_is_something_to_read():
    assert {"synthcam.dynamics.solve", "tracker.measurement.collision.collision_model", "discrepancy"} <= KNOWN
    assert "synthcam.dynamics.kinematics" in arrows()["synthcam.dynamics.contacts.impact"]
    for finder in (
        "synthcam.library",
        "synthcam.dataset.export",
        "tracker.detection.detect",
        "tracker.tables.read",
        "discrepancy.free_laws.library",
    ):
        assert any(m.startswith(f"{folder}.") for folder in PEERS for m in arrows()[finder]), finder


def test_packages_keep_apart():
    allowed = {"synthcam_shared": set(), "synthcam": {"synthcam_shared"}, "tracker": {"synthcam_shared"}}
    allowed["discrepancy"] = {"synthcam_shared", "synthcam", "tracker"}
    wrong = {}
    for path in FILES:
        package = module(path).partition(".")[0]
        wrong[module(path)] = (tops(path) & allowed.keys()) - allowed[package] - {package}
        if package == "discrepancy":
            wrong[module(path)] |= {n for n in arrows()[module(path)] if n.startswith("synthcam.camera.render")}
    assert {name: others for name, others in wrong.items() if others} == {}


def test_only_render_knows_opengl():
    others = [path for path in FILES if not module(path).startswith("synthcam.camera.render.")]
    assert len(others) > 400
    assert [module(path) for path in others if tops(path) & {"pyrender", "trimesh", "OpenGL", "pyglet"}] == []


def test_no_circles():
    assert set(TopologicalSorter(arrows()).static_order()) >= KNOWN  # raises CycleError


def room(name, package):
    """The room or file of a package that a module belongs to, or nothing."""
    return name[len(package) + 1 :].partition(".")[0] if name.startswith(f"{package}.") else ""


@pytest.mark.parametrize("package", LAYERS)
def test_arrows_run_one_way(package):
    row = {name: k for k, names in enumerate(LAYERS[package]) for name in names.split()}
    folder = SRC / package.replace(".", "/")
    assert all((folder / name).is_dir() or (folder / f"{name}.py").is_file() for name in row), (
        "a row names what is gone"
    )
    if "." not in package:
        there = {p.stem for p in folder.iterdir() if p.suffix == ".py" or (p / "__init__.py").is_file()}
        assert there - {"__init__"} == set(row), "a room stands in no row"
    wrong = []
    for name, others in arrows().items():
        here = room(name, package)
        for other in (o for o in others if room(o, package) not in ("", here)):
            there = room(other, package)
            if here in row and there in row and row[there] >= row[here]:
                wrong.append(f"{name} imports {other}")
    assert not wrong


def test_the_map_in_contributing_is_up_to_date():
    """Every module is in the map of CONTRIBUTING.md, with the first sentence of its docstring."""
    tool = runpy.run_path(str(ROOT / "tools/plan.py"))
    page = (ROOT / "CONTRIBUTING.md").read_text()
    assert page == tool["with_plan"](page), "the map is out of date: python tools/plan.py --write"
    missing = [module(p) for p in FILES if not tool["summary"](p)]
    assert not missing, "modules without a docstring"


def test_decisions_are_made_where_contributing_says():
    """Each dotted name in the table of decisions is a module, or something in one."""
    page = (ROOT / "CONTRIBUTING.md").read_text()
    table = page.partition("### Where decisions are made")[2].partition("\n## ")[0]
    names = re.findall(r"`((?:synthcam|tracker|discrepancy|synthcam_shared)[.\w]+)`", table)
    assert len(names) > 10
    for name in names:
        assert pkgutil.resolve_name(name), name


@pytest.mark.parametrize("folder", sorted(PEERS))
def test_what_is_found_by_being_there_is_listed_nowhere(folder):
    """No file names a file of such a folder, and they do not know each other."""
    finder = {m for m, found in found_by_name().items() if any(n.startswith(folder) for n in found & KNOWN)}
    assert finder, f"no module finds the files of {folder}"
    for name, others in arrows().items():
        named = [o for o in others if o.startswith(f"{folder}.")]
        assert not named or name in finder, f"{name} names {named}"
    assert not list(imported(SRC / folder.replace(".", "/") / "__init__.py"))


def test_an_effect_knows_of_effect_alone():
    for name, others in arrows().items():
        if name.startswith("synthcam.effects."):
            assert {o for o in others if o.startswith("synthcam")} == {"synthcam.effect"}, name


def test_slow_parts_of_scipy_are_not_loaded():
    """scipy.signal loads scipy.stats, which takes half a second of the start of every command."""
    slow = ("scipy.stats", "scipy.signal")
    assert [module(path) for path in FILES if any(name.startswith(slow) for name in imported(path))] == []


def test_files_are_named_after_what_they_hold():
    vague = {"utils", "helpers", "types", "base", "constants", "common", "misc"}
    assert [module(path) for path in FILES if path.stem in vague] == []


def test_folders_stay_small():
    limits = {"effects": 60, "laws": 60}  # an effect or a free law is a file
    sizes = Counter(path.parent for path in FILES if path.name != "__init__.py")
    assert [str(folder) for folder, size in sizes.items() if size > limits.get(folder.name, 18)] == []
