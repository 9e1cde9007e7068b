"""TrackMate: one XML of tracks a clip, the simple kind that its "Export tracks to XML file" writes.

Tinevez et al. 2017, Methods 115, 80. t counts frames from 0, x and y are px with pixel centres at integers.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

from synthcam.dataset.recorded_clip import RecordedClip


def write(clips: Iterator[RecordedClip], folder: Path) -> None:
    for clip in clips:
        tracks = [clip.in_view(ball) for _, ball in clip.tracks.groupby("particle")]
        tracks = [track for track in tracks if len(track)]
        about = {
            "nTracks": str(len(tracks)),
            "spaceUnits": "pixel",
            "frameInterval": repr(1 / clip.camera["fps"]),
            "timeUnits": "sec",
            "from": "synthcam",
        }
        root = ET.Element("Tracks", about)
        for track in tracks:
            particle = ET.SubElement(root, "particle", {"nSpots": str(len(track))})
            for row in track.itertuples():
                position = {"x": f"{row.x_mean_px:.6f}", "y": f"{row.y_mean_px:.6f}", "z": "0.0"}
                ET.SubElement(particle, "detection", {"t": str(row.frame), **position})
        ET.indent(root)
        ET.ElementTree(root).write(folder / f"{clip.number:06d}_Tracks.xml", encoding="UTF-8", xml_declaration=True)
