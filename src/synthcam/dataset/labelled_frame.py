"""A frame with the truth that trainers of detectors need: ids, centres, boxes and masks of its balls."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam.scene import ground_truth
from synthcam.scene.clip import Clip
from synthcam.scene.outlines import find_boxes, label_pixels
from synthcam.scene.scene import rebuild_clip
from synthcam_shared.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

    from synthcam.dataset.recorded_clip import RecordedClip

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class LabelledFrame:
    """One frame and the truth about the n balls of which a part is in the picture. `stream` makes it.

    Attributes
    ----------
    clip : Clip
        The clip that it belongs to; ``clip.number`` is its number, ``clip.camera_json`` what an experimenter knows of
        the camera.
    frame : int
        Its number in the clip.
    image : ndarray
        (height, width), of a colour camera (height, width, 3): uint8 or uint16 counts.
    ids : ndarray
        (n,) numbers of the balls, the ``particle`` of the tracks.
    centres : ndarray
        (n, 2) px, means over the exposure.
    boxes : ndarray
        (n, 4) px: left, top, right, bottom of the balls' outlines at mid-exposure, cut at the rim of the picture.
    visible : ndarray
        (n,) True if the whole ball is in the picture.
    positions : ndarray
        (n, 3) centres in the world at mid-exposure, m.

    Examples
    --------
    >>> import synthcam
    >>> small = {"size": [96, 64], "scale": 3e-4}
    >>> scene = synthcam.Scene.read("oblique", camera=small, timing={"frames": 2, "contact_frame": 1})
    >>> frame = next(synthcam.stream(scene, seed=1))
    >>> frame
    Frame 0 of clip 0 of oblique: 2 balls, 96 x 64 px
    >>> frame.masks.shape
    (2, 64, 96)
    """

    clip: Clip
    frame: int
    image: NDArray[Any]
    ids: NDArray[np.int64]
    centres: Array
    boxes: Array
    visible: NDArray[np.bool_]
    positions: Array

    def __repr__(self) -> str:
        (width, height), balls = self.clip.camera.size, len(self.ids)
        name = f"Frame {self.frame} of clip {self.clip.number} of {self.clip.drawn['name']}"
        return f"{name}: {balls} ball{'s' * (balls != 1)}, {width} x {height} px"

    @cached_property
    def labels(self) -> NDArray[np.uint16]:
        """(height, width): for each pixel 1 + id of the ball that covers its centre at mid-exposure; 0 for none."""
        clip, numbers = self.clip, (self.ids + 1).astype(np.uint16)
        radii, heights = clip.launch.bodies.radius[self.ids], clip.heights[self.ids]
        return label_pixels(clip.camera, self.positions, radii, self.boxes, numbers, heights)

    @property
    def masks(self) -> NDArray[np.bool_]:
        """(n, height, width): the pixels of each ball."""
        return np.asarray(self.labels == (self.ids + 1)[:, None, None])


def label_frames(clip: Clip, every: int = 1) -> Iterator[LabelledFrame]:
    """Render every n-th frame of a clip, and label it. Raises ValueError if the clip cannot be made."""
    bodies = clip.launch.bodies
    tracks = ground_truth.make_true_tracks(bodies, clip.view, clip.lamp, clip.frames, every=every, heights=clip.heights)
    return _label(clip, tracks, clip.pictures(every), every)


def label_recorded(clip: RecordedClip) -> Iterator[LabelledFrame]:
    """Label the frames of a recorded clip with their truth. Raises InputError if it has no film."""
    if not clip.video:
        raise InputError(f"{clip.stack}: no such file; expected a dataset with video")
    drawn = rebuild_clip(clip.number, clip.drawn, f"{clip.folder}, scene.json")
    return _label(drawn, clip.tracks, clip.pictures(), 1)


def _label(clip: Clip, tracks: pd.DataFrame, pictures: Iterator[NDArray[Any]], every: int) -> Iterator[LabelledFrame]:
    columns = ["x_mean_px", "y_mean_px", "visible", "x", "y", "z"]
    radii = clip.launch.bodies.radius
    rows = tracks.sort_values(["frame", "particle"])[columns].to_numpy(float).reshape(-1, len(radii), len(columns))
    for k, (image, row) in enumerate(zip(pictures, rows, strict=True)):
        boxes = find_boxes(clip.camera, row[:, 3:], radii, clip.heights)
        ids = np.flatnonzero((boxes[:, 2:] > boxes[:, :2]).all(axis=1))
        shown = row[ids]
        yield LabelledFrame(
            clip=clip,
            frame=k * every,
            image=image,
            ids=ids,
            centres=shown[:, :2],
            boxes=boxes[ids],
            visible=shown[:, 2] > 0,
            positions=shown[:, 3:],
        )


def encode_png(image: NDArray[Any]) -> bytes:
    """Encode a frame, or labels, as PNG of as many bits."""
    data = cv2.imencode(".png", image[..., ::-1] if image.ndim == 3 else image)[1]
    return data.tobytes()


def to_8_bits(image: NDArray[Any], bits: int) -> NDArray[np.uint8]:
    """The upper 8 bits of counts: readers of trainers take no more."""
    return np.asarray(image if bits == 8 else image >> (bits - 8), np.uint8)
