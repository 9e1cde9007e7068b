"""Wide tables: a row for each frame, with x and y of every ball, as idtracker.ai, idTracker and many scripts write."""

import math
import re

import numpy as np
import pandas as pd

from tracker.tables.column_names import split_unit
from tracker.tables.content import FileContent
from tracker.tables.rows import REQUIRED_COLUMNS, to_numbers
from tracker.tables.table import TrackTable, frames_from_times

NAME = "a wide table (idtracker.ai)"


def read(content: FileContent) -> TrackTable | None:
    if content.root is not None or content.is_binary or not content.has_header:
        return None
    table = content.cells()
    plain = {name: split_unit(name)[0] for name in map(str, table.columns)}
    if set(REQUIRED_COLUMNS) <= set(plain.values()):
        return None
    pairs = pair_columns(plain)
    if len(pairs) < 2:
        return None
    frame, time, fps = read_frames_and_times(table, plain, content.where)
    parts = []
    for ball, (x, y) in enumerate(pairs):
        own = {"frame": frame, "particle": ball, "x": table[x], "y": table[y]}
        parts.append(pd.DataFrame(own if time is None else own | {"t_s": time}, index=table.index))
    units = {split_unit(name)[1] for pair in pairs for name in pair}
    return TrackTable(pd.concat(parts), NAME, units.pop() if len(units) == 1 else "", fps=fps)


def pair_columns(plain: dict[str, str]) -> list[tuple[str, str]]:
    """Find the columns of each ball in a wide table: x1, y1; x_1, y_1; a_x, a_y. plain: names without units."""
    axes: dict[str, dict[str, str]] = {"x": {}, "y": {}}
    for column, name in plain.items():
        first, last = re.fullmatch(r"([xy])_?(\w+)", name), re.fullmatch(r"(\w+?)_?([xy])", name)
        if first and (first[2].isdigit() or name[1] == "_"):
            axes[first[1]][first[2]] = column
        elif last and last[1]:
            axes[last[2]][last[1]] = column
    return [(axes["x"][ball], axes["y"][ball]) for ball in axes["x"] if ball in axes["y"]]


def read_frames_and_times(table: pd.DataFrame, plain: dict[str, str], where: str) -> tuple[object, object, float]:
    """Find frames, times or None, and the frame rate of a wide table, with a row for each frame."""
    by_name = {name: column for column, name in reversed(plain.items())}
    frames = next((by_name[name] for name in ("frame", "frames", "frame_number", "frame_no") if name in by_name), None)
    times = next((by_name[name] for name in ("seconds", "time", "t", "timestamp") if name in by_name), None)
    if times is not None:
        frame, time, fps = frames_from_times(to_numbers(table[times], times, where), where)
        return (frame if frames is None else table[frames]), time, fps
    return (np.arange(len(table)) if frames is None else table[frames]), None, math.nan
