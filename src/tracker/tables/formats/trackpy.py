"""trackpy: columns frame, particle, x, y in px, and `ep`, the error of position, where nothing better is given."""

import numpy as np
import pandas as pd

from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.tables.content import Content
from tracker.tables.rows import REQUIRED_COLUMNS, to_numbers
from tracker.tables.table import TrackTable

SUFFIX = ".csv"


def read(content: Content) -> TrackTable | None:
    if content.root is not None or not set(REQUIRED_COLUMNS) <= set(rows := content.cells()):
        return None
    return TrackTable(with_errors(rows, content.where))


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
