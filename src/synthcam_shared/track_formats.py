"""Write tracks as text in the formats of MOTChallenge, the Particle Tracking Challenge and TrackMate.

The writers are shared by exports of true tracks (synthcam) and of measured ones (tracker). Positions are in px, with
(0, 0) at the centre of the first pixel; frames and particles count from 0.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from typing import Any

Track = Iterable[Sequence[Any]]  # (frame, x, y) of one ball, in order of time
CHALLENGE_TAG = "TrackContestISBI2012"
MOT_CORNER_PX = 1.5  # of the centre of the first pixel, in a frame in which the picture's corner is (1, 1)


def split_by_particle(particle: Any, frame: Any, x: Any, y: Any) -> list[list[tuple[Any, Any, Any]]]:
    """Split columns of equal length into tracks to be written, in order of the particles' numbers."""
    tracks: dict[int, list[tuple[Any, Any, Any]]] = {}
    for ball, *row in zip(particle, frame, x, y, strict=True):
        tracks.setdefault(int(ball), []).append((row[0], row[1], row[2]))
    return [tracks[ball] for ball in sorted(tracks)]


def make_mot_line(frame: int, particle: int, x: float, y: float, side: float, rest: str) -> str:
    """Make one line of MOTChallenge: a square box round a ball, all numbers counted from 1.

    Milan et al. 2016, arXiv:1603.00831. rest: the columns after the box, from confidence on.
    """
    left, top = x - side / 2 + MOT_CORNER_PX, y - side / 2 + MOT_CORNER_PX
    return f"{frame + 1},{particle + 1},{left:.4f},{top:.4f},{side:.4f},{side:.4f},{rest}\n"


def make_challenge_xml(tracks: Iterable[Track], snr: str = "0", scenario: str = "balls") -> str:
    """Make the XML of the Particle Tracking Challenge: Chenouard et al. 2014, Nature Methods 11, 281.

    snr: peak over its own noise. scenario: a name of letters, digits, dots, dashes and underscores.
    """
    root = ET.Element("root")
    challenge = ET.SubElement(root, CHALLENGE_TAG, {"snr": snr, "density": "low", "scenario": scenario})
    for track in tracks:
        _add_detections(ET.SubElement(challenge, "particle"), track, "0")
    return _to_text(root)


def make_trackmate_xml(tracks: Sequence[Track], fps: float, made_by: str) -> str:
    """Make the XML that TrackMate's "Export tracks to XML file" writes: Tinevez et al. 2017, Methods 115, 80."""
    about = {"nTracks": str(len(tracks)), "spaceUnits": "pixel", "frameInterval": repr(1 / fps)}
    root = ET.Element("Tracks", about | {"timeUnits": "sec", "from": made_by})
    for track in tracks:
        spots = list(track)
        _add_detections(ET.SubElement(root, "particle", {"nSpots": str(len(spots))}), spots, "0.0")
    return _to_text(root)


def _add_detections(particle: ET.Element, track: Track, z: str) -> None:
    for frame, x, y in track:
        ET.SubElement(particle, "detection", {"t": str(frame), "x": f"{x:.6f}", "y": f"{y:.6f}", "z": z})


def _to_text(root: ET.Element) -> str:
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
