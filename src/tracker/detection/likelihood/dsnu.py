"""Estimates the fixed offsets of pixels (DSNU) from the visible plate, as a dark frame would give them."""

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array, Ints
from tracker.detection.candidates import EmptyPlate

MIN_FRAMES = 16  # from which offsets are estimated
MAX_DEVIATION = 4.0  # standard deviations; more is an outlier
SURROUNDINGS_PX = 9  # width of the neighbourhood from which an offset differs; what is smoother is light on the plate


class _ByteSums:
    """Sums of a few frames in bytes, in a third of the time that numbers of more bytes need."""

    frames_at_most = 8
    max_noise = 2.0  # counts, of a pixel; a bright one has up to twice as much
    below, shift = 20, 11  # counts from the plate to the floor, and by which the light may change: 8 x (20 + 11) < 255

    def __init__(self, level: NDArray[np.uint8]) -> None:
        self.frames, self.sums, self.lifted = 0, np.zeros_like(level), np.empty_like(level)
        self.floor = cv2.subtract(level, np.full_like(level, self.below))
        self.is_dark = not self.floor.any()
        step = max(1, len(level) // 8)
        self.thin = slice(step // 2, None, step)  # whole lines, which are read sooner than single pixels
        thin = level[self.thin].astype(np.int64)
        self.least, self.most = (np.clip(thin + by, 0, 255).astype(np.uint8) for by in (-self.shift, self.shift))

    def can_hold(self, frame: NDArray[Any]) -> bool:
        """True unless the light on the plate has changed: a few pixels, which something covers, do not matter."""
        few = 0.02  # share of the pixels that are looked at
        thin = frame[self.thin]
        off = np.count_nonzero((thin < self.least) | (thin > self.most))
        return bool(off <= few * thin.size)

    def add(self, frame: NDArray[np.uint8]) -> None:
        """Add what a frame exceeds the floor by."""
        over = frame if self.is_dark else cv2.subtract(frame, self.floor, dst=self.lifted)
        cv2.add(self.sums, over, dst=self.sums)
        self.frames += 1

    def empty_into(self, sums: NDArray[np.float32]) -> None:
        """Add the sums to longer ones, and begin again."""
        cv2.accumulate(self.sums, sums)
        self.sums[:] = 0
        self.frames = 0


class DsnuEstimator:
    """Averages the frames of a film, of each all but squares of half width `reach`, px, around its candidates."""

    def __init__(self, plate: EmptyPlate, reach: int) -> None:
        self.plate, self.frames, self.reach = plate, 0, reach
        self.sums, self.hidden = np.zeros((2, *plate.level.shape), np.float32)  # sums of what exceeds a floor
        is_calm = plate.level.dtype == np.uint8 and plate.noise <= _ByteSums.max_noise
        self.bytes = _ByteSums(plate.level) if is_calm else None

    def add(self, frame: NDArray[Any], rows: Ints, columns: Ints) -> None:
        """Add a frame (h, w) without the squares around the pixels (n,) of its candidates."""
        short = self.bytes if self.bytes is not None and self.bytes.can_hold(frame) else None
        sums, kept = self.sums if short is None else short.sums, []
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
            top, left = max(row - self.reach, 0), max(column - self.reach, 0)
            part = slice(top, row + self.reach + 1), slice(left, column + self.reach + 1)
            kept.append((part, sums[part].copy(), self.hidden[part] + 1.0))
        if short is not None:
            short.add(frame)
        else:
            cv2.accumulate(frame, self.sums)
            if self.bytes is not None and not self.bytes.is_dark:
                self.sums -= self.bytes.floor
        self.frames += 1
        for part, before, hidden in kept:  # squares may overlap
            sums[part], self.hidden[part] = before, hidden
        if short is not None and short.frames == short.frames_at_most:
            short.empty_into(self.sums)

    def offsets(self, rows: Ints, columns: Ints, spread: float) -> tuple[Array, float]:
        """The best linear estimate of pixels' own offsets, counts, and the standard deviation of its residuals.

        A pixel's mean differs from its surroundings by its offset, the remaining noise and the texture of the plate.
        The film shows how large these are together; the estimate is the offset's share of that. It is NaN where the
        plate was seen in less than a quarter of the frames. `spread` is the standard deviation of offsets, counts.
        """
        if self.frames < MIN_FRAMES:
            return np.full(np.broadcast_shapes(rows.shape, columns.shape), np.nan), spread
        seen = self.frames - self.hidden
        if self.bytes is not None:
            self.bytes.empty_into(self.sums)
        mean = self.sums / np.maximum(seen, 1.0)
        if self.bytes is not None and not self.bytes.is_dark:
            mean += self.bytes.floor
        hollow = seen < 0.25 * self.frames
        if hollow.any():
            mean[hollow] = self.plate.level[hollow]
        mean.ravel()[self.plate.hot] = self.plate.level.ravel()[self.plate.hot - 1]  # hot pixels stand alone
        mean -= cv2.blur(mean, (SURROUNDINGS_PX, SURROUNDINGS_PX))
        whole = max(_variance(mean[:: SURROUNDINGS_PX // 2, :: SURROUNDINGS_PX // 2].astype(np.float64)), 1e-12)
        rest = self.plate.noise**2 / self.frames
        own = min(max(whole - rest, 0.0), spread**2)
        over = mean[rows, columns].astype(np.float64)
        wide = whole + rest * (self.frames / np.maximum(seen[rows, columns], 1.0) - 1.0)
        # a mark on the plate, which a ball hides, is no offset
        over *= np.where(over * over > MAX_DEVIATION**2 * wide, 0.0, own / wide)
        over[hollow[rows, columns]] = np.nan
        return over, math.sqrt(own * (1.0 - own / whole))


def _variance(values: Array) -> float:
    """Variance of the values without outliers."""
    spread = float(np.std(values))
    for _ in range(3):
        spread = float(np.std(values[np.abs(values) <= MAX_DEVIATION * spread]))
    return spread**2
