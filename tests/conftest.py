"""Property tests draw the same cases everywhere, HYPOTHESIS_PROFILE=random new ones.

With `--dist loadfile` the tests of a file run in one process, and so do those of all files that share searches, a suite
of benchmarks or recorded collisions. These begin, and files of many small tests end a run, so that both processes end
together.
"""

import contextlib
import functools
import gc
import importlib
import os
import re
import sys
from pathlib import Path

import pytest
import typer.main
from hypothesis import settings
from hypothesis.internal.conjecture import providers
from report_pages import undrawn

import synthcam.library as effects_module

# What the helpers make once a process: the files of tests that import it run in the same one.
SHARED = {
    "searches": re.compile(r"^from discrepancy_\w+ import .*\b(searched|outsider)\b", re.MULTILINE),
    "suites": re.compile(r"^from benchmark_suite import .*\b(suite|simulated)\b", re.MULTILINE),
    "records": re.compile(r"^from discrepancy_files import", re.MULTILINE),
}

settings.register_profile("same", derandomize=True, deadline=None, max_examples=40)
settings.register_profile("random", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))
# Hypothesis would draw constants from the source of all modules loaded: each process would draw cases of its own.
providers._get_local_constants = lambda: providers._local_constants
# A process runs one command; here it runs hundreds, and all would make the tree of commands and options again.
typer.main.get_command = functools.cache(typer.main.get_command)
gc.disable()  # while tests are collected nothing becomes garbage


def pytest_configure(config):
    """Import the tests from the last on in the second of two processes.

    In a fresh clone both compile tests and packages. So they meet half-way, and each finds what the other has compiled.
    """
    here = Path(__file__).parent
    worker = getattr(config, "workerinput", {}).get("workerid")
    if worker == "gw1" and [Path(config.rootpath, path) for path in config.args] == [here]:
        for path in sorted(here.rglob("test_*.py"), reverse=True):
            with contextlib.suppress(Exception, pytest.skip.Exception):  # collection reports it
                importlib.import_module(".".join(path.relative_to(config.rootpath).with_suffix("").parts))


def pytest_collection_finish():
    """Modules and collected tests stay: the garbage collector need not look at them again and again."""
    gc.freeze()
    gc.set_threshold(20_000)  # at the 700 of Python it runs so often that it takes a hundredth of the time
    gc.enable()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    if config.option.dist != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    shared = {}
    for path in Path(__file__).parent.rglob("test_*.py"):
        text = path.read_text()
        scopes = [scope for scope, imports in SHARED.items() if imports.search(text)]
        shared |= {path.relative_to(config.rootpath).as_posix(): scope for scope in scopes[:1]}

    class Sharing(LoadFileScheduling):
        def _split_scope(self, nodeid):
            path = super()._split_scope(nodeid)
            return shared.get(path, path)

        def _assign_work_unit(self, node):
            first = min(self.workqueue, key=lambda scope: (scope not in SHARED, len(self.workqueue[scope])))
            self.workqueue.move_to_end(first, last=False)
            super()._assign_work_unit(node)

    return Sharing(config, log)


@pytest.fixture
def unfitted(monkeypatch):
    """For tests of what is seen in films: collisions are found and not fitted, which would take most of the time."""
    for name in ("fit_collision", "fit_lasting_collision"):
        monkeypatch.setattr(f"tracker.measurement.estimate.{name}", lambda *_: "not fitted")


@pytest.fixture(name="undrawn")
def leave_figures_undrawn():
    """For tests of what else a page or a command gives."""
    with undrawn():
        yield


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A folder for effects; what a test adds of it is forgotten afterwards."""
    monkeypatch.setattr(effects_module, "_folders", {})
    for forget in effects_module._forget:
        forget()
    yield tmp_path
    monkeypatch.undo()
    for forget in effects_module._forget:
        forget()
    for name in [n for n in sys.modules if n.startswith("synthcam_effects_of_a_folder")]:
        del sys.modules[name]


@pytest.fixture
def not_local(monkeypatch):
    """For tests of the tied and the free fit: nothing is estimated locally, which takes a third of the time."""
    monkeypatch.setattr("tracker.measurement.estimate.estimate_locally", lambda *_: "not estimated")
