"""Comparison of a table of tracks by any program with a true table, without films or cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

from synthcam_shared.arrays import Array
from synthcam_shared.errors import InputError
from synthcam_shared.json_values import replace_non_finite
from synthcam_shared.report.page import PageSection, PageTable, write_page
from tracker.notes import Note, NoteKind, make_notes
from tracker.results import write_json
from tracker.scoring.tracking_metrics import GATE_PX, TrackPoints, score_tracks
from tracker.tables.content import FileContent
from tracker.tables.read import recognise_format
from tracker.tables.rows import to_numbers, to_whole_numbers
from tracker.tables.table import TrackTable

SIZE = ("width", "height")
MEASURES = {
    "mota": "1 - (missed + false + switches) / balls",
    "motp": "mean similarity of the paired positions",
    "idf1": "share of the positions that one partner for the whole film explains",
    "hota": "geometric mean of detection and association, over 19 levels of similarity",
    "deta": "the detection part of hota",
    "assa": "the association part of hota",
    "swaps": "identity switches",
    "alpha": "1 - distance of paired tracks over the distance without any track (Particle Tracking Challenge)",
    "beta": "alpha with a penalty for spurious tracks",
    "jsc": "share of the positions that are paired",
    "jsc_theta": "share of the tracks that are paired",
}


@dataclass(frozen=True)
class TableScore:
    """Scores of one table; `by` says how positions were compared."""

    truth: str
    name: str
    by: str
    localisation: dict[str, float]
    tracking: dict[str, float]
    notes: tuple[Note, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of score.json."""
        parts = {"localisation": self.localisation, "tracking": self.tracking, "by": self.by}
        whole_table: dict[str, Any] = replace_non_finite({"suite": self.truth, "detectors": {self.name: parts}})
        return whole_table

    def summary(self) -> list[str]:
        """Return lines for a terminal."""
        where = self.localisation
        lines = [
            f"{where['n']} found, {where['missed']} missed, {where['false']} false ({self.by})",
            f"rmse of those found {where['rmse']:.4g} {where['unit']}, each axis",
        ]
        return lines + [f"{name:<10}{self.tracking[name]:>12.9g}  {meaning}" for name, meaning in MEASURES.items()]

    def write(self, report: Path) -> Path:
        """Write REPORT/score.json and REPORT/index.html; return the path of the page."""
        where = self.localisation
        summary = (
            f"{where['n']} positions found, {where['missed']} missed, {where['false']} false. Root mean square error "
            f"of those found: {where['rmse']:.4g} {where['unit']} in x and y. Compared as {self.by}."
        )
        rows = [(name, f"{self.tracking[name]:.9g}", meaning) for name, meaning in MEASURES.items()]
        table = PageTable(["measure", "value", "meaning"], rows)
        report.mkdir(parents=True, exist_ok=True)
        write_json(report / "score.json", self.to_dict())
        title = f"{self.name} compared with {self.truth}"
        return write_page(
            report / "index.html", title, [PageSection("", [table])], "tracker score", [summary, *map(str, self.notes)]
        )


