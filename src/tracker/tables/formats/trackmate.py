"""TrackMate: its model file, and the simple XML of tracks that its "Export tracks to XML file" writes.

Tinevez et al. 2017, Methods 115, 80. Lengths are in the unit that the file says, y downwards; frames count from 0.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator

import numpy as np
import pandas as pd

from synthcam_shared.track_formats import make_trackmate_xml, split_by_particle
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.tables.content import FileContent
from tracker.tables.table import TrackTable, per_second

NAME = "TrackMate's XML"
FROM_XML = True
SUFFIX = ".xml"


def read(content: FileContent) -> TrackTable | None:
    root = content.root
    if root is None or root.tag not in ("TrackMate", "Tracks"):
        return None
    if root.tag == "Tracks":
        interval = content.number(root, "frameInterval") if "frameInterval" in root.attrib else np.nan
        fps, unit = per_second(interval, root.get("timeUnits", "")), root.get("spaceUnits", "")
        spots = _particles(content, root)
    else:
        model, image = root.find("Model"), root.find("Settings/ImageData")
        if model is None:
            raise content.wrong("<TrackMate> without <Model>, expected spots and tracks")
        unit = model.get("spatialunits", "")
        interval = content.number(image, "timeinterval") if image is not None else np.nan
        fps = per_second(interval, model.get("timeunits", ""))
        spots = _spots(content, model)
    rows = pd.DataFrame(list(spots), columns=["frame", "particle", "x", "y"])
    return TrackTable(rows, NAME, unit, fps=fps)


def _particles(content: FileContent, root: ET.Element) -> Iterator[tuple[float, ...]]:
    for number, particle in enumerate(root.iter("particle")):
        for detection in particle.iter("detection"):
            x, y, frame = (content.number(detection, name) for name in ("x", "y", "t"))
            yield frame, number, x, y


def _spots(content: FileContent, model: ET.Element) -> Iterator[tuple[float, ...]]:
    """The spots that edges of the tracks join, of those tracks that the user's filters left."""
    spots = {content.attribute(spot, "ID"): spot for spot in model.iterfind("AllSpots/SpotsInFrame/Spot")}
    kept = model.find("FilteredTracks")
    left = None if kept is None else {content.attribute(one, "TRACK_ID") for one in kept.iter("TrackID")}
    for track in model.iterfind("AllTracks/Track"):
        number = content.attribute(track, "TRACK_ID")
        if left is not None and number not in left:
            continue
        ends = ("SPOT_SOURCE_ID", "SPOT_TARGET_ID")
        for name in dict.fromkeys(content.attribute(edge, end) for edge in track.iter("Edge") for end in ends):
            if name not in spots:
                raise content.wrong(f"<Edge> of track {number} names spot {name}, which there is not")
            spot = spots[name]
            x, y, frame = (content.number(spot, key) for key in ("POSITION_X", "POSITION_Y", "FRAME"))
            yield frame, content.number(track, "TRACK_ID"), x, y


def write(tracks: Tracks, camera: Camera) -> str:
    return make_trackmate_xml(
        split_by_particle(tracks.particle, tracks.frame, tracks.x, tracks.y), camera.fps, "tracker"
    )
