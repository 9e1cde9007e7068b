"""The fast first search: where in a frame something small stands out from the dark plate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.camera.lens import Array

SIGNIFICANCE = 6.5  # noise deviations of a box sum; one false find in some 10^10 pixels
MOST = 64  # finds a frame: beyond that it is no picture of a few balls
CROWDED = 0.3  # share of a frame's pixels over the threshold that is too much to be balls
RAISED = 0.01  # the same, from which on the plate itself may be lighter than it was
SHIFTED = 3.0  # counts, by which an encoder shifts a whole plate, or half of one, at most; more is no plate
ROUNDING = 0.29  # counts, the noise of rounding alone
ALONE = 0.25  # of a pixel's height, what its neighbours have at least beside a glint of width .55 px
CELL = 12  # px, of the coarse picture that gives the plate's smooth part
# Sorting network for the median of nine (Paeth 1990, Graphics Gems): exact, and as fast as the minimum.
MEDIAN_OF_NINE = (
    (1, 2), (4, 5), (7, 8), (0, 1), (3, 4), (6, 7), (1, 2), (4, 5), (7, 8), (0, 3), (5, 8), (4, 7), (3, 6), (1, 4),
    (2, 5), (4, 7), (4, 2), (6, 4), (4, 2),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class EmptyPlate:
    """The plate without balls: ``level`` (h, w) counts in the frames' type, ``noise`` counts a pixel a frame, and
    ``hot``: which pixels (k,) of the flattened plate stand out alone and are no ball.
    """

    level: NDArray[Any]
    noise: float
    hot: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))


def estimate_empty_plate(frames: Sequence[Any]) -> EmptyPlate:
    """Plate and noise of a clip from nine frames spread over it.

    The median of the nine loses what moves. What rests stays in it, and is found because it stands out
    from its surroundings: there the plate's smooth part, a median over about 60 px, takes its place.
    """
    last = len(frames) - 1
    sample = [np.array(frames[round(k * last / 8)]) for k in range(9)]
    noise = estimate_noise(sample)
    middle = median_of_nine(sample)
    smooth = _smooth(middle)
    over = np.asarray(cv2.subtract(middle, smooth, dtype=cv2.CV_32F), dtype=np.float32)
    risen = over >= 4.0 * noise / 3.0 + 1.0
    hot = _lone(over, np.flatnonzero(risen), noise)
    risen.ravel()[hot] = False
    wide = np.flatnonzero(cv2.dilate(risen.view(np.uint8), np.ones((7, 7), np.uint8)))
    kept = middle.ravel()[hot]
    middle.ravel()[wide] = np.rint(smooth.ravel()[wide]).astype(middle.dtype)
    middle.ravel()[hot] = kept
    return EmptyPlate(middle, noise, hot)


def _lone(over: NDArray[np.float32], risen: NDArray[np.int64], noise: float) -> NDArray[np.int64]:
    """Which of the risen pixels (k,) have only neighbours too dark for a glint, however sharp the optics."""
    h, w = over.shape
    row, column = risen // w, risen % w
    around = [
        over[np.clip(row + down, 0, h - 1), np.clip(column + right, 0, w - 1)]
        for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1))
    ]
    return np.asarray(risen[np.max(around, axis=0) < ALONE * over.ravel()[risen] + noise])


def median_of_nine(sheets: list[NDArray[Any]]) -> NDArray[Any]:
    """The median; the nine are overwritten, for fresh memory costs more than the sorting."""
    spare = np.empty_like(sheets[0])
    for low, high in MEDIAN_OF_NINE:
        one, two = sheets[low], sheets[high]
        sheets[low], spare = np.asarray(cv2.min(one, two, dst=spare)), one
        sheets[high] = np.asarray(cv2.max(one, two, dst=two))
    return sheets[4]


def _smooth(picture: NDArray[Any]) -> NDArray[np.float32]:
    h, w = picture.shape
    rows, columns = max(h // CELL, 1), max(w // CELL, 1)
    coarse = cv2.resize(picture.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
    calm = cv2.medianBlur(coarse, 5)
    return np.asarray(cv2.resize(calm, (w, h), interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def estimate_noise(sample: list[NDArray[Any]]) -> float:
    """Noise of one pixel in one frame, counts, from differences of frames; balls are too few to matter."""
    h, w = sample[0].shape
    step = max(1, math.isqrt(h * w // 4000))
    thin = np.stack([s[::step, ::step] for s in sample]).astype(np.float32)
    steps = np.diff(thin, axis=0)
    differences = steps[np.any(steps != 0.0, axis=(1, 2))].ravel()  # a frame given twice holds no noise
    if len(differences) == 0:
        return ROUNDING
    spread = float(np.std(differences))
    for _ in range(4):  # leave out what moved
        kept = differences[np.abs(differences) <= 4.0 * spread + 1.0]
        spread = float(np.std(kept)) if len(kept) else 0.0
    return max(spread / math.sqrt(2.0), ROUNDING)


@dataclass(frozen=True, eq=False)
class Candidates:
    """Candidates of one frame, brightest first: pixel ``column``, ``row``, and the box sum there, counts."""

    column: NDArray[np.int64]
    row: NDArray[np.int64]
    strength: Array
    crowded: bool = False


NONE = Candidates(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0))


class CandidateSearch:
    """Candidates of a frame: local maxima of a box sum over the plate, each the strongest within ``apart`` px."""

    def __init__(self, plate: EmptyPlate, sigma: float, apart: float) -> None:
        self.apart, self.plate = apart, plate
        self.box = max(3, 2 * round(1.2 * sigma) + 1)
        # Negative noise must survive an unsigned difference: subtract a little less than the plate.
        drop = math.ceil(3.0 * plate.noise)
        self.floor = cv2.subtract(plate.level, np.full_like(plate.level, drop))
        area = self.box * self.box
        small = plate.level.dtype == np.uint8 and area * 255 < 2**15
        self.depth = cv2.CV_16S if small else cv2.CV_32F
        # Kept between frames: fresh memory of this size costs more than the sums.
        self.lifted = np.empty_like(plate.level)
        self.sums = np.empty(plate.level.shape, np.int16 if small else np.float32)
        self.over = np.empty(plate.level.shape, np.bool_)
        least = area * drop + SIGNIFICANCE * self.box * plate.noise * math.sqrt(1.0 + 1.0 / 6.0)
        self.threshold = math.floor(least)  # whole, so that whole sums are compared as they are
        self.base = float(area * drop)

    @cached_property
    def smooth(self) -> NDArray[np.float32]:
        """The plate's smooth part."""
        return _smooth(self.plate.level)

    def __call__(self, frame: NDArray[Any]) -> Candidates:
        hits = self._over(frame, self.floor)
        if len(hits) > RAISED * self.sums.size:
            raised = np.rint(_smooth(frame) - self.smooth)
            level = self.floor + np.where(np.abs(raised) <= SHIFTED, raised, 0.0)
            hits = self._over(frame, np.clip(level, 0, np.iinfo(frame.dtype).max).astype(frame.dtype))
        if len(hits) == 0:
            return NONE
        if len(hits) > CROWDED * self.sums.size:
            return Candidates(NONE.column, NONE.row, NONE.strength, crowded=True)
        rows, columns = np.divmod(hits, frame.shape[1])
        return self._strongest(columns, rows, self.sums.ravel()[hits].astype(np.float64))

    def _over(self, frame: NDArray[Any], floor: NDArray[Any]) -> NDArray[np.int64]:
        """Pixels (k,) of the flattened frame whose box sum over `floor` exceeds the threshold; `sums` has the sums."""
        lifted = cv2.subtract(frame, floor, dst=self.lifted)
        box, edge = (self.box, self.box), cv2.BORDER_REFLECT
        sums = cv2.boxFilter(lifted, self.depth, box, dst=self.sums, normalize=False, borderType=edge)
        return np.flatnonzero(np.greater(sums, self.threshold, out=self.over).ravel())

    def _strongest(self, columns: NDArray[np.int64], rows: NDArray[np.int64], values: Array) -> Candidates:
        left = values.copy()
        chosen: list[int] = []
        while len(chosen) < MOST:
            best = int(left.argmax())  # the first of equals
            if left[best] <= 0:
                break
            chosen.append(best)
            across, down = columns - columns[best], rows - rows[best]
            left[across * across + down * down <= self.apart**2] = 0.0
        return Candidates(columns[chosen], rows[chosen], values[chosen] - self.base)


def estimate_coarse_positions(windows: Array, half: int) -> Array:
    """First positions (n, 2), px from the central pixel, of glints in (n, s, s) counts: centroid of the core."""
    core = windows[:, half - 1 : half + 2, half - 1 : half + 2]
    weight = np.maximum(core - np.median(windows.reshape(len(windows), -1), axis=1)[:, None, None], 0.0)
    total = np.maximum(weight.sum(axis=(1, 2)), 1e-9)
    offsets = np.arange(-1, 2)
    x = (weight.sum(axis=1) * offsets).sum(axis=1) / total
    y = (weight.sum(axis=2) * offsets).sum(axis=1) / total
    return np.column_stack([x, y]) * 1.3  # a core three pixels wide pulls to its middle
