"""Particle Tracking Challenge: one XML a clip, as in Chenouard et al. 2014, Nature Methods 11, 281.

A particle holds its detections: t counts frames from 0; x, y in px with pixel centres at integers; z is 0.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

from synthcam.dataset.recorded_clip import RecordedClip


def write(clips: Iterator[RecordedClip], folder: Path) -> None:
    for clip in clips:
        root = ET.Element("root")
        name = "".join(c if c.isalnum() or c in "-_." else "_" for c in clip.scene)
        about = {"snr": f"{_snr(clip):.1f}", "density": "low", "scenario": name}
        challenge = ET.SubElement(root, "TrackContestISBI2012", about)
        tracks = [clip.in_view(ball) for _, ball in clip.tracks.groupby("particle")]
        for track in tracks:
            particle = ET.SubElement(challenge, "particle") if len(track) else challenge
            for row in track.itertuples():
                position = {"x": f"{row.x_mean_px:.6f}", "y": f"{row.y_mean_px:.6f}", "z": "0"}
                ET.SubElement(particle, "detection", {"t": str(row.frame), **position})
        ET.indent(root)
        ET.ElementTree(root).write(folder / f"{clip.number:06d}.xml", encoding="UTF-8", xml_declaration=True)


def _snr(clip: RecordedClip) -> float:
    """Peak over its own noise, the challenge's measure."""
    sensor, exposure = clip.drawn["sensor"], clip.camera["exposure"]
    peak = sensor["glint_peak"] * sensor["gain"]
    return float(peak / math.sqrt(peak + sensor["dark"] * exposure + sensor["read_noise"] ** 2))
