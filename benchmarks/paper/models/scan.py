"""The wide scan: each candidate solved, read as the paper reads, its r, C and mu fitted to what the paper prints.

Motions are solved, not filmed, and get noise as the tracker has it; `contradictions` films the leading ones.
"""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import synthcam
from benchmarks.paper import experiment
from benchmarks.paper.models import candidates
from benchmarks.paper.models.candidates import BASE, Candidate
from benchmarks.paper.models.observed import WAYS, chi2, observed, pulls
from benchmarks.paper.published import OBSERVED
from benchmarks.paper.readings import Films, read
from synthcam.dynamics.batch import solve_collisions
from synthcam_shared.jobs import run_all_jobs
from synthcam_shared.outputs import write_atomically

Floats = NDArray[np.float64]
NOISE = 1.4e-6  # m, each axis: .0087 px, what the tracker leaves on such films
EXPOSURE, DIAMETER = 5e-4, 2.38e-3
BASE_NUMBERS = ("restitution", "spin_transfer", "sliding_friction")
QUICK = ("base", "hop", "mass_mismatch", "hop + mass_mismatch")
KEPT = "scan.json"  # of the output: all rows
START = np.array([0.903, 0.347, 0.232])
STEPS = np.array([0.02, 0.02, 0.02])
LEAST, MOST = np.array([0.3, 0.02, 0.03]), np.array([1.0, 0.7, 1.0])
LOOSE = np.array([0.1, 0.3, 0.2])  # of r, C, mu about their start: what no reading bears on stays where it is
CLOSE = np.array([1e-3, 1e-3, 2e-3])
ROUNDS = 3
Values: TypeAlias = dict[str, float]
Shown: TypeAlias = Callable[[Floats], list[Values]]


@dataclass(frozen=True)
class Launches:
    """The launches of all collisions, (n, 6) as the batch takes them, and the rows of each series."""

    table: Floats
    rows: dict[str, slice]


def launches(quick: bool) -> Launches:
    """Those of the filmed series."""
    table: list[list[float]] = []
    rows: dict[str, slice] = {}
    for name in experiment.OF_MODELS:
        series = experiment.SERIES[name]
        series = experiment.smaller(series) if quick else series
        for number in range(series.clips):
            drawn = series.scene(number).draw(number, seed=experiment.SEED).drawn
            launch = drawn["launch"]
            t_c = drawn["timing"]["contact_frame"] / experiment.FPS
            table.append([*launch["contact"], t_c, launch["v0"], launch["heading"], launch["b"]])
        rows[name] = slice(len(table) - series.clips, len(table))
    return Launches(np.array(table, dtype=np.float64), rows)


def solve_launches(values: dict[str, float], of: Launches) -> dict[str, pd.DataFrame]:
    """Readings of each series under a model. Raises ValueError where it has no motion."""
    starts = np.arange(experiment.FRAMES - 1) / experiment.FPS
    end = experiment.FRAMES / experiment.FPS
    positions = solve_collisions(synthcam.Model().replace(values), of.table, 0.0, end).average_centres(starts, EXPOSURE)
    noisy = positions + np.random.default_rng(1).normal(0, NOISE, positions.shape)
    table = read(Films(noisy, experiment.FPS, DIAMETER))
    return {name: table.iloc[rows].reset_index(drop=True) for name, rows in of.rows.items()}


@dataclass(frozen=True)
class PaperFit:
    """A candidate compared with the paper in one way of reading: chi^2, its best base numbers, and what it predicts."""

    candidate: Candidate
    way: tuple[str, str]
    chi2: float
    numbers: tuple[float, float, float]
    values: dict[str, float]


