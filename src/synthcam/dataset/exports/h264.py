"""H.264: a video (MP4) for each clip, as ordinary cameras write it, with its camera.json beside it; no truth.

h264:crf=23,gamma=1,chroma=420 are the settings, here with their defaults.
"""

from collections.abc import Iterator
from pathlib import Path

from synthcam.dataset.recorded_dataset import RecordedClip
from synthcam.dataset.video import write_videos


def write(clips: Iterator[RecordedClip], folder: Path, wishes: str = "") -> None:
    write_videos(clips, folder, f"h264:{wishes}")