def score_table(found: Path, truth: Path, gate: float | None = None, name: str = "") -> TableScore:
    """Compare a table of tracks by any program with a true table: files in any formats, lengths in the same unit.

    `gate` is the largest distance of a pair in that unit; default: 5. Without a gate, boxes are compared by their
    overlap where both files have boxes. `name` of the table; default: that of its file. Raises InputError.
    """
    one, other = (
        recognise_format(FileContent.of(path)).leave_out_unassigned(path.name, str(path)) for path in (truth, found)
    )
    one = _leave_out_ignored(one, truth.name)
    units = [
        table.find_unit(str(path)) or ("m" if table.up else "px") for table, path in ((one, truth), (other, found))
    ]
    if not len(other.rows):  # a result without any detection has no unit of its own
        units[1], other = units[0], replace(other, up=one.up)
    if units[0] != units[1] or one.up != other.up:
        raise InputError(f"{found}: lengths in {units[1]}, those of {truth} in {units[0]}; expected one unit")
    clips = [_read_points(table, path) for table, path in ((one, truth), (other, found))]
    boxes = gate is None and all(set(SIZE) <= set(table.rows) or not len(table.rows) for table in (one, other))
    boxes = boxes and bool(len(one.rows))
    reach = GATE_PX if gate is None else gate
    empty = TrackPoints(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2)))
    pairs: list[tuple[TrackPoints, TrackPoints]] = []
    for clip in sorted(set(clips[0]) | set(clips[1])):
        both = [part.get(clip, empty) for part in clips]
        true_points, points = both if boxes else [TrackPoints(p.frame, p.track, p.xy) for p in both]
        pairs.append((true_points, points))
    return TableScore(
        truth=truth.name,
        name=name or found.stem,
        by="boxes that overlap by half or more" if boxes else f"points, up to {reach:g} {units[0]} apart",
        localisation=_score_positions(pairs, reach) | {"unit": units[0]},
        tracking=score_tracks(pairs, reach),
        notes=tuple(make_notes(NoteKind.TABLE, (*one.notes, *other.notes))),
    )


def _leave_out_ignored(table: TrackTable, name: str) -> TrackTable:
    """The true table without its rows of confidence 0, a mark that only the truth has in MOTChallenge."""
    if "confidence" not in table.rows:
        return table
    ignored = (table.rows["confidence"] == 0).to_numpy()
    if not ignored.any():
        return table
    if ignored.all():
        note = f"{name}: every row has confidence 0, so that it marks nothing; all rows are used"
        return replace(table, notes=(*table.notes, note))
    note = f"{name}: {int(ignored.sum())} of {len(ignored)} rows have confidence 0, the mark of ignored ones"
    return replace(table, rows=table.rows[~ignored], notes=(*table.notes, note))


def _read_points(table: TrackTable, path: Path) -> dict[int, TrackPoints]:
    """Track points by clip, without rows that have no finite position."""
    rows, where = table.rows, str(path)
    columns = [to_numbers(rows[name], name, where) for name in ("x", "y")]
    xy: Array = np.stack(columns, axis=1)
    frame, track = (to_whole_numbers(rows[name], name, where) for name in ("frame", "particle"))
    numbers = to_whole_numbers(rows["clip"], "clip", where) if "clip" in rows else np.zeros(len(rows), np.int64)
    size = np.stack([to_numbers(rows[name], name, where) for name in SIZE], axis=1) if set(SIZE) <= set(rows) else None
    keys = pd.DataFrame({"clip": numbers, "frame": frame, "particle": track})
    if keys.duplicated().any():
        first = keys[keys.duplicated()].iloc[0]
        raise InputError(f"{path}: frame {first['frame']}: particle {first['particle']} twice, expected once")
    good = np.isfinite(xy).all(axis=1)
    return {
        int(clip): TrackPoints.of(frame[use], track[use], xy[use], None if size is None else size[use])
        for clip in np.unique(numbers)
        for use in [good & (numbers == clip)]
    }


def _score_positions(clips: list[tuple[TrackPoints, TrackPoints]], gate: float) -> dict[str, Any]:
    """Pair positions frame by frame, without regard to their tracks."""
    off, missed, false = [], 0, 0
    for truth, found in clips:
        for frame in np.union1d(truth.frame, found.frame):
            a, b = truth.xy[truth.frame == frame], found.xy[found.frame == frame]
            apart = np.linalg.norm(a[:, None] - b[None], axis=-1)
            rows, columns = linear_sum_assignment(np.minimum(apart, 10 * gate))
            met = apart[rows, columns] <= gate
            off.append(b[columns[met]] - a[rows[met]])
            missed, false = missed + len(a) - int(met.sum()), false + len(b) - int(met.sum())
    errors = np.concatenate([np.empty((0, 2)), *off])
    rmse = float(np.sqrt((errors**2).mean())) if len(errors) else float("nan")
    return {"n": len(errors), "missed": missed, "false": false, "rmse": rmse}
