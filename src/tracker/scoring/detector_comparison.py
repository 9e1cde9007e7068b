"""Several detectors on one dataset: the same linking, fits and truth, one report."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from synthcam_shared.errors import InputError
from synthcam_shared.outputs import as_input_error, check_writable, lock_folder, write_atomically
from tracker import results
from tracker.detection.detect import load_detector
from tracker.pipeline import run
from tracker.report.html import describe_creation, render
from tracker.scoring.score import DetectorScore, score

TIMES = "times.json"
LOCALISATION = ("n", "missed", "false", "rmse_px", "bound_px", "ratio", "phase_bias_px")
QUANTITIES = ("r", "tau1", "tau2", "mu_k", "C", "energy_fraction")
Progress = Callable[[int, int], None]


def compare(
    dataset: Path, names: Sequence[str], report: Path, progress: Progress = lambda done, of: None
) -> dict[str, Any]:
    """Track a dataset with several detectors, in one process, and write REPORT/score.json and index.html.

    Results are kept in REPORT/results/NAME: interrupted, the same call goes on.

    Parameters
    ----------
    dataset : Path
        Clips with their truth.
    names : sequence of str
        Of the detectors.
    report : Path
        REPORT.
    progress : callable
        Takes clips done and clips in all.

    Returns
    -------
    dict
        The contents of score.json.

    Raises
    ------
    InputError
        Before anything is done, where a detector is not there, or REPORT holds something else.
    """
    chosen = [name.strip() for name in names if name.strip()]
    if not chosen or len(set(chosen)) < len(chosen):
        raise InputError(
            "--detectors: expected different names with commas between them, as maximum_likelihood,centroid"
        )
    for name in chosen:
        load_detector(name)
    known = dataset / "truth" / "clips.parquet"
    if not known.is_file():
        raise InputError(f"{known}: no such file, expected a dataset with its truth")
    if report.exists() and not (report.is_dir() and (not any(report.iterdir()) or (report / "results").is_dir())):
        raise InputError(f"{report}: exists and holds something else, expected a new folder for the report")
    report = report.resolve()
    check_writable(report)
    with lock_folder(report), as_input_error(report, "; the same command goes on where it stopped"):
        (report / "results").mkdir(exist_ok=True)
        scores = []
        for k, name in enumerate(chosen):
            scores.append(_track_and_score(dataset, name, report, partial(_report_progress, progress, k, len(chosen))))
        whole = scores[0].to_dict()
        for other in scores[1:]:
            whole["detectors"] |= other.to_dict()["detectors"]
        values = {
            "suite": whole["suite"],
            "tables": tables(whole["detectors"]),
            "made": describe_creation("tracker compare"),
        }
        html = render(Path(__file__).with_name("compare.html"), **values)
        write_atomically(report / "index.html", html)
        results.write_json(report / "score.json", whole)
    return whole


def _report_progress(progress: Progress, k: int, of: int, done: int, clips: int) -> None:
    progress(k * clips + done, of * clips)


def _track_and_score(dataset: Path, name: str, report: Path, progress: Progress) -> DetectorScore:
    folder = report / "results" / name
    started = time.perf_counter()
    outcome = run(dataset, folder, None, name, 1, progress)
    if outcome.frames:
        note = {"ms_per_frame": 1e3 * (time.perf_counter() - started) / outcome.frames}
        results.write_json(report / "results" / f"{name}.{TIMES}", note)
    known = report / "results" / f"{name}.{TIMES}"
    spent = json.loads(known.read_text(encoding="utf-8"))["ms_per_frame"] if known.is_file() else None
    return score(folder, dataset, name, spent)


def tables(detectors: dict[str, Any]) -> list[tuple[str, list[str], list[list[str]]]]:
    """Title, heads and rows of text: positions and speed, tracks, and quantities by their rmse over the bound."""
    localised = [
        [name, *(_text(d["localisation"][k]) for k in LOCALISATION), _text(d["ms_per_frame"])]
        for name, d in detectors.items()
    ]
    kinds = sorted({k for d in detectors.values() for k in d["tracking"]})
    tracks = [[name, *(_text(d["tracking"].get(k), 5) for k in kinds)] for name, d in detectors.items()]
    claims = [
        [name, *(f"{_text(q.get('rmse'))} ({q.get('n', 0)})" for q in (d["quantities"].get(k, {}) for k in QUANTITIES))]
        for name, d in detectors.items()
    ]
    return [
        ("Positions, px, per axis; ms a frame", ["detector", *LOCALISATION, "ms"], localised),
        ("Tracks, gate 5 px", ["detector", *kinds], tracks),
        ("Tied fit: rmse of each quantity, SI, and of how many clips", ["detector", *QUANTITIES], claims),
    ]


def _text(value: float | None, digits: int = 3) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    return str(value) if isinstance(value, int) else f"{value:.{digits}g}"
