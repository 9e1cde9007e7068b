"""Tracker (Open Source Physics): its exported table, a line of masses above t, x, y, ...; and its .trk file.

A .trk holds marks in the picture, whose top left corner is (0, 0). The exported table holds lengths from the axes that
the user set, y upwards; it does not state their unit.
"""

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator

import pandas as pd

from tracker.tables.content import FileContent
from tracker.tables.rows import to_numbers
from tracker.tables.table import TrackTable, frames_from_times

NAME = "Tracker (OSP)"
FROM_XML = True
CLASS_PREFIX = "org.opensourcephysics.cabrillo.tracker."


def read(content: FileContent) -> TrackTable | None:
    root = content.root
    if root is None:
        return _read_exported(content)
    if not root.get("class", "").startswith(CLASS_PREFIX):
        return None
    rows = pd.DataFrame(list(_marks(content, root)), columns=["frame", "particle", "x", "y"])
    step = [content.number(p) for p in root.iter("property") if p.get("name") == "delta_t"]
    return TrackTable(rows, f"{NAME}: .trk", "px", fps=1e3 / step[0] if step and step[0] > 0 else math.nan)


def _marks(content: FileContent, root: ET.Element) -> Iterator[tuple[float, ...]]:
    masses = [one for one in root.iter("object") if one.get("class") == f"{CLASS_PREFIX}PointMass"]
    for number, mass in enumerate(masses):
        for frame in mass.iterfind("property[@name='framedata']/property"):
            at = re.fullmatch(r"\[(\d{1,9})\]", frame.get("name", ""))
            place = {p.get("name"): p for p in frame.iterfind("object/property")}
            if at is None or not {"x", "y"} <= set(place):
                raise content.wrong("<property> of framedata: expected [frame] with x and y")
            x, y = (content.number(place[name]) - 0.5 for name in ("x", "y"))
            yield int(at[1]), number, x, y


def _read_exported(content: FileContent) -> TrackTable | None:
    """Names of masses, each above its first column; then names of columns, the first t or step; then numbers."""
    head = content.head
    at = next((k for k, line in enumerate(head[:3]) if k and {"x", "y"} <= set(line) and line[0] in ("t", "step")), 0)
    if not at:
        return None
    names = head[at][: max(k for k, name in enumerate(head[at]) if name) + 1]
    starts = [k for k, name in enumerate(names) if name == names[1]]
    cells = content.cells(at + 1, [f"{k}" for k in range(len(names))])
    first = to_numbers(cells["0"], names[0], content.where)
    extra, fps = {"frame": first}, math.nan
    if names[0] == "t":
        frame, time, fps = frames_from_times(first, content.where)
        extra = {"frame": frame, "t_s": time}
    parts = []
    for particle, (start, end) in enumerate(zip(starts, [*starts[1:], len(names)], strict=True)):
        column = {name: f"{start + k}" for k, name in enumerate(names[start:end])}
        if not {"x", "y"} <= set(column):
            raise content.wrong(f"{NAME}: mass {particle + 1} without x, y; expected them of each")
        own = pd.DataFrame({**extra, "particle": particle, "x": cells[column["x"]], "y": cells[column["y"]]})
        if "frame" in column:
            own = own.assign(frame=cells[column["frame"]]).drop(columns="t_s", errors="ignore")
        parts.append(own[own[["x", "y"]].notna().all(axis=1)])
    return TrackTable(pd.concat(parts), f"{NAME}: exported table", "", up=True, fps=fps)
