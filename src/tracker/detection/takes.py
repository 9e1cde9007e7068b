"""Takes of one film, between which the picture changes at once; frames that are given twice; the noise of a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracker.camera.lens import Array
from tracker.detection.candidates import ROUNDING

THIN = 16_000  # pixels of a frame that are compared with those of the next
CUT, LEAST = 6.0, 3.0  # times the usual change, and counts, by which half of all pixels differ after a cut
SHORT = 8  # frames, of a piece that is no take
AGAIN = 0.2  # of the change about it, a change so small that the frame before is shown again
ABOUT = 3  # frames on either side
BLANK = 0.1  # of the usual change, in a piece that shows nothing
ALIKE, MOST = 2.0, 0.9  # counts over four times the usual change, by which most pixels at most differ in one scene


@dataclass(frozen=True, eq=False)
class Takes:
    """What a pass over a film shows.

    Attributes
    ----------
    spans : tuple of (int, int)
        First and last frame of each take.
    scenes : tuple of int
        A number for each take: takes of one number show the same scene.
    repeated : set of int
        Frames that show the one before again.
    noise : float
        Of one pixel in one frame, counts.
    """

    spans: tuple[tuple[int, int], ...]
    scenes: tuple[int, ...]
    repeated: frozenset[int]
    noise: float

    def describe(self) -> list[str]:
        """What a user has to know."""
        said = []
        if len(self.spans) > 1:
            cut = ", ".join(f"{a} to {b}" for a, b in self.spans[:12]) + (", ..." if len(self.spans) > 12 else "")
            said.append(f"{len(self.spans)} takes, each followed on its own: frames {cut}")
        if self.repeated:
            first = min(self.repeated)
            said.append(f"{len(self.repeated)} frames show the one before again, frame {first} first: left out")
        return said


def find_takes(frames: Sequence[Any]) -> Takes:
    """Go once through a film."""
    step = max(1, int(np.sqrt(np.prod(np.shape(frames[0])) / THIN)))
    half, mean, spread, previous = [], [], [], None
    for frame in frames:
        thin = np.asarray(frame)[step // 2 :: step, step // 2 :: step].astype(np.float32)
        if previous is not None:
            change = np.abs(thin - previous)
            half.append(float(np.median(change)))
            mean.append(float(change.mean()))
            spread.append(_spread(thin - previous))
        previous = thin
    changes, means = np.array(half), np.array(mean)
    repeated = _again(means)
    usual = float(np.median(np.delete(changes, [k - 1 for k in repeated])))
    starts = [0, *(np.flatnonzero(changes > max(CUT * usual, LEAST)) + 1).tolist(), len(frames)]
    lively = BLANK * float(np.median(means))
    spans = [
        (a, b - 1)
        for a, b in pairwise(starts)
        if len(starts) == 2 or (b - a >= SHORT and means[a : b - 1].max() > lively)
    ] or [(0, len(frames) - 1)]
    fresh = np.delete(np.array(spread), [k - 1 for k in repeated])
    noise = max(float(np.median(fresh)) / np.sqrt(2), ROUNDING)
    middles = [np.asarray(frames[(a + b) // 2])[::step, ::step].astype(np.float32) for a, b in spans]
    return Takes(tuple(spans), _scenes(middles, ALIKE + 4 * usual), frozenset(repeated), noise)


def _spread(change: NDArray[np.float32]) -> float:
    """Standard deviation of what has not moved."""
    kept, spread = change, float(change.std())
    for _ in range(4):
        kept = change[np.abs(change) <= 4 * spread + 1]
        spread = float(kept.std()) if kept.size else 0.0
    return spread


def _again(means: Array) -> list[int]:
    """Frames that show the one before again."""
    found = []
    for k, change in enumerate(means):
        first = max(min(k - ABOUT, len(means) - 2 * ABOUT - 1), 0)
        about = means[first : first + 2 * ABOUT + 1]
        if change < AGAIN * np.quantile(about, 0.8):
            found.append(k + 1)
    return found


def _scenes(pictures: list[NDArray[np.float32]], alike: float) -> tuple[int, ...]:
    """A number for each take, the same where the pictures are but for their brightness."""
    kinds: list[NDArray[np.float32]] = []
    numbers = []
    for picture in pictures:
        level = picture - np.median(picture)
        same = [k for k, other in enumerate(kinds) if float(np.quantile(np.abs(level - other), MOST)) < alike]
        if not same:
            kinds.append(level)
        numbers.append(same[0] if same else len(kinds) - 1)
    return tuple(numbers)
