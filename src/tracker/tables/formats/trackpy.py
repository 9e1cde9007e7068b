"""trackpy: columns frame, particle, x, y in px, and `ep`, the error of position, where nothing better is given."""

import numpy as np
import pandas as pd

from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.tables.column_names import read_named_columns
from tracker.tables.content import FileContent
from tracker.tables.table import TrackTable

SUFFIX = ".csv"


def read(content: FileContent) -> TrackTable | None:
    if content.root is not None or not (content.is_binary or content.has_header):
        return None
    return read_named_columns(content.cells(), content.where)


def write(tracks: Tracks, camera: Camera) -> str:
    error = np.sqrt((tracks.cov[:, 0, 0] + tracks.cov[:, 1, 1]) / 2)
    columns = {"y": tracks.y, "x": tracks.x, "mass": tracks.flux, "ep": error}
    table = pd.DataFrame(columns | {"frame": tracks.frame, "particle": tracks.particle})
    return table.sort_values(["frame", "particle"]).to_csv(index=False)
