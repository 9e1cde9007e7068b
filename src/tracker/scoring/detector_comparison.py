"""Comparison of several detectors on one dataset, with the same linking, fits and truth, in one report."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from synthcam_shared.errors import InputError
from synthcam_shared.jobs import Progress
from synthcam_shared.outputs import open_resumable
from synthcam_shared.report.numbers import format_number
from synthcam_shared.report.page import PageSection, PageTable, write_page
from tracker import results
from tracker.detection.detect import detector_name, load_detector
from tracker.pipeline import run
from tracker.scoring.score import DetectorScore, score
from tracker.scoring.score_page import POSITION_HEADS, format_positions


def compare(
    dataset: Path, names: Sequence[str], report: Path, progress: Progress = lambda done, of: None
) -> dict[str, Any]:
    """Track a dataset with several detectors, in one process, and write REPORT/score.json and index.html.

    Results are kept in REPORT/results/NAME; the same call continues after an interruption. `progress` takes the
    number of finished clips and of all clips. Returns the contents of score.json. Raises InputError, before any work,
    where a detector or the truth does not exist or REPORT holds other files.
    """
    chosen = [name.strip() for name in names if name.strip()]
    if not chosen or len(set(chosen)) < len(chosen):
        raise InputError("--detectors: expected different names, separated by commas: maximum_likelihood,centroid")
    for name in chosen:
        load_detector(name)
    known = dataset / "truth" / "clips.parquet"
    if not known.is_file():
        raise InputError(f"{known}: no such file, expected a dataset with its truth")
    with open_resumable(report, "tracker compare", "a new folder for the report"):
        (report / "results").mkdir(exist_ok=True)

        def show(before: int, done: int, clips: int) -> None:
            progress(before * clips + done, len(chosen) * clips)

        scores = [_track_and_score(dataset, name, report, partial(show, k)) for k, name in enumerate(chosen)]
        whole = scores[0].to_dict()
        for other in scores[1:]:
            whole["detectors"] |= other.to_dict()["detectors"]
        summary = (
            f"Dataset {whole['suite']}. All detectors have the same linking and the same fits, in one process; the "
            "time per frame includes everything from the file to the estimates."
        )
        sections = [PageSection("", make_comparison_tables(whole["detectors"]))]
        write_page(report / "index.html", "Comparison of detectors", sections, "tracker compare", [summary])
        results.write_json(report / "score.json", whole)
    return whole


def _track_and_score(dataset: Path, name: str, report: Path, progress: Progress) -> DetectorScore:
    folder = report / "results" / detector_name(name)
    started = time.perf_counter()
    outcome = run(dataset, folder, name, 1, progress)
    known = report / "results" / f"{detector_name(name)}.times.json"
    if outcome.frames:
        results.write_json(known, {"ms_per_frame": 1e3 * (time.perf_counter() - started) / outcome.frames})
    spent = results.load_json(known)["ms_per_frame"] if known.is_file() else None
    return score(folder, dataset, detector_name(name), spent)


def make_comparison_tables(detectors: dict[str, Any]) -> list[PageTable]:
    """Make the tables of a comparison of detectors: positions and speed, tracks, and errors of quantities."""
    positions = [
        [name, *format_positions(d["localisation"]), format_number(d["ms_per_frame"])] for name, d in detectors.items()
    ]
    measures = sorted({k for d in detectors.values() for k in d["tracking"]})
    tracks = [[name, *(format_number(d["tracking"].get(k), 5) for k in measures)] for name, d in detectors.items()]
    names = ("r", "tau1", "tau2", "mu_k", "C", "energy_fraction")
    quantities = []
    for name, d in detectors.items():
        found = [d["quantities"].get(k, {}) for k in names]
        quantities.append([name, *(f"{format_number(q.get('rmse'))} ({q.get('n', 0)})" for q in found)])
    bound = "Errors of x and y. Bound: Cramér-Rao bound. The ratio has its sampling error in brackets."
    tied = "Root mean square error in SI units, and in brackets the number of clips."
    return [
        PageTable(["detector", *POSITION_HEADS, "ms per frame"], positions, "Positions", bound),
        PageTable(["detector", *measures], tracks, "Tracks, gate 5 px"),
        PageTable(["detector", *names], quantities, "Quantities, tied fit", tied),
    ]
