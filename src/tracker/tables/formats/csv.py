"""csv: all columns of tracks.csv, covariances among them."""

from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.tables.rows import make_tracks_table, to_csv

SUFFIX = ".csv"


def write(tracks: Tracks, camera: Camera) -> str:
    return to_csv(make_tracks_table(tracks)).decode()
