"""Comparison of candidate effects with the numbers of the paper, films of the leading ones, and a plan."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import discrepancy
from benchmarks.paper import experiment
from benchmarks.paper.models import scan
from benchmarks.paper.models.observed import WAYS, chi2, observed
from benchmarks.paper.results import Results
from synthcam import Scene

SINGLES, PAIRS = 4, 2  # leading models that are filmed beside base and hop
PLAIN = ("4 ms", "both")
PLAN_CLIPS = 30
DECIDE = ("hop", "mass_mismatch", "ball_friction", "velocity_restitution", "friction_mismatch")


@dataclass(frozen=True)
class Leader:
    """A model that was filmed: its row of the scan, as the paper's words have it."""

    name: str
    words: str
    numbers: dict[str, float]

    @property
    def folder(self) -> str:
        """Of its series."""
        return self.name.replace(" + ", "_and_")


def best_of(table: pd.DataFrame) -> pd.DataFrame:
    """A row a model: chi^2 in each way at its best size, and score, lower where likelier.

    The score is the mean likelihood over the ways as a chi^2, with 2 for each number that was chosen.
    """
    rows = []
    for name, mine in table.groupby("name", sort=False):
        least = np.array([mine.loc[(mine["window"] == w) & (mine["balls"] == b), "chi2"].min() for w, b in WAYS])
        best = _plain(mine)
        score = least.min() - 2 * np.log(np.exp(-(least - least.min()) / 2).mean()) + 2 * best["extra"]
        row: dict[Any, Any] = {"name": name, "words": best["words"], "score": float(score), "extra": int(best["extra"])}
        rows.append(row | dict(zip(map(", ".join, WAYS), least, strict=True)))
    return pd.DataFrame(rows).sort_values("score", ignore_index=True)


def _plain(mine: pd.DataFrame) -> Any:
    """A model's best row where the paper is read as its words have it: early, and the spins of both balls."""
    kept = mine[(mine["window"] == PLAIN[0]) & (mine["balls"] == PLAIN[1])]
    return kept.iloc[int(kept["chi2"].argmin())]


def leaders(table: pd.DataFrame) -> list[Leader]:
    """Hop, the likeliest single effects by score and by chi^2 as the paper's words have it, the likeliest pairs so."""
    ranked = best_of(table)
    plain = ranked.sort_values(", ".join(PLAIN))
    singles: list[str] = []
    pairs: list[str] = []
    for order in (plain, ranked):
        alone = [str(n) for n in order["name"] if " + " not in str(n) and n not in ("base", "hop", *singles)]
        singles += alone[: SINGLES // 2]
        pairs += [str(n) for n in order["name"] if " + " in str(n) and n not in pairs][: PAIRS // 2]
    names = ["hop", *singles, *pairs]
    return [_leader(table, name) for name in names if name in set(table["name"])]


def _leader(table: pd.DataFrame, name: str) -> Leader:
    row = _plain(table[table["name"] == name])
    base = {n: float(row[n]) for n in scan.BASE_NUMBERS}
    return Leader(name, str(row["words"]), base | {k: v for k, v in row["effects"].items() if v is not None})


def film(leader: Leader, output: Path, workers: int, quick: bool, progress: Callable[[int, int], None]) -> None:
    """Its collisions through video and tracker."""
    for name in experiment.OF_MODELS:
        series = experiment.SERIES[name]
        series = experiment.smaller(series) if quick else series
        experiment.film(series.of(leader.folder, leader.numbers), output, workers, progress)


def read_model(results: Results, folder: str) -> dict[str, float]:
    """Numbers that the films of a model show, in all ways of reading."""
    read = results.readings(folder)
    out = observed(read, ("6 ms", "both"))
    for window, balls in WAYS:
        these = observed(read, (window, balls))
        out[f"r, differences at {window}"] = these["r, differences"]
        out[f"slope of r at {window}"] = these["slope of r"]
        out[f"C, spins, {balls}, {window}"] = these["C, spins"]
        out[f"chi2, {balls}, {window}"] = chi2(these)
    for window in ("4 ms", "6 ms", "8 ms"):
        out[f"C, spins, striker, {window}"] = float(read["spins"][f"C_striker {window}"].mean())
        out[f"kept {window}"] = float(read["histogram"][f"kept {window}"].mean())
    return out


def plan(output: Path, quick: bool = False) -> dict[str, Any]:
    """Which recording would decide: `discrepancy plan` for the paper's scene and the effects in question, made once."""
    path = output / "plan.json"
    if not path.exists():
        made = discrepancy.plan(
            Scene.read("painter_behringer"),
            effects=list(DECIDE[:2] if quick else DECIDE),
            clips=8 if quick else PLAN_CLIPS,
        )
        document = made.document() | {"said": made.sentence()}
        path.with_suffix(".aside").write_text(json.dumps(document))
        path.with_suffix(".aside").replace(path)
    loaded: dict[str, Any] = json.loads(path.read_text())
    return loaded
