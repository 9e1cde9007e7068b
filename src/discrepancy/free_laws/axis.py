"""What a free law depends on, and the series that it is made of: cosines of a range, waves of an angle, or numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from discrepancy.arrays import Array

WIDER = 1.2  # the cosines' range over the data's
LEAST = 1e-6  # of a smooth curve's variance: that of every coefficient at least


@dataclass(frozen=True)
class Axis:
    """What a law is left free in. kind: line, circle (an angle, rad) or set (of clips: a number for each).

    On a line, cosines of a range somewhat wider than the data's, so that no slope is forced on its ends; on a circle
    sines and cosines of the angle. All are smooth, as the integration of motion wants its laws.
    """

    name: str
    unit: str
    low: float
    high: float
    count: int
    kind: str = "line"
    letter: str = ""  # for formulas

    @property
    def _waves(self) -> Array:
        """Wave numbers, (count,)."""
        if self.kind == "circle":
            return np.asarray((np.arange(self.count) + 1) // 2, dtype=float)
        return np.asarray(np.arange(self.count) * np.pi / (WIDER * max(self.high - self.low, 1e-12)), dtype=float)

    def basis(self, x: Any) -> Array:
        """(..., count) at x."""
        x = np.asarray(x)[..., None]
        if self.kind == "set":
            return np.asarray(x == np.arange(self.count), dtype=float)
        if self.kind == "circle":
            return np.asarray(np.cos(self._waves * x - np.pi / 2 * (np.arange(self.count) % 2)))
        start = (self.low + self.high) / 2 - WIDER * (self.high - self.low) / 2
        return _cosines(self._waves[1] * (x[..., 0] - start), self.count)

    def prior_variances(self, length: float) -> Array:
        """Prior variances (count,) of the coefficients of a curve that changes over `length`, of the range or of a
        radian; its own variance is about one.

        The spectrum of a Gaussian process: Solin & Saerkkae, Statistics and Computing 30 (2020) 419.
        """
        if self.kind == "set":
            return np.ones(self.count)
        range_ = 1.0 if self.kind == "circle" else self.high - self.low
        out = np.exp(-((self._waves * length * range_) ** 2) / 2) + LEAST
        return np.asarray(out / out.sum())

    def grid(self, count: int) -> Array:
        """Places (count,) over the range, or each member of the set."""
        if self.kind == "set":
            return np.arange(self.count, dtype=float)
        return np.linspace(self.low, self.high, count)


def _cosines(angle: Array, count: int) -> Array:
    """cos(k angle), (..., count), by Chebyshev's recurrence: each is a multiplication, where a cosine takes ten."""
    out = np.ones((count, *angle.shape))
    out[1] = np.cos(angle)
    twice = 2 * out[1]
    for k in range(2, count):
        out[k] = twice * out[k - 1] - out[k - 2]
    return np.moveaxis(out, 0, -1)
