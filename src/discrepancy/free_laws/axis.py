"""The axis of a free law and its series: cosines of a range, harmonics of an angle, or a number for each clip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from discrepancy.arrays import Array


@dataclass(frozen=True)
class Axis:
    """The quantity that a free law depends on, with the series over it: smooth terms, as the integration of motion
    requires.

    kind: "line", cosines over 1.2 times the range, so that the slope at its ends is free; "circle", sines and cosines
    of an angle, rad; "set", a number for each clip.
    """

    name: str
    unit: str
    low: float  # end of the covered range, as is high
    high: float
    count: int  # coefficients
    kind: str = "line"
    letter: str = ""  # for formulas

    @property
    def _waves(self) -> Array:
        """Wave numbers, (count,)."""
        if self.kind == "circle":
            return np.asarray((np.arange(self.count) + 1) // 2, dtype=float)
        return np.asarray(np.arange(self.count) * np.pi / (1.2 * max(self.high - self.low, 1e-12)), dtype=float)

    def basis(self, x: Any) -> Array:
        """Evaluate all terms at x, (..., count)."""
        x = np.asarray(x)[..., None]
        if self.kind == "set":
            return np.asarray(x == np.arange(self.count), dtype=float)
        if self.kind == "circle":
            return np.asarray(np.cos(self._waves * x - np.pi / 2 * (np.arange(self.count) % 2)))
        start = (self.low + self.high) / 2 - 1.2 * (self.high - self.low) / 2
        return _cosines(self._waves[1] * (x[..., 0] - start), self.count)

    def prior_variances(self, length: float) -> Array:
        """Prior variances (count,) of the coefficients of a curve whose own variance is about one.

        They are the spectrum of a Gaussian process with a squared exponential covariance: Solin & Saerkkae, Statistics
        and Computing 30 (2020) 419. length: over which the curve changes, in ranges or in radians.
        """
        if self.kind == "set":
            return np.ones(self.count)
        range_ = 1.0 if self.kind == "circle" else self.high - self.low
        out = np.exp(-((self._waves * length * range_) ** 2) / 2) + 1e-6  # no coefficient is excluded
        return np.asarray(out / out.sum())

    def grid(self, count: int) -> Array:
        """Evenly spaced coordinates (count,) over the range, or every member of a set."""
        if self.kind == "set":
            return np.arange(self.count, dtype=float)
        return np.linspace(self.low, self.high, count)


def _cosines(angle: Array, count: int) -> Array:
    """cos(k angle), (..., count), by Chebyshev's recurrence, which is ten times faster than as many cosines."""
    out = np.ones((count, *angle.shape))
    out[1] = np.cos(angle)
    twice = 2 * out[1]
    for k in range(2, count):
        out[k] = twice * out[k - 1] - out[k - 2]
    return np.moveaxis(out, 0, -1)
