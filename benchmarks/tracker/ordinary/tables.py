"""Cases of tables: dialects of programs, missing values, rows with faults, empty results, scores."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.tracker.ordinary.case import Case, Judge, Words
from benchmarks.tracker.ordinary.judges import Measured, Refused, Said, Scored
from benchmarks.tracker.ordinary.sources import film_glints, know_table, list_rows, measure

dialects: Any = importlib.import_module("tracker_dialects")
programs: Any = importlib.import_module("tracker_tables")
TrackRows = Sequence[tuple[int, int, float, float]]
HIT = 20  # frame of the contact
NO_NAMES = "--columns frame=1,track=2,x=3,y=4"


def write_text(text: str) -> Callable[[Path], object]:
    """A writer of a text."""
    return lambda path: path.write_text(text)


def as_table() -> pd.DataFrame:
    """The rows as a table."""
    return pd.DataFrame(list_rows(), columns=["frame", "particle", "x", "y"])


def write_trackpy_store(path: Path) -> None:
    """As trackpy.PandasHDFStore: a table for each frame."""
    importlib.import_module("tables")
    with pd.HDFStore(path, "w") as store:
        for frame, rows in as_table().groupby("frame"):
            store.put(f"Frame_{frame}", rows, format="table", track_times=False)


def place_on_whole_pixels() -> tuple[TrackRows, dict[str, Any]]:
    """Rows in which the ball at rest comes first and lies on a whole pixel, so that the first line has no decimals.

    The positions of its first six frames are exact; all are shifted, and so is the camera's picture.
    """
    rest = film_glints().places[0, 0]
    x0, y0 = np.ceil(rest) - rest
    moved = [(f, b, round(x + x0, 4), round(y + y0, 4)) for f, b, x, y in list_rows()]
    at = float(np.ceil(rest[0])), float(np.ceil(rest[1]))
    exact = [(f, b, at[0], at[1]) if b == 0 and f < 6 else (f, b, x, y) for f, b, x, y in moved]
    return sorted(exact, key=lambda row: (row[1], row[0])), know_table()


def list_dialects() -> dict[str, tuple[str, tuple[str, ...]]]:
    """Texts and options by the name of a dialect; all hold the same positions."""
    rows = list_rows()
    late, _ = place_on_whole_pixels()
    every: dict[str, tuple[str, tuple[str, ...]]] = {
        name: (text, ()) for name, text in dialects.list_dialects(rows).items()
    }
    every["decimals late"] = (dialects.write_late_decimals(late), ())
    every["Qualisys"] = (dialects.write_qualisys(rows, (200, 160), scale=0.3), ())
    every["missing values in seven ways"] = (dialects.write_missing(rows), ())
    every["thousands separators"] = (write_thousands(rows), ("--unit", "um"))
    every["TrackMate with an unknown unit, --unit px"] = (
        dialects.write_trackmate_xml(rows, "parsec"),
        ("--unit", "px"),
    )
    every["TrackMate CSV"] = (programs.trackmate_csv(rows), ())
    every["TrackMate model"] = (programs.trackmate_model(rows), ())
    every["Particle Tracking Challenge"] = (programs.ptc(rows), ())
    every["MOTChallenge"] = (programs.mot(rows), ())
    every["Tracker (OSP) table"] = (programs.osp_table(rows), ())
    every["Tracker (OSP) .trk"] = (programs.osp_marks(rows), ())
    return every


def write_thousands(rows: TrackRows) -> str:
    """Micrometres in whole numbers, with commas between thousands; y upwards on the plate."""
    scale = film_glints().camera["scale"] * 1e6
    lines = [f"{f};{b};{(x - 99.5) * scale:,.0f};{(79.5 - y) * scale:,.0f}" for f, b, x, y in rows]
    return "\n".join(["frame;particle;x;y", *lines]) + "\n"


def exchange(first: int, last: int) -> TrackRows:
    """Rows whose ids are exchanged from one frame to another."""
    return [(f, 1 - b if first <= f <= last else b, x, y) for f, b, x, y in list_rows()]


def lose(mark: float, frames: Sequence[int]) -> TrackRows:
    """Rows in which ball 1 is lost in some frames, which a mark in x and y shows."""
    return [(f, b, mark, mark) if b == 1 and f in frames else (f, b, x, y) for f, b, x, y in list_rows()]


def reuse() -> TrackRows:
    """Rows whose ball 0 ends in frame 50; from 53 on its number is that of a ball elsewhere."""
    kept = [(f, b, x, y) for f, b, x, y in list_rows() if b == 1 or f <= 50]
    return [*kept, *((f, 0, 20.0 + 0.01 * (f % 2), 15.0) for f in range(53, 60))]


def score(found: str, truth: str) -> Callable[[Path], Words]:
    """Two tables, and `tracker score` of one against the other."""

    def make(folder: Path) -> Words:
        (folder / "found.txt").write_text(found)
        (folder / "gt.txt").write_text(truth)
        return ["tracker", "score", "found.txt", "--truth", "gt.txt", "-o", "new"]

    return make


def score_mot(first: int = 1, confidence: int = 1) -> str:
    """The rows as boxes of MOTChallenge."""
    return str(dialects.write_mot(list_rows(), first, confidence))


def mark_zero(line: str) -> str:
    """A row of a truth whose seventh cell, the mark, is 0: it does not count."""
    cells = line.split(" ")
    return " ".join([*cells[:6], "0", *cells[7:]])


def list_cases() -> list[Case]:
    """Cases of tables."""
    fine: Judge = Measured(film_glints().truth)
    plain = dialects.write_lines(list_rows(), digits=".4f")
    cases = [
        Case("tables", name, measure("t.txt", write_text(text), *options), fine)
        for name, (text, options) in list_dialects().items()
    ]
    files: dict[str, tuple[Callable[[Path], object], str]] = {
        "t.parquet": (lambda path: as_table().to_parquet(path), ""),
        "t.feather": (lambda path: as_table().to_feather(path), ""),
        "t.xlsx": (lambda path: as_table().to_excel(path, index=False), "openpyxl"),
        "t.h5": (write_trackpy_store, "tables"),
    }
    cases += [
        Case("tables", name.removeprefix("t"), measure(name, write), fine, needs=needs)
        for name, (write, needs) in files.items()
    ]
    faults: dict[str, tuple[TrackRows, tuple[str, ...]]] = {
        "ids exchanged in one frame": (exchange(30, 30), ("frames 30, 31",)),
        "ids exchanged from the hit on": (exchange(HIT + 1, 99), ("exchange",)),
        "ids exchanged later, for good": (exchange(40, 99), ("frame 40",)),
        "lost points as 0, 0": (lose(0.0, (4, 5, 33)), ("4", "33")),
        "lost points as -1, -1": (lose(-1.0, (4, 5, 33)), ("4", "33")),
        "an id that is used again": (reuse(), ("53",)),
    }
    cases += [
        Case("rows", name, measure("t.csv", write_text(dialects.write_lines(rows, digits=".4f"))),
             Measured(film_glints().truth, says=says))
        for name, (rows, says) in faults.items()
    ]  # fmt: skip
    broken = plain.replace("\n5,1,", "\n5,1,l", 1)
    refused = {
        "a cell that is no number": (broken, ("line 13", "x", "expected numbers")),
        "an unknown unit": (dialects.write_trackmate_xml(list_rows(), "parsec"), ("'parsec'", "--unit")),
        "columns without names, in doubt": (
            "".join(f"{f} {b} {1 - b} {x} {y}\n" for f, b, x, y in list_rows()), ("--columns",),
        ),
    }  # fmt: skip
    cases += [
        Case("tables", f"refused: {name}", measure("t.txt", write_text(text)), Refused(("t.txt", *says)))
        for name, (text, says) in refused.items()
    ]
    found = score_mot().splitlines(keepends=True)
    unmarked = [line if k % 3 == 0 else mark_zero(line) for k, line in enumerate(found)]
    perfect = partial(Scored, {"hota": 1.0, "missed": 0, "false": 0})
    cases += [
        Case("score", "confidence 0", score(score_mot(confidence=0), score_mot()), perfect()),
        Case(
            "score",
            "a truth with marks 0, which do not count",
            score("".join(found[::3]), "".join(unmarked)),
            Scored({"hota": 1.0, "missed": 0, "false": 0}),
        ),
        Case("score", "frames from 0", score(score_mot(0), score_mot()), perfect(("frames count from 0",))),
        Case("score", "an empty result", score("", score_mot()), Scored({"hota": 0.0, "missed": 120, "false": 0})),
        Case(
            "tables",
            "an empty result",
            measure("t.csv", write_text("frame,particle,x,y\n")),
            Said(("too few detections",)),
        ),
    ]
    return cases
