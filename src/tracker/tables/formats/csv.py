"""csv: all columns of tracks.csv, covariances among them."""

from io import BytesIO

import pyarrow.csv

from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.tables.rows import tracks_table

SUFFIX = ".csv"


def write(tracks: Tracks, camera: Camera) -> str:
    with BytesIO() as text:
        pyarrow.csv.write_csv(tracks_table(tracks), text, pyarrow.csv.WriteOptions(quoting_style="needed"))
        return text.getvalue().decode()
