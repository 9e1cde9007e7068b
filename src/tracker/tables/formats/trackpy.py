"""trackpy: columns frame, particle, x, y in px, and `ep`, the error of position, where nothing better is given."""

import math

import numpy as np
import pandas as pd

from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.tables.column_names import find_columns
from tracker.tables.content import Content
from tracker.tables.rows import REQUIRED_COLUMNS, to_numbers
from tracker.tables.table import TrackTable, frames_from_times

SUFFIX = ".csv"


def read(content: Content) -> TrackTable | None:
    if content.root is not None or not (content.is_binary or content.has_header):
        return None
    rows = content.cells()
    columns, unit = find_columns(rows.columns, REQUIRED_COLUMNS)
    fps = math.nan
    if set(REQUIRED_COLUMNS) - set(columns) == {"frame"}:
        times, _ = find_columns(rows.columns, ["t"])
        if times:
            given = to_numbers(rows[times["t"]], times["t"], content.where)
            frame, time, fps = frames_from_times(given, content.where)
            rows, columns = rows.assign(frame=frame, t_s=time), columns | {"frame": "frame"}
    if not set(REQUIRED_COLUMNS) <= set(columns):
        return None
    rows = rows.rename(columns={own: name for name, own in columns.items()})
    if not pd.api.types.is_numeric_dtype(rows["particle"]) and not is_any_number(rows["particle"]):  # names
        names = rows["particle"]
        rows = rows.assign(particle=np.where(names.isna(), np.nan, pd.factorize(names)[0]))
    return TrackTable(with_errors(rows, content.where), unit=unit, fps=fps)


def is_any_number(values: pd.Series) -> bool:
    """Whether a column holds numbers, most of them at least."""
    return bool(pd.to_numeric(values, errors="coerce").notna().sum() > len(values.dropna()) / 2)


def with_errors(rows: pd.DataFrame, where: str) -> pd.DataFrame:
    """The rows with `ep` as standard errors; what is not over 0 is not known."""
    if {"x_std", "y_std"} & set(rows):
        return rows
    for name, given in (("x_std", ("ep_x", "ep")), ("y_std", ("ep_y", "ep"))):
        found = next((ep for ep in given if ep in rows), None)
        if found is not None:
            error = to_numbers(rows[found], found, where)
            rows = rows.assign(**{name: np.where(error > 0, error, np.nan)})
    return rows


def write(tracks: Tracks, camera: Camera) -> str:
    error = np.sqrt((tracks.cov[:, 0, 0] + tracks.cov[:, 1, 1]) / 2)
    columns = {"y": tracks.y, "x": tracks.x, "mass": tracks.flux, "ep": error}
    table = pd.DataFrame(columns | {"frame": tracks.frame, "particle": tracks.particle})
    return table.sort_values(["frame", "particle"]).to_csv(index=False)
