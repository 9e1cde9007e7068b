"""Frames with the truth that trainers of detectors need: ids, centres, boxes and masks; recorded, or without end."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, overload

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from synthcam.dataset.recorded_dataset import RecordedClip
from synthcam.scene import ground_truth
from synthcam.scene.clip import Clip
from synthcam.scene.outlines import find_boxes, label_pixels
from synthcam.scene.scene import Scene, rebuild_clip
from synthcam_shared.arguments import check_arguments
from synthcam_shared.arrays import Array, Flags
from synthcam_shared.errors import InputError

MAX_FAILURES_IN_A_ROW = 10  # of clips that cannot be made; then the scene is at fault


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
    visible: Flags
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
    def masks(self) -> Flags:
        """(n, height, width): the pixels of each ball."""
        return np.asarray(self.labels == (self.ids + 1)[:, None, None])


def label_frames(clip: Clip, every: int = 1) -> Iterator[LabelledFrame]:
    """Render every n-th frame of a clip, and label it. Raises ValueError if the clip cannot be made."""
    bodies = clip.launch.bodies
    tracks = ground_truth.make_true_tracks(bodies, clip.view, clip.lamp, clip.frames, every=every, heights=clip.heights)
    return _label(clip, tracks, clip.pictures(every), every)


def label_recorded(clip: RecordedClip) -> Iterator[LabelledFrame]:
    """Label the frames of a recorded clip with their truth. Raises InputError if it has no film."""
    pictures, drawn = clip.pictures(), rebuild_clip(clip.number, clip.drawn, f"{clip.folder}, scene.json")
    return _label(drawn, clip.tracks, pictures, 1)


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


def encode_png(image: NDArray[Any], compression: int | None = None) -> bytes:
    """Encode a frame, or labels, as PNG of as many bits. compression: 0 to 9, in place of OpenCV's."""
    how = [] if compression is None else [cv2.IMWRITE_PNG_COMPRESSION, compression]
    return cv2.imencode(".png", image[..., ::-1] if image.ndim == 3 else image, how)[1].tobytes()


def to_8_bits(image: NDArray[Any], bits: int) -> NDArray[np.uint8]:
    """The upper 8 bits of counts: readers of trainers take no more."""
    return np.asarray(image if bits == 8 else image >> (bits - 8), np.uint8)


@overload
def stream(
    scene: Scene | str | Path,
    seed: int = 0,
    start: int = 0,
    step: int = 1,
    stop: int | None = None,
    every: int = 1,
    by: Literal["frame"] = "frame",
) -> Iterator[LabelledFrame]: ...
@overload
def stream(
    scene: Scene | str | Path,
    seed: int = 0,
    start: int = 0,
    step: int = 1,
    stop: int | None = None,
    every: int = 1,
    *,
    by: Literal["clip"],
) -> Iterator[list[LabelledFrame]]: ...
@check_arguments
def stream(
    scene: Scene | str | Path,
    seed: int = 0,
    start: int = 0,
    step: int = 1,
    stop: int | None = None,
    every: int = 1,
    by: Literal["frame", "clip"] = "frame",
) -> Iterator[LabelledFrame] | Iterator[list[LabelledFrame]]:
    """Make frames with their truth without end, in memory: clip after clip, the frames of each clip in order.

    Scene, seed, number of the clip and number of the frame alone decide a frame, in any process. Clip k is clip k of
    the dataset that ``synthcam generate SCENE --seed`` makes, to the last bit of its pixels.

    Parameters
    ----------
    scene : Scene, str or Path
        A scene, its file, or the name of a scene that comes with synthcam.
    seed : int
        Of everything random.
    start, step : int
        Number of the first clip, and the step to the next. Worker i of n takes ``start=i, step=n``.
    stop : int, optional
        The stream ends before this clip. None: it never ends.
    every : int
        Make every n-th frame of a clip only, from its first on. The others are not rendered.
    by : "frame" or "clip"
        What an item is: a frame, or the list of the frames of a clip.

    Yields
    ------
    LabelledFrame, or list of LabelledFrame
        A clip that cannot be made is left out with a `RuntimeWarning`.

    Raises
    ------
    InputError
        If an argument is wrong, or ten clips in a row cannot be made.
    NoGL
        If no OpenGL can render; `synthcam doctor` says what to install.

    Examples
    --------
    >>> import synthcam
    >>> scene = synthcam.Scene.read("oblique", camera={"size": [96, 64], "scale": 3e-4}, timing={"frames": 40})
    >>> frames = synthcam.stream(scene, seed=1, every=20)
    >>> [(frame.clip.number, frame.frame) for frame, _ in zip(frames, range(4))]
    [(0, 0), (0, 20), (1, 0), (1, 20)]
    """
    for name, value, least in (("seed", seed, 0), ("start", start, 0), ("step", step, 1), ("every", every, 1)):
        if value < least:
            raise InputError(f"{name}: expected {least} or more, not {value}")
    if by not in ("frame", "clip"):
        raise InputError(f"by: expected 'frame' or 'clip', not {by!r}")
    read = scene if isinstance(scene, Scene) else Scene.read(scene)
    numbers = itertools.count(start, step) if stop is None else range(start, stop, step)
    clips = make_clips(read, seed, numbers, every, lambda line: warnings.warn(line, RuntimeWarning, stacklevel=2))
    if by == "frame":
        return itertools.chain.from_iterable(clips)
    return map(list, clips)


def make_clips(
    scene: Scene, seed: int, numbers: Iterable[int], every: int, leave_out: Callable[[str], None]
) -> Iterator[Iterator[LabelledFrame]]:
    """Make the frames of each clip of a stream that can be made. leave_out: takes a line about each other one.

    Raises InputError if too many in a row cannot be made.
    """
    failed: list[str] = []
    for number in numbers:
        try:
            frames = label_frames(scene.draw(number, seed), every)
            first = next(frames)  # solves the motion, and prepares the renderer
        except ValueError as error:
            failed.append(f"clip {number} is left out: {' '.join(str(error).split())}")
            if len(failed) == MAX_FAILURES_IN_A_ROW:
                reason = f"{len(failed)} clips in a row cannot be made; the last: {error}"
                raise InputError(f"{scene.where}: {' '.join(reason.split())}") from None
            continue
        while failed:
            leave_out(failed.pop(0))
        yield itertools.chain([first], frames)
    for line in failed:
        leave_out(line)
