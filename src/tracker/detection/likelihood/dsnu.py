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


class DsnuEstimator:
    """Averages the frames of a film, of each all but squares of half width `reach`, px, around its candidates."""

    def __init__(self, plate: EmptyPlate, reach: int) -> None:
        self.plate, self.frames, self.reach = plate, 0, reach
        self.sums, self.hidden = np.zeros((2, *plate.level.shape), np.float32)

    def add(self, frame: NDArray[Any], rows: Ints, columns: Ints) -> None:
        """Add a frame (h, w) without the squares around the pixels (n,) of its candidates."""
        kept = []
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
            top, left = max(row - self.reach, 0), max(column - self.reach, 0)
            part = slice(top, row + self.reach + 1), slice(left, column + self.reach + 1)
            kept.append((part, self.sums[part].copy(), self.hidden[part] + 1.0))
        cv2.accumulate(frame, self.sums)
        self.frames += 1
        for part, before, hidden in kept:  # squares may overlap
            self.sums[part], self.hidden[part] = before, hidden

    def offsets(self, rows: Ints, columns: Ints, spread: float) -> tuple[Array, float]:
        """The best linear estimate of pixels' own offsets, counts, and the standard deviation of its residuals.

        A pixel's mean differs from its surroundings by its offset, the remaining noise and the texture of the plate.
        The film shows how large these are together; the estimate is the offset's share of that. It is NaN where the
        plate was seen in less than a quarter of the frames. `spread` is the standard deviation of offsets, counts.
        """
        if self.frames < MIN_FRAMES:
            return np.full(np.broadcast_shapes(rows.shape, columns.shape), np.nan), spread
        seen = self.frames - self.hidden
        hollow = seen < 0.25 * self.frames
        mean = self.sums / np.maximum(seen, 1.0)
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
