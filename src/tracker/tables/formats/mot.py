"""MOTChallenge: lines of frame, id, left, top, width, height, confidence, ..., counted from 1; a box is a ball's."""

from pathlib import Path

import numpy as np
import pandas as pd

from synthcam_shared.track_formats import MOT_CORNER_PX, make_mot_line
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.tables.content import FileContent
from tracker.tables.rows import to_numbers
from tracker.tables.table import TrackTable

NAME = "MOTChallenge's boxes"
SUFFIX = ".txt"


def read(content: FileContent) -> TrackTable | None:
    first = content.head[0] if content.head else []
    if content.root is not None or content.has_header or not 6 <= len(first) <= 10:
        return None
    names = ["frame", "particle", "left", "top", "width", "height", "confidence", "more0", "more1", "more2"]
    boxes = content.cells(names=names[: len(first)])
    numbers = boxes.apply(pd.to_numeric, errors="coerce")
    whole = numbers[["frame", "particle"]]
    if not (whole == whole.round()).all(axis=None):
        return None
    where = content.where
    for name in ("left", "top", "width", "height"):
        to_numbers(boxes[name], name, f"{where}: {NAME}")
    small = ~(numbers[["width", "height"]] > 0).all(axis=1)
    if small.any():
        raise content.wrong(f"line {small.idxmax()}: {NAME}: width, height: expected numbers over 0 in each line")
    if (numbers["particle"] < 0).all():
        raise content.wrong(f"{NAME}: id -1: these are detections, expected tracks")
    notes = []
    start = 1
    if numbers["frame"].min() == 0:
        start = 0
        notes.append(f"{Path(where).name}: frames count from 0, not from 1 as in {NAME}")
    rows = pd.DataFrame({"frame": numbers["frame"] - start, "particle": numbers["particle"]})
    for name, corner, side in (("x", "left", "width"), ("y", "top", "height")):
        rows[name] = numbers[corner] + numbers[side] / 2 - MOT_CORNER_PX
        rows[side] = numbers[side]
    if "confidence" in numbers:
        rows["confidence"] = numbers["confidence"]
        ignored = (numbers["confidence"] == 0).to_numpy()
        if Path(where).name == "gt.txt" and 0 < ignored.sum() < len(rows):  # the name of the truth in MOTChallenge
            notes.append(f"gt.txt: {ignored.sum()} of {len(rows)} rows have confidence 0, the mark of ignored ones")
            rows = rows[~ignored]
    return TrackTable(rows, NAME, "px", notes=tuple(notes))


def write(tracks: Tracks, camera: Camera) -> str:
    side = camera.diameter_px
    order = np.lexsort((tracks.particle, tracks.frame))
    rows = zip(tracks.frame[order], tracks.particle[order], tracks.x[order], tracks.y[order], strict=True)
    return "".join(make_mot_line(int(frame), int(particle), x, y, side, "1,-1,-1,-1") for frame, particle, x, y in rows)
