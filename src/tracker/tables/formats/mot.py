"""MOTChallenge: lines of frame, id, left, top, width, height, confidence, ..., counted from 1; a box is a ball's."""

import numpy as np
import pandas as pd

from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.tables.content import Content
from tracker.tables.table import TrackTable

NAME = "MOTChallenge's boxes"
SUFFIX = ".txt"
NAMES = ["frame", "particle", "left", "top", "width", "height", "confidence"]
FEWEST, MOST = 6, 10
CORNER = 1.5  # of a pixel's centre at (0, 0), in a frame in which the picture's corner is (1, 1)


def read(content: Content) -> TrackTable | None:
    first = content.head[0] if content.head else []
    if not FEWEST <= len(first) <= MOST or not all(map(_is_number, first)):
        return None
    boxes = content.cells(names=NAMES[: len(first)] + [f"more{k}" for k in range(len(first) - len(NAMES))])
    boxes = boxes.apply(pd.to_numeric, errors="coerce")
    if not (boxes[["width", "height"]] > 0).all(axis=None):
        raise content.wrong(f"{NAME}: width, height: expected numbers over 0 in each line")
    if (boxes["particle"] < 0).any():
        raise content.wrong(f"{NAME}: id -1: these are detections, expected tracks")
    if "confidence" in boxes:
        boxes = boxes[boxes["confidence"] != 0]  # lines to be ignored
    rows = pd.DataFrame({"frame": boxes["frame"] - 1, "particle": boxes["particle"]})
    for name, corner, side in (("x", "left", "width"), ("y", "top", "height")):
        rows[name] = boxes[corner] + boxes[side] / 2 - CORNER
        rows[side] = boxes[side]
    return TrackTable(rows, NAME, "px")


def _is_number(cell: str) -> bool:
    try:
        return bool(np.isfinite(float(cell)))
    except ValueError:
        return False


def write(tracks: Tracks, camera: Camera) -> str:
    side = camera.diameter_px
    lines = []
    for k in np.lexsort((tracks.particle, tracks.frame)):
        left, top = tracks.x[k] - side / 2 + CORNER, tracks.y[k] - side / 2 + CORNER
        box = f"{left:.4f},{top:.4f},{side:.4f},{side:.4f}"
        lines.append(f"{tracks.frame[k] + 1},{tracks.particle[k] + 1},{box},1,-1,-1,-1\n")
    return "".join(lines)
