"""YOLO: data.yaml, images/ and labels/, a text file for each frame with a box for each ball.

The text format of Darknet and Ultralytics: class, middle and size of the box, over width and height of the picture. The
class is 0, ball. Clips 1, 11, 21, ... are for validation, and all others for training; a single clip is for both.
Pictures have 8 bits: the upper ones of the counts.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import yaml

from synthcam.dataset.labelled_frames import encode_png, label_recorded, to_8_bits
from synthcam.dataset.recorded_dataset import RecordedClip


def write(clips: Iterator[RecordedClip], folder: Path) -> None:
    parts = set()
    for clip in clips:
        part = "val" if clip.number % 10 == 1 else "train"
        parts.add(part)
        for name in ("images", "labels"):
            (folder / name / part).mkdir(parents=True, exist_ok=True)
        for frame in label_recorded(clip):
            name = f"{clip.number:06d}-{frame.frame:06d}"
            image = encode_png(to_8_bits(frame.image, clip.bits))
            (folder / "images" / part / f"{name}.png").write_bytes(image)
            size = np.tile(frame.image.shape[1::-1], 2)
            low, high = np.split(frame.boxes + 0.5, 2, axis=1)
            boxes = np.concatenate([(low + high) / 2, high - low], axis=1) / size
            lines = ("0 " + " ".join(f"{value:.6f}" for value in box) + "\n" for box in boxes)
            (folder / "labels" / part / f"{name}.txt").write_text("".join(lines), encoding="ascii")
    about = {"train": "images/train", "val": "images/val" if "val" in parts else "images/train", "names": {0: "ball"}}
    (folder / "data.yaml").write_text(yaml.safe_dump(about, sort_keys=False), encoding="ascii")
