"""The pixels' own offsets (DSNU), learnt from the plate where no ball hides it: a dark frame out of the film itself."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.camera.lens import Array
from tracker.detection.candidates import EmptyPlate

Ints = NDArray[np.int64]

FEWEST = 16  # frames
SEEN = 0.25  # of the frames, in which a pixel must show the plate
WIDE = 9  # px, of the surroundings over which an offset is counted: what is smoother is the plate's light
OUTLIER = 4.0  # deviations: a mark on the plate, which a ball hides, is no offset


class DsnuEstimator:
    """Mean of a film's frames, of each all but the squares ``reach`` px about what was found there."""

    def __init__(self, plate: EmptyPlate, reach: int) -> None:
        self.plate, self.frames, self.reach = plate, 0, reach
        self.sums, self.hidden = np.zeros((2, *plate.level.shape), np.float32)

    def add(self, frame: NDArray[Any], rows: Ints, columns: Ints) -> None:
        """Count one more frame (h, w), but for the squares about the pixels (n,) at which something was found."""
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
        """The best linear estimate of pixels' own offsets.

        A pixel's mean differs from its surroundings by its offset, the noise left in it and the plate's texture. The
        film shows how large these are together; the offset's share of that is taken.

        Parameters
        ----------
        rows, columns : int arrays
            The pixels; broadcast together.
        spread : float
            Standard deviation of offsets, counts.

        Returns
        -------
        offsets : array
            Counts; NaN where the plate was hardly seen.
        left : float
            Standard deviation of what the estimate leaves of the offsets, counts.
        """
        if self.frames < FEWEST:
            return np.full(np.broadcast_shapes(rows.shape, columns.shape), np.nan), spread
        seen = self.frames - self.hidden
        hollow = seen < SEEN * self.frames
        mean = self.sums / np.maximum(seen, 1.0)
        mean[hollow] = self.plate.level[hollow]
        mean.ravel()[self.plate.hot] = self.plate.level.ravel()[self.plate.hot - 1]  # hot pixels stand alone
        mean -= cv2.blur(mean, (WIDE, WIDE))
        whole = max(_variance(mean[:: WIDE // 2, :: WIDE // 2].astype(np.float64)), 1e-12)
        rest = self.plate.noise**2 / self.frames
        own = min(max(whole - rest, 0.0), spread**2)
        over = mean[rows, columns].astype(np.float64)
        wide = whole + rest * (self.frames / np.maximum(seen[rows, columns], 1.0) - 1.0)
        over *= np.where(over * over > OUTLIER**2 * wide, 0.0, own / wide)
        over[hollow[rows, columns]] = np.nan
        return over, math.sqrt(own * (1.0 - own / whole))


def _variance(values: NDArray[np.float64]) -> float:
    """Of the bulk of the values."""
    spread = float(np.std(values))
    for _ in range(3):
        spread = float(np.std(values[np.abs(values) <= OUTLIER * spread]))
    return spread**2
