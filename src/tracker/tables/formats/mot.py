"""MOTChallenge: lines of frame, id, left, top, width, height, confidence, ..., counted from 1; a box is a ball's."""

import numpy as np
import pandas as pd

from synthcam_shared.track_formats import MOT_CORNER_PX, mot_box
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.tables.content import Content
from tracker.tables.table import TrackTable

NAME = "MOTChallenge's boxes"
SUFFIX = ".txt"


def read(content: Content) -> TrackTable | None:
    first = content.head[0] if content.head else []
    if not 6 <= len(first) <= 10 or not all(map(_is_number, first)):
        return None
    names = ["frame", "particle", "left", "top", "width", "height", "confidence", "more0", "more1", "more2"]
    boxes = content.cells(names=names[: len(first)])
    boxes = boxes.apply(pd.to_numeric, errors="coerce")
    if not (boxes[["width", "height"]] > 0).all(axis=None):
        raise content.wrong(f"{NAME}: width, height: expected numbers over 0 in each line")
    if (boxes["particle"] < 0).any():
        raise content.wrong(f"{NAME}: id -1: these are detections, expected tracks")
    if "confidence" in boxes:
        boxes = boxes[boxes["confidence"] != 0]  # lines to be ignored
    rows = pd.DataFrame({"frame": boxes["frame"] - 1, "particle": boxes["particle"]})
    for name, corner, side in (("x", "left", "width"), ("y", "top", "height")):
        rows[name] = boxes[corner] + boxes[side] / 2 - MOT_CORNER_PX
        rows[side] = boxes[side]
    return TrackTable(rows, NAME, "px")


def _is_number(cell: str) -> bool:
    try:
        return bool(np.isfinite(float(cell)))
    except ValueError:
        return False


def write(tracks: Tracks, camera: Camera) -> str:
    side = camera.diameter_px
    order = np.lexsort((tracks.particle, tracks.frame))
    rows = zip(tracks.frame[order], tracks.particle[order], tracks.x[order], tracks.y[order], strict=True)
    return "".join(mot_box(int(frame), int(particle), x, y, side, "1,-1,-1,-1") for frame, particle, x, y in rows)
