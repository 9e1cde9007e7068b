"""COCO: images/ and annotations/instances.json, with a box, a mask and the ball's number for each ball and frame.

Lin et al. 2014, arXiv:1405.0312. Pixels count from the picture's corner, (0, 0). A box goes round the ball's outline
and is cut at the rim of the picture. A mask, in compressed run lengths, has the pixels that the ball covers; area is
their number. Pictures have 8 bits: the upper ones of the counts.
"""

import json
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.dataset.labelled_frames import LabelledFrame, encode_png, label_recorded, to_8_bits
from synthcam.dataset.recorded_dataset import RecordedClip


def write(clips: Iterator[RecordedClip], folder: Path) -> None:
    for name in ("images", "annotations"):
        (folder / name).mkdir()
    images: list[dict[str, Any]] = []
    with (folder / "annotations" / "instances.json").open("w", encoding="ascii") as file:
        file.write('{"annotations": [')  # one by one: there may be millions
        numbers = count(1)
        for clip in clips:
            for frame in label_recorded(clip):
                name = f"{clip.number:06d}-{frame.frame:06d}.png"
                (folder / "images" / name).write_bytes(encode_png(to_8_bits(frame.image, clip.bits)))
                height, width = frame.image.shape[:2]
                about = {"id": len(images) + 1, "file_name": name, "width": width, "height": height}
                images.append(about | {"clip": clip.number, "frame": frame.frame})
                for annotation in _annotate(frame):
                    number = next(numbers)
                    named = {"id": number, "image_id": about["id"], "category_id": 1} | annotation
                    file.write(f"{',' * (number > 1)}\n{json.dumps(named)}")
        categories = [{"id": 1, "name": "ball", "supercategory": "object"}]
        rest = {"images": images, "categories": categories, "info": {"description": "synthcam"}, "licenses": []}
        file.write(f"\n], {json.dumps(rest)[1:]}\n")


def _annotate(frame: LabelledFrame) -> Iterator[dict[str, Any]]:
    """The annotations of the balls of which a pixel is seen."""
    height, width = frame.labels.shape
    for ball, (left, top, right, bottom) in zip(frame.ids.tolist(), (frame.boxes + 0.5).tolist(), strict=True):
        corner = int(left), int(top)
        covered = frame.labels[corner[1] : int(bottom) + 1, corner[0] : int(right) + 1] == ball + 1
        columns, rows = np.nonzero(covered.T)
        if len(columns):
            counts = _encode((columns + corner[0]) * height + rows + corner[1], height * width)
            yield {
                "segmentation": {"size": [height, width], "counts": counts},
                "area": len(columns),
                "bbox": [round(each, 4) for each in (left, top, right - left, bottom - top)],
                "iscrowd": 0,
                "track_id": ball,
            }


def _encode(covered: NDArray[np.int64], pixels: int) -> str:
    """Encode the covered pixels of so many, numbered down the columns, as pycocotools does.

    Runs off and on take turns. From the fourth on, a run is written as the difference to the last but one. Its digits,
    of five bits, are written from the lowest on, as characters from "0" on; 32 is added if more digits follow.
    """
    starts = covered[np.diff(covered, prepend=-2) > 1]
    ends = covered[np.diff(covered, append=pixels + 1) > 1] + 1
    edges = np.stack([starts, ends], axis=1).ravel()
    runs = np.diff(edges, prepend=0, append=pixels)
    runs = runs if runs[-1] else runs[:-1]
    runs[3:] = runs[3:] - runs[1:-2]
    text = []
    for run in runs.tolist():
        while True:
            digit, run = run & 31, run >> 5
            last = run == (-1 if digit & 16 else 0)
            text.append(chr(48 + digit + 32 * (not last)))
            if last:
                break
    return "".join(text)
