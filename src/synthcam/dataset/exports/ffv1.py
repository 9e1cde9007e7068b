"""FFV1: a lossless video (Matroska) for each clip, with its camera.json beside it; no truth.

RFC 9043. Counts of more than 8 bits are in the low bits of 16.
"""

import json
import os
from collections.abc import Iterator
from pathlib import Path

import cv2

from synthcam.dataset.recorded_dataset import RecordedClip
from synthcam.dataset.video import check_video
from synthcam_shared.errors import InputError


def write(clips: Iterator[RecordedClip], folder: Path) -> None:
    for clip in clips:
        own = folder / f"{clip.number:06d}"
        own.mkdir()
        (own / "camera.json").write_text(json.dumps(clip.camera_json, indent=1) + "\n", encoding="utf-8")
        depth = cv2.CV_8U if clip.bits == 8 else cv2.CV_16U
        colour = bool(clip.drawn["camera"].get("colour"))
        if colour and depth == cv2.CV_16U:
            raise InputError(f"{clip.stack}: colour of {clip.bits} bits; generate --encode ffv1 keeps it")
        kind = [cv2.VIDEOWRITER_PROP_IS_COLOR, int(colour), cv2.VIDEOWRITER_PROP_DEPTH, depth]
        code = cv2.VideoWriter.fourcc(*"FFV1")
        path, size = own / "frames.mkv", tuple(clip.camera_json["size"])
        frames = clip.pictures()
        film = cv2.VideoWriter(os.fspath(path), cv2.CAP_FFMPEG, code, float(clip.camera_json["fps"]), size, kind)
        if not film.isOpened():
            raise InputError(f"{path}: this OpenCV cannot write FFV1")
        for frame in frames:
            film.write(frame[..., ::-1] if colour else frame)
        film.release()
        check_video(path, clip.frames)
