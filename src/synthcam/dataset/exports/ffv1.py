"""FFV1: a lossless video (Matroska) for each clip, with its camera.json beside it; no truth.

RFC 9043. Counts of more than 8 bits are in the low bits of 16.
"""

import json
from collections.abc import Iterator
from pathlib import Path

from synthcam.dataset.recorded_dataset import RecordedClip
from synthcam.dataset.video import VideoWriter


def write(clips: Iterator[RecordedClip], folder: Path) -> None:
    for clip in clips:
        own = folder / f"{clip.number:06d}"
        own.mkdir()
        (own / "camera.json").write_text(json.dumps(clip.camera_json, indent=1) + "\n", encoding="utf-8")
        width, height = clip.camera_json["size"]
        how, fps = {"codec": "ffv1", "gamma": 1.0}, float(clip.camera_json["fps"])
        film = VideoWriter(own, how, fps, (width, height), clip.bits, "frames.mkv")
        for frame in clip.pictures():
            film.write(frame)
        film.close()
