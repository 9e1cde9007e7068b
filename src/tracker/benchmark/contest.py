"""A contest of trackers on a suite: run, score and compare them. Finished steps are kept after an interruption."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from synthcam_shared.jobs import Progress, run_all_jobs
from synthcam_shared.outputs import open_resumable
from tracker.benchmark.judging.entry import make_entry
from tracker.benchmark.judging.tracker_results import TrackerResults
from tracker.benchmark.report.leaderboard import ENTRIES, name_entry_file, read_entries, write_entry, write_leaderboard
from tracker.benchmark.report.page import write_report
from tracker.benchmark.suite.folder import Suite
from tracker.benchmark.trackers import RUN_HERE, Entrant, describe_tracker_run, make_entrants, run_tracker
from tracker.results import load_json

RESULTS, SUITE = "results", "suite"


def run_contest(
    suite: Suite,
    report: Path,
    names: str = "",
    how: str = "tracker benchmark run",
    progress: Progress = lambda done, of: None,
    scheduler: str = "",
) -> tuple[list[Mapping[str, Any]], list[str]]:
    """Run trackers on a suite, score them, and write the leaderboard and the page.

    The suite has its truth, which no tracker gets. Earlier entries of the report stay. `names` are separated by commas;
    the default is the list of the suite. `how` is the command that made the page. `progress` takes the number of
    finished steps and of all steps. `scheduler` is the address of a Dask scheduler, whose workers see the same folders
    and have the same packages. Returns all entries of the report, the best first, and a line for each tracker that was
    left out. Raises InputError.
    """
    if scheduler:  # the workers may stand elsewhere
        suite, report = replace(suite, path=suite.path.resolve(), truth=suite.truth.resolve()), report.resolve()
    chosen, notes = make_entrants(suite, names)
    with open_contest_report(report):
        (report / RESULTS).mkdir(exist_ok=True)
        steps, found = 2 * len(chosen), []
        for number, one in enumerate(chosen, 1):
            found.append(run_tracker(suite, one, report / RESULTS / one.name, scheduler=scheduler))
            progress(number, steps)
        todo = [k for k, one in enumerate(chosen) if not _has_score(report, suite, one.name)]
        task = partial(_make_entry, suite, chosen, found, report)
        for done, scored in enumerate(run_all_jobs(task, todo, 0, report, scheduler), 1):
            write_entry(report, scored)
            progress(len(chosen) + len(chosen) - len(todo) + done, steps)
        whole = write_contest_report(suite, report, how)
    return whole, notes


def write_contest_report(suite: Suite, report: Path, how: str) -> list[Mapping[str, Any]]:
    """Write the leaderboard and the page after a contest, with all entries of a report."""
    whole = read_entries(report, suite.about)
    write_leaderboard(report, whole)
    write_report(report, whole, suite.definition, suite.about, how)
    return whole


def open_contest_report(report: Path) -> AbstractContextManager[None]:
    """Lock the folder of a contest's report. Raises InputError where it holds other files."""
    maker = "tracker benchmark"  # both `run` and `submit` add to it
    return open_resumable(report, maker, "a new folder for the report")


def _has_score(report: Path, suite: Suite, name: str) -> bool:
    path = report / ENTRIES / name_entry_file(name)
    if not path.is_file():
        return False
    there = load_json(path)
    own = (there["tracker"]["name"], there["tracker"]["made"]) == (name, RUN_HERE)
    return own and there["suite"]["truth_sha256"] == suite.about["truth_sha256"]


def _make_entry(
    suite: Suite, chosen: list[Entrant], found: list[TrackerResults], report: Path, k: int
) -> dict[str, Any]:
    return make_entry(suite, found[k], describe_tracker_run(chosen[k], report / RESULTS / chosen[k].name))