def fit_candidate(candidate: Candidate, of: Launches, ways: Sequence[tuple[str, str]] = WAYS) -> list[PaperFit]:
    """The candidate with the r, C and mu that suit the paper best, in each way of reading; [] where it cannot be."""

    def shown(numbers: Floats) -> list[dict[str, float]]:
        tables = solve_launches(dict(zip(BASE_NUMBERS, map(float, numbers), strict=True)) | dict(candidate.values), of)
        return [observed(tables, way) for way in ways]

    try:
        first = shown(START)
        moved = [shown(START + STEPS * (np.arange(3) == k)) for k in range(3)]
        return [
            _fitted(candidate, shown, index, (first[index], [m[index] for m in moved])) for index in range(len(ways))
        ]
    except (ValueError, np.linalg.LinAlgError):
        return []


def _fitted(candidate: Candidate, shown: Shown, index: int, start: tuple[Values, list[Values]]) -> PaperFit:
    """The best r, C and mu: a few steps with the slopes at the start, which are all but constant."""
    here = start[0]
    slope = np.column_stack([(pulls(m) - pulls(here)) / step for m, step in zip(start[1], STEPS, strict=True)])
    rows, at = np.vstack([slope, np.diag(1 / LOOSE)]), START
    best = chi2(here), at, here
    for _ in range(ROUNDS):
        goal = np.concatenate([-pulls(here), (START - at) / LOOSE])
        step = np.linalg.lstsq(rows, goal, rcond=None)[0]
        at = np.clip(at + step, LEAST, MOST)
        here = shown(at)[index]
        if chi2(here) < best[0]:
            best = chi2(here), at, here
        if np.all(np.abs(step) < CLOSE):
            break
    r, c, mu = map(float, best[1])
    return PaperFit(candidate, WAYS[index], best[0], (r, c, mu), best[2])


def scan(output: Path, workers: int, quick: bool, progress: Callable[[int, int], None]) -> pd.DataFrame:
    """All effects of motion alone, then with the hop: a row for each candidate and way of reading, kept in output."""
    folder = output / f"scan.{_settings(quick)}"
    folder.mkdir(parents=True, exist_ok=True)
    effects = candidates.physical()
    names = ["base", *effects, *(f"hop + {name}" for name in effects if name != "hop")]
    names = list(QUICK) if quick else names
    todo = [n for n, name in enumerate(names) if not (folder / f"{name}.json").exists()]
    progress(len(names) - len(todo), len(names))
    task = functools.partial(_scan_one, names, folder, quick)
    for done, _ in enumerate(run_all_jobs(task, todo, workers, folder), 1):
        progress(len(names) - len(todo) + done, len(names))
    rows = [row for name in names for row in json.loads((folder / f"{name}.json").read_text())]
    write_atomically(output / KEPT, json.dumps(rows))
    return pd.DataFrame(rows)


def _settings(quick: bool) -> str:
    """A name for all that decides what the scan finds, but for the code."""
    tried = [candidate for effect in candidates.physical() for candidate in candidates.sizes_of(effect)]
    said = f"{tried} {HOP} {OBSERVED} {WAYS} {launches(quick).table.tolist()} {NOISE} {ROUNDS}"
    return hashlib.sha256(said.encode()).hexdigest()[:8]


def _scan_one(names: list[str], folder: Path, quick: bool, index: int) -> int:
    name, of = names[index], launches(quick)
    if name == "base":
        tried = [BASE]
    elif name.startswith("hop + "):
        tried = [HOP + c for c in candidates.sizes_of(name.removeprefix("hop + "))]
    else:
        tried = list(candidates.sizes_of(name))
    found = [h for candidate in tried for h in fit_candidate(candidate, of)]
    rows = [
        {
            "name": h.candidate.name,
            "words": h.candidate.words(),
            "extra": h.candidate.extra,
            "effects": dict(h.candidate.values),
            "window": h.way[0],
            "balls": h.way[1],
            "chi2": h.chi2,
            **dict(zip(BASE_NUMBERS, h.numbers, strict=True)),
            "values": h.values,
        }
        for h in found
    ]
    write_atomically(folder / f"{name}.json", json.dumps(rows))
    return index


HOP = Candidate("hop", (("hop.share", 1.0), ("hop.bounce", 0.4)), 1)  # its typical self
