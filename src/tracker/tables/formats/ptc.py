"""Particle Tracking Challenge: XML as in Chenouard et al. 2014, Nature Methods 11, 281.

A particle holds its detections: t counts frames from 0; x, y in px with pixel centres at integers; z is 0.
"""

import xml.etree.ElementTree as ET

import numpy as np
import pandas as pd

from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.tables.content import Content
from tracker.tables.table import TrackTable

NAME = "the Particle Tracking Challenge's XML"
SUFFIX = ".xml"
TAG = "TrackContestISBI2012"


def read(content: Content) -> TrackTable | None:
    root = content.root
    challenge = None if root is None else root if root.tag == TAG else root.find(TAG)
    if challenge is None:
        return None
    rows = [
        (content.number(detection, "t"), number, content.number(detection, "x"), content.number(detection, "y"))
        for number, particle in enumerate(challenge.iter("particle"))
        for detection in particle.iter("detection")
    ]
    return TrackTable(pd.DataFrame(rows, columns=["frame", "particle", "x", "y"]), NAME, "px")


def write(tracks: Tracks, camera: Camera) -> str:
    root = ET.Element("root")
    challenge = ET.SubElement(root, TAG, {"snr": "0", "density": "low", "scenario": "balls"})
    for ball in np.unique(tracks.particle):
        particle = ET.SubElement(challenge, "particle")
        rows = tracks.particle == ball
        for frame, x, y in zip(tracks.frame[rows], tracks.x[rows], tracks.y[rows], strict=True):
            ET.SubElement(particle, "detection", {"t": str(frame), "x": f"{x:.6f}", "y": f"{y:.6f}", "z": "0"})
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
