"""TrackMate: one XML of tracks a clip, the simple kind that its "Export tracks to XML file" writes."""

from collections.abc import Iterator
from pathlib import Path

from synthcam.dataset.recorded_dataset import RecordedClip
from synthcam_shared.track_formats import make_trackmate_xml


def write(clips: Iterator[RecordedClip], folder: Path) -> None:
    for clip in clips:
        text = make_trackmate_xml(clip.visible_tracks(), clip.camera_json["fps"], "synthcam")
        (folder / f"{clip.number:06d}_Tracks.xml").write_text(text, encoding="UTF-8")
