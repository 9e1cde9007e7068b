"""A table of tracks as its file gives it: rows, the unit of lengths, where the axes begin; not yet in pixels."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from synthcam_shared.arrays import Array, Ints
from synthcam_shared.errors import InputError
from tracker.camera.camera_keys import format_wrong_value
from tracker.tables.rows import COVARIANCE, FIXED, to_numbers

LENGTH_UNITS = {  # what one of a unit is in m, and what it is called; "px" has no length of its own
    "px": (math.nan, "px pixel pixels"),
    "m": (1.0, "m metre metres meter meters"),
    "cm": (1e-2, "cm centimetre centimetres centimeter centimeters"),
    "mm": (1e-3, "mm millimetre millimetres millimeter millimeters"),
    "um": (1e-6, "um µm μm micron microns micrometre micrometres micrometer micrometers"),
    "nm": (1e-9, "nm nanometre nanometres nanometer nanometers"),
    "in": (0.0254, "in inch inches"),
}


@dataclass(frozen=True)
class TrackTable:
    """Rows with the columns of docs/format.md: frame, particle, x, y, and what else there is."""

    rows: pd.DataFrame
    format: str = ""  # what made it, for messages; "" for this project's own columns
    unit: str = ""  # of lengths, as the file says it; "" where nothing says it
    up: bool = (
        False  # lengths are on the plate, y upwards; else in the picture, y down from the top left pixel's centre
    )
    fps: float = math.nan  # frame rate that the file claims; NaN where it does not
    notes: tuple[str, ...] = ()  # how the file was read
    balls: tuple[str, ...] = ()  # names of the particles, by number, where the table has names

    def find_unit(self, where: str) -> str:
        """The unit of lengths, a key of LENGTH_UNITS; "" where nothing says it. Raises InputError."""
        # names that stand for no unit
        unknown = ("", "unit", "units", "a.u.", "au", "arb. unit", "arb. units", "none", "null", "-")
        return "" if self.unit.strip().strip("()").lower() in unknown else parse_unit(self.unit, where)

    def number_names(self, name: str) -> TrackTable:
        """The same with numbers for names of particles and of clips, in the order of the alphabet.

        name: what a note calls the table.
        """
        rows, notes, balls = self.rows, list(self.notes), self.balls
        for column in (c for c in ("particle", "clip") if c in rows):
            values, known = rows[column], rows[column].dropna()
            if pd.api.types.is_numeric_dtype(values) or not len(known):
                continue
            if pd.to_numeric(known, errors="coerce").notna().sum() > len(known) / 2:
                continue
            texts = values.astype(str).where(values.notna())
            names = sorted(texts.dropna().unique(), key=_natural_order)
            numbers = pd.Index(names).get_indexer(pd.Index(texts))
            rows = rows.assign(**{column: np.where(texts.isna(), np.nan, numbers)})
            if column == "particle":
                balls = tuple(names)
            listed = ", ".join(f"{k} is {format_wrong_value(one, quoted=False)}" for k, one in enumerate(names[:4]))
            notes.append(f"{name}: column {column} has names: {listed}{', ...' if len(names) > 4 else ''}")
        return replace(self, rows=rows, notes=tuple(notes), balls=balls)

    def leave_out_unassigned(self, name: str, where: str = "") -> TrackTable:
        """The same without rows of no particle, which programs mark by -1 or by nothing.

        name: what a note calls the table; where: what a message calls it. Raises InputError where no row has one.
        """
        if "particle" not in self.rows or not len(self.rows):
            return self
        particle = pd.to_numeric(self.rows["particle"], errors="coerce")
        gone = ((particle < 0) | self.rows["particle"].isna()).to_numpy()
        if not gone.any():
            return self
        if gone.all():
            raise InputError(
                f"{where or name}: no row has a particle (id -1 or none): these are detections, expected tracks"
            )
        note = f"{name}: {int(gone.sum())} of {len(gone)} rows have no particle (id -1 or none) and are left out"
        return replace(self, rows=self.rows[~gone], notes=(*self.notes, note))

    def scale_lengths(self, factor: float, where: str) -> TrackTable:
        """The same with lengths of another unit."""
        rows = self.rows.copy()
        lengths = ("x", "y", "glint_x", "glint_y", *COVARIANCE[:2], *FIXED[:2])
        for names, by in ((lengths, factor), ((COVARIANCE[2], FIXED[2]), factor**2)):
            for name in (n for n in names if n in rows):
                rows[name] = to_numbers(rows[name], name, where) * by
        return replace(self, rows=rows)


def _natural_order(text: str) -> list[tuple[bool, int, str]]:
    """For sorting: run2 before run10."""
    parts = re.split(r"(\d+)", text)
    return [(part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts]


def parse_unit(name: str, where: str) -> str:
    """Find the unit of a table's lengths by its name. Raises InputError."""
    found = [unit for unit, (_, names) in LENGTH_UNITS.items() if name.strip().strip("()").lower() in names.split()]
    if not found:
        option = "" if where == "--unit" else "; --unit says which it is"
        known = ", ".join(LENGTH_UNITS)
        raise InputError(f"{where}: {format_wrong_value(name)}: expected a unit of length, one of {known}{option}")
    return found[0]


def per_second(interval: float, unit: str) -> float:
    """Convert an interval of a table's frames in a unit of time to frames a second; NaN where that is none."""
    seconds = {"s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3}.get(unit.strip().lower())
    return 1.0 / (interval * seconds) if seconds and interval > 0 else math.nan


def frames_from_times(times: Array, where: str) -> tuple[Ints, Array, float]:
    """Find frames and frame rate of a table with times alone; times that are even to a few digits are evened out."""
    steps = np.unique(times)
    if not np.isfinite(times).all() or len(steps) < 2:
        raise InputError(f"{where}: t: expected a time in s in each row")
    gaps = np.diff(steps)
    known = np.concatenate([[0], np.cumsum(np.maximum(np.round(gaps / np.median(gaps)), 1))])
    step, first = np.polyfit(known, steps, 1)
    frame = known[np.searchsorted(steps, times)]
    even = first + step * frame
    # times are printed to few digits: a fifth of a step off is even
    if np.max(np.abs(even - times)) < 0.2 * step:
        return frame.astype(np.int64), even, 1.0 / float(step)
    return frame.astype(np.int64), times, math.nan
