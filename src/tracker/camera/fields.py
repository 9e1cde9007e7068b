"""Fields of interlaced film: finds which lines are exposed first, and makes frames of the fields.

The lines of an interlaced frame are exposed in two turns, the even and the odd ones half a frame time apart. A moving
edge then looks like a comb. Files of video may state it; those of frame grabbers and some converters do not.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.camera.frames import Frames


@dataclass
class FieldOrder:
    """Sums of squared differences between fields: those of a frame, and across to the next frame in both orders."""

    flagged: bool = False
    inside: float = 0.0
    top_first: float = 0.0
    bottom_first: float = 0.0
    near: float = 0.0  # squared second differences of what changes from frame to frame, to the next lines
    far: float = 0.0  # and to those after
    pixels: int = 0

    def add(self, before: NDArray[Any], after: NDArray[Any]) -> None:
        """Compares two frames; an odd last line is left out."""
        height = len(after) // 2 * 2
        top, bottom, top_next, bottom_next = before[:height:2], before[1:height:2], after[:height:2], after[1:height:2]
        self.inside += cv2.norm(top_next, bottom_next, cv2.NORM_L2SQR)
        self.top_first += cv2.norm(bottom, top_next, cv2.NORM_L2SQR)
        self.bottom_first += cv2.norm(top, bottom_next, cv2.NORM_L2SQR)
        if self.flagged or height < 6:
            return
        size: Any = cv2.absdiff(before, after)
        # counts of 255, and at least five standard deviations of the noise
        changed = size > max(16.0, 5 * 1.5 * float(np.median(size[::7, ::7])))
        rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
        if not len(rows):
            return
        box = slice(max(rows[0] - 2, 0), rows[-1] + 3), slice(columns[0], columns[-1] + 1)
        part = np.where(changed[box], after[box].astype(np.float32) - before[box], 0)
        self.pixels += int(np.count_nonzero(part))
        self.near += float(((part[2:-2] - (part[1:-3] + part[3:-1]) / 2) ** 2).sum())
        self.far += float(((part[2:-2] - (part[:-4] + part[4:]) / 2) ** 2).sum())

    @property
    def is_combed(self) -> bool:
        """True if what moves looks like a comb."""
        # squared steps to the next lines over those to the lines after: .1 to .9 of whole frames, noise 1
        min_comb = 1.2
        min_pixels = 200  # that change, over all frames that are compared
        return self.pixels >= min_pixels and self.near > min_comb * self.far

    def find_first(self) -> int | None:
        """The field that is exposed first, 0 for the top; None where both show one instant."""
        late = max(self.top_first, self.bottom_first) - self.inside
        order = self.top_first - self.bottom_first
        if not (self.flagged or self.is_combed) or abs(order) < 0.3 * late or late <= 0:
            return None
        return 0 if order < 0 else 1


def separate_fields(frames: Frames, order: int) -> Frames:
    """Two frames of each: its fields in the order of time, with the lines between by interpolation."""
    height = frames.shape[1]
    lines = np.arange(height)

    def fill(picture: NDArray[Any], parity: int) -> NDArray[Any]:
        between = (lines - parity) % 2  # 1 for a line of the other field
        above, below = lines - between, lines + between
        above = np.where(above < 0, below, above)
        below = np.where(below >= height, above, below)
        return np.asarray((picture[above].astype(np.uint32) + picture[below] + 1) // 2, picture.dtype)

    def fetch(source: Callable[[int], Any]) -> Callable[[int], Any]:
        return lambda k: fill(source(k // 2), (k + order) % 2)

    out = Frames(2 * len(frames), frames.shape[1:], frames.dtype, fetch(frames.__getitem__))
    out.numbers = np.repeat(2 * frames.numbers, 2) + np.tile([0, 1], len(frames))
    if frames.seconds is not None:
        out.seconds = np.repeat(frames.seconds, 2) + np.tile([0, 0.5 / frames.fps], len(frames))
    out.fps, out.lossy, out.aspect, out.fields = 2 * frames.fps, frames.lossy, frames.aspect, True
    out.contents = frames.contents
    if frames.colours is not None:
        out.colours = fetch(frames.colours)
    first = ("upper", "lower")[order]
    note = f"interlaced: the two fields of each frame, the {first} first, are frames of their own; --fields weave"
    out.faults = (*frames.faults, note)
    return out


def separate_or_note(frames: Frames, choice: str) -> Frames:
    """The fields of pictures or arrays, which never state them, if the user asks; else a note where they show."""
    if choice == "weave" or frames.shape[1] < 6:
        return frames
    order = FieldOrder()
    for k in np.unique(np.linspace(0, len(frames) - 2, 16).astype(int)).tolist():
        order.add(np.asarray(frames[k]), np.asarray(frames[k + 1]))
    if choice == "separate":
        order.flagged = True
        return separate_fields(frames, order.find_first() or 0)
    if order.is_combed:
        text = "every frame seems to hold two fields (interlaced): moving edges look like combs; --fields separate"
        frames.faults = (*frames.faults, f"{text} makes them frames of their own")
    return frames
