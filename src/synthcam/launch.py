"""How a run begins: the balls' states at one instant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from synthcam.trajectory import Array, rolling_state


@dataclass(frozen=True)
class Launch:
    """States (balls, 9) at `time`, s. Before it every ball has been rolling or at rest; after it anything goes."""

    time: float
    states: Array

    @classmethod
    def pair(cls, radius: float, time: float, v0: float, b: float, heading: float, contact: ArrayLike) -> Launch:
        """Ball 1 at rest is touched by the rolling ball 2 at `time`, at the point `contact` (x, y) between them.

        v0 in m/s, heading in rad from x to y; b is the impact parameter over the diameter, |b| < 1: with d the heading,
        b = z . [d x (x2 - x1)] / 2R.
        """
        d = np.array([np.cos(heading), np.sin(heading)])
        n = np.sqrt(1 - b * b) * d - b * np.array([-d[1], d[0]])
        touch = np.asarray(contact, dtype=float)
        target = rolling_state(touch + radius * n, np.zeros(2), 0.0, radius)
        striker = rolling_state(touch - radius * n, v0 * d, 0.0, radius)
        return cls(time, np.stack([target, striker]))

    @classmethod
    def single(cls, radius: float, time: float, v0: float, heading: float, place: ArrayLike) -> Launch:
        """One ball that rolls through `place` (x, y) at `time`."""
        v = v0 * np.array([np.cos(heading), np.sin(heading)])
        return cls(time, rolling_state(np.asarray(place, dtype=float), v, 0.0, radius)[None])
