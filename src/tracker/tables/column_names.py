"""Names of columns as programs and people write them: "Frame", "x (px)", "TRACK_ID", "pos_x [mm]"."""

import math
import re
from collections.abc import Iterable

import numpy as np
import pandas as pd

from tracker.tables.rows import REQUIRED_COLUMNS, to_numbers
from tracker.tables.table import LENGTH_UNITS, TrackTable, frames_from_times

_ALIASES = {
    "frame": "frame frames frame_no frame_nr frame_number frameno framenumber frame_id frame_idx frame_index "
    "image_index",
    "particle": "particle particle_id track track_id trackid track_no track_number id ball ball_id object object_id "
    "obj_id identity individual",
    "x": "x pos_x position_x x_pos x_position x_center x_centre center_x centre_x centroid_x x_centroid cx xc",
    "y": "y pos_y position_y y_pos y_position y_center y_centre center_y centre_y centroid_y y_centroid cy yc",
    "t": "t time seconds timestamp",
}
_UNITS = {word: unit for unit, (_, names) in LENGTH_UNITS.items() for word in names.split()}


def split_unit(name: str) -> tuple[str, str]:
    """Split the name of a column from its unit: "X (px)" gives x, px; "x, px" and "x_px" too."""
    text = re.sub(r"\s+", " ", str(name).strip().lstrip("#").strip().lower())
    found = re.fullmatch(r"(.+?)\s*[\[(]\s*([^\])]*?)\s*[\])]", text) or re.fullmatch(r"(.+?)\s*[,/:_ ]\s*(\S+)", text)
    if found and (found[2] in _UNITS or found[2] in ("s", "sec", "second", "seconds")):
        return re.sub(r"[ .-]", "_", found[1]), found[2]
    return re.sub(r"[ .-]", "_", text), ""


def find_columns(names: Iterable[str], wanted: Iterable[str]) -> tuple[dict[str, str], str]:
    """Which columns are the wanted ones, by their own names, and the unit of lengths that x and y state.

    A column that is named as it should be is itself; of others one with a known name counts if it is the only one.
    """
    every = [str(name) for name in names]
    found, units = dict[str, str](), set[str]()
    meaning = {alias: name for name, aliases in _ALIASES.items() for alias in aliases.split()}
    for key in wanted:
        if key in every:
            found[key] = key
            continue
        fit = [name for name in every if meaning.get(split_unit(name)[0]) == key]
        exact = [name for name in fit if split_unit(name)[0] == key]
        for choice in (fit, exact):
            if len(choice) == 1:
                found[key] = choice[0]
                break
        if key in ("x", "y") and key in found:
            units.add(_UNITS.get(split_unit(found[key])[1], ""))
    return found, units.pop() if len(units) == 1 else ""


def read_named_columns(rows: pd.DataFrame, where: str) -> TrackTable | None:
    """A table whose columns have known names, or t (s) if frame is missing; None where some are missing."""
    (columns, unit), (times, _) = (find_columns(rows.columns, names) for names in (REQUIRED_COLUMNS, ["t"]))
    fps = math.nan
    if times and set(REQUIRED_COLUMNS) - set(columns) == {"frame"}:
        frame, time, fps = frames_from_times(to_numbers(rows[times["t"]], times["t"], where), where)
        rows, columns = rows.assign(frame=frame, t_s=time), columns | {"frame": "frame"}
    if not set(REQUIRED_COLUMNS) <= set(columns):
        return None
    rows = rows.rename(columns={own: name for name, own in columns.items()})
    names = {} if {"x_std", "y_std"} & set(rows) else {"x_std": ("ep_x", "ep"), "y_std": ("ep_y", "ep")}
    for name, given in names.items():
        if found := next((ep for ep in given if ep in rows), ""):
            error = to_numbers(rows[found], found, where)
            rows = rows.assign(**{name: np.where(error > 0, error, np.nan)})  # what is not over 0 is not known
    return TrackTable(rows, unit=unit, fps=fps)
