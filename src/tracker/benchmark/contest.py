"""A contest of trackers on a suite: those that run here, and submitted tables of a tracker in any language.

Finished steps are kept after an interruption.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from synthcam_shared.errors import InputError
from synthcam_shared.jobs import Progress, run_all_jobs
from synthcam_shared.outputs import open_resumable
from synthcam_shared.settings import did_you_mean
from tracker.benchmark.judging.entry import make_entry
from tracker.benchmark.judging.tracker_results import ClipSample, TrackerResults, take_clip
from tracker.benchmark.report.leaderboard import ENTRIES, name_entry_file, read_entries, write_entry, write_leaderboard
from tracker.benchmark.report.page import write_report
from tracker.benchmark.suite.definition import Suite
from tracker.benchmark.trackers import RUN_HERE, Entrant, describe_tracker_run, make_entrants, run_tracker
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.recording import Result, measure_tracks
from tracker.results import load_json
from tracker.tables.read import read_tracks
from tracker.tables.table_options import POINTS

RESULTS, SUITE = "results", "suite"
TABLES = (".csv", ".parquet", ".txt", ".xml")  # endings of submitted tables


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
    the default is the list of the suite. `how` is the command that made the page. The workers of a Dask `scheduler` see
    the same folders and have the same packages. Returns all entries of the report, the best first, and a line for each
    tracker that was left out. Raises InputError.
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


def score_submission(
    suite: Suite, folder: Path, report: Path, how: str, progress: Progress = lambda done, of: None
) -> tuple[list[Mapping[str, Any]], list[str]]:
    """Score a submission and add it to a report, which is made where it is missing.

    FOLDER has submission.json, which needs only `name`. It also has each film's tracks, in one of two forms. FILM.csv
    or FILM.parquet is a table with a column `clip`. FILM/NNNNNN.EXT are files of one clip each, in any format that
    `tracker measure` reads.

    Only sums over clips of the suite's truth go into the report. `how` is the command that made the page. `progress`
    takes the number of finished films and of all films. Returns all entries of the report, the best first, and notes on
    films and clips without a table. Raises InputError for a wrong submission.json or table, and where no table has a
    position.
    """
    about = read_submission_form(folder)
    found, notes = read_tables(suite, folder, about.get("point", "centre"), progress)
    with open_contest_report(report):
        write_entry(report, make_entry(suite, found, {**about, "made": "submitted"}))
        return write_contest_report(suite, report, how), notes


def read_submission_form(folder: Path) -> dict[str, Any]:
    """Read submission.json. Raises InputError."""
    path = folder / "submission.json"
    if not path.is_file():
        raise InputError(f"{path}: no such file, expected a submission: submission.json and a table for each film")
    about = load_json(path)
    if not isinstance(about, dict) or not isinstance(about.get("name"), str) or not about["name"].strip():
        raise InputError(f"{path}: name: expected the tracker's name")
    if len(about["name"]) > 60 or not about["name"].isprintable():
        raise InputError(f"{path}: name: expected one line of at most 60 characters")
    keys = ("name", "authors", "url", "version", "licence", "point", "ms_per_frame", "machine", "notes")
    for key, value in about.items():
        if key not in keys:
            near = did_you_mean(key, keys)
            raise InputError(f"{path}: {key}: unknown, expected one of {', '.join(keys)}{near}")
        number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and value > 0
        if key == "ms_per_frame" and not (value is None or number):
            raise InputError(f"{path}: ms_per_frame: expected a number over 0, not {value!r}")
    if about.get("point", "centre") not in POINTS:
        raise InputError(f"{path}: point: expected {' or '.join(POINTS)}, not {about['point']!r}")
    return about


def read_tables(
    suite: Suite, folder: Path, point: str, progress: Progress = lambda done, of: None
) -> tuple[TrackerResults, list[str]]:
    """Read the tables of a submission, measure each clip with its camera, and list missing tables.

    Films of crowds without any table are left out of the entry.
    """
    found: dict[tuple[str, int], Result] = {}
    notes, absent = [], []
    crowds = {suite.parts[name].film for name in suite.definition.crowds}
    films = dict.fromkeys(part.film for part in suite.parts.values())
    _check_names(folder, list(films))
    for number, film in enumerate(films, 1):
        clips = sorted({clip for part in suite.parts.values() if part.film == film for clip in part.clips})
        camera = {clip: suite.camera(film, clip) for clip in clips}
        given = dict(_read_given(folder, film, camera))
        if strange := sorted(set(given) - set(clips)):
            raise InputError(
                f"{folder}: {film}: clip {strange[0]}: not in the suite, expected {clips[0]} to {clips[-1]}"
            )
        for clip, tracks in given.items():
            own = "centre" if camera[clip].matte else point
            found[film, clip] = measure_tracks(tracks, camera[clip], clip, own)
        if film in crowds and not given:
            absent.append(film)
            notes.append(f"{film}: no table, so the entry has no figures of these crowds")
        elif missing := len(clips) - len(given):
            notes.append(f"{film}: no table of {missing} of {len(clips)} clips, which count as not found")
        progress(number, len(films))
    if not any(len(result.tracks) for result in found.values()):
        raise InputError(f"{folder}: no position in any table, expected the balls of {', '.join(films)}")
    return TrackerResults(partial(take_clip, found), ClipSample(without=tuple(absent))), notes


def _check_names(folder: Path, films: list[str]) -> None:
    """Raise InputError where a table, or a folder of tables, does not have the name of a film."""
    given = [p for p in sorted(folder.iterdir()) if p.suffix in TABLES or (p.is_dir() and not p.name.startswith("."))]
    for path in given:
        name = path.name if path.is_dir() else path.stem
        if name not in films:
            near = did_you_mean(name, films)
            raise InputError(f"{path}: not named after a film, expected {', '.join(films)}{near}")
    if not given:
        raise InputError(
            f"{folder}: no table, expected FILM.csv or FILM.parquet, or a folder FILM, of {', '.join(films)}"
        )


def _read_given(folder: Path, film: str, camera: Mapping[int, Camera]) -> Iterator[tuple[int, Tracks]]:
    """Yield clip and tracks for each table of a film."""
    whole = [path for ending in TABLES if (path := folder / f"{film}{ending}").is_file()]
    for path in whole[:1]:
        if path.suffix == ".csv" and len(camera) > 1:
            _check_clips(path)
        for clip, (tracks, _) in read_tracks(path, next(iter(camera.values()))).clips.items():
            yield clip, tracks
        return
    for path in sorted((folder / film).glob("*")) if (folder / film).is_dir() else []:
        if path.suffix in TABLES:
            if not path.stem.isdecimal() or int(path.stem) not in camera:
                raise InputError(f"{path}: not named after a clip of {film}, expected NNNNNN{path.suffix}")
            clip = int(path.stem)
            for tracks, _ in read_tracks(path, camera[clip]).clips.values():
                yield clip, tracks


def _check_clips(path: Path) -> None:
    """A table of a film with several clips says which clip a row is of. Raises InputError."""
    with path.open(encoding="utf-8", errors="replace") as stream:
        names = [name.strip().strip('"') for name in stream.readline().split(",")]
    if {"frame", "x", "y"} <= set(names) and "clip" not in names:
        raise InputError(f"{path}: no column clip, expected clip, frame, particle, x, y; found {', '.join(names)}")
