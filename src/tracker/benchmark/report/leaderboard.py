"""The leaderboard: all entries of a report, the best first, as leaderboard.csv."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from synthcam_shared.errors import InputError
from synthcam_shared.outputs import write_atomically
from tracker.benchmark.judging.crowds import summarise_crowds
from tracker.benchmark.suite.definition import DIGEST_WITHOUT_CROWDS
from tracker.results import load_json, write_json

ENTRIES = "entries"
Entry = Mapping[str, Any]
Entries = Sequence[Entry]


def name_entry_file(name: str) -> str:
    """Make the name of an entry's file in REPORT from the name of any tracker."""
    kept = "".join(c if c.isalnum() or c in "-_+." else "_" for c in name).strip(".")
    return f"{kept or 'tracker'}.json"


def write_entry(report: Path, entry: Entry) -> None:
    """Write REPORT/entries/NAME.json. Raises InputError where it is the entry of another tracker."""
    name, made = entry["tracker"]["name"], entry["tracker"]["made"]
    path = report / ENTRIES / name_entry_file(name)
    if path.is_file():
        there = load_json(path)["tracker"]
        if (there["name"], there["made"]) != (name, made):
            raise InputError(f"{path}: is of {there['name']!r}, {there['made']}; expected another name than {name!r}")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, entry)


def read_entries(report: Path, suite: Mapping[str, Any]) -> list[Entry]:
    """Read all entries of a report, the best first.

    An entry of a suite without crowds stays if its films are those of this suite. Raises InputError for an entry of
    another suite.
    """
    found = []
    for path in sorted((report / ENTRIES).glob("*.json")):
        one = load_json(path)
        if not isinstance(one, dict) or not {"tracker", "suite", "parts", "score"} <= set(one):
            raise InputError(f"{path}: damaged, expected an entry of `tracker benchmark`")
        if one["suite"]["truth_sha256"] not in (suite["truth_sha256"], suite.get(DIGEST_WITHOUT_CROWDS)):
            other = one["suite"]["version"]
            raise InputError(f"{path}: scores another suite (version {other}); expected a report of its own")
        found.append(one)
    return sorted(found, key=lambda one: (-(one["score"] or 0.0), one["tracker"]["name"]))


def make_leaderboard_row(rank: int, one: Entry) -> dict[str, Any]:
    """Make a line of the leaderboard by column."""
    parts = one["parts"].values()
    ratios = [part["ratio"] for part in parts if part["ratio"] is not None]
    whole = sum(part["n"] + part["missed"] for part in parts)
    measured: Mapping[str, Any] = next(iter(one["quantities"].values()), {"r": {}}).get("r") or {}
    withheld = one["suite"]["split"] == "withheld"
    crowds = summarise_crowds(one.get("crowds", {}))
    return {
        "rank": rank,
        "name": one["tracker"]["name"],
        "score": one["score"],
        "ratio_median": float(np.median(ratios)) if ratios else None,
        "found": sum(part["n"] for part in parts) / whole if whole else None,
        "false_per_ball": sum(part["false"] for part in parts) / whole if whole else None,
        "hota": float(np.mean([part["hota"] or 0.0 for part in parts])) if parts else None,
        **{f"crowd_{name}": value for name, value in crowds.items()},
        "ms_per_frame": one["tracker"].get("ms_per_frame"),
        "r_tied_rmse": measured.get("rmse"),
        "r_tied_z_std": measured.get("z_std"),
        "made": one["tracker"].get("made", ""),
        "truth": "withheld from the tracker's authors" if withheld else "open to the tracker's authors",
        "suite_version": one["suite"]["version"],
        "truth_sha256": one["suite"]["truth_sha256"],
    }


def write_leaderboard(report: Path, found: Entries) -> None:
    """Write REPORT/leaderboard.csv."""
    table = pd.DataFrame([make_leaderboard_row(rank, one) for rank, one in enumerate(found, 1)])
    write_atomically(report / "leaderboard.csv", table.to_csv(index=False, float_format="%.6g", lineterminator="\n"))
