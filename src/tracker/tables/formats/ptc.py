"""Particle Tracking Challenge: XML as in Chenouard et al. 2014, Nature Methods 11, 281.

A particle holds its detections: t counts frames from 0; x, y in px with pixel centres at integers; z is 0.
"""

import pandas as pd

from synthcam_shared.track_formats import CHALLENGE_TAG, make_challenge_xml, split_by_particle
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.tables.content import FileContent
from tracker.tables.table import TrackTable

NAME = "the Particle Tracking Challenge's XML"
FROM_XML = True
SUFFIX = ".xml"


def read(content: FileContent) -> TrackTable | None:
    root = content.root
    challenge = None if root is None else root if root.tag == CHALLENGE_TAG else root.find(CHALLENGE_TAG)
    if challenge is None:
        return None
    rows = [
        (content.number(detection, "t"), number, content.number(detection, "x"), content.number(detection, "y"))
        for number, particle in enumerate(challenge.iter("particle"))
        for detection in particle.iter("detection")
    ]
    return TrackTable(pd.DataFrame(rows, columns=["frame", "particle", "x", "y"]), NAME, "px")


def write(tracks: Tracks, camera: Camera) -> str:
    return make_challenge_xml(split_by_particle(tracks.particle, tracks.frame, tracks.x, tracks.y))
