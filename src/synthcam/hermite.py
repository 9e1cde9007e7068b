"""Known motions as tables that are cheap to look up: cubic Hermite pieces between knots, kinks among them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.kinematics import Array

Ints = NDArray[np.intp]
FINE, COARSE = 5e-4, 0.04  # s near a meeting; of the time from it, further off
NEARBY = 2e-5  # s


@dataclass(frozen=True)
class Table:
    """Places of k balls: knots (k, n), rising; at a piece's ends its place and velocity, (k, n - 1, 4) each."""

    knots: Array
    left: Array
    right: Array

    @classmethod
    def of(cls, states: Callable[[Array], Array], knots: Array) -> Table:
        """`states` maps times (k, m) of each ball's own to (x, y, vx, vy), (k, m, 4), just after a kink."""
        rising = np.maximum.accumulate(np.sort(knots, axis=1), axis=1)
        before = np.maximum(np.nextafter(rising[:, 1:], -np.inf), rising[:, :-1])
        return cls(rising, np.asarray(states(rising[:, :-1])), np.asarray(states(before)))

    def __call__(self, rows: Ints, times: Array) -> Array:
        """Places (r, m, 2) of the balls `rows` (r,) at times (r, m); beyond the knots they go straight on."""
        return self._look(rows, times)[0]

    def motion(self, rows: Ints, times: Array) -> tuple[Array, Array, Array]:
        """The same with velocities and accelerations."""
        place, s, h, a, b, beyond = self._look(rows, times)
        gap, wide = a[..., :2] - b[..., :2], np.where(h > 0, h, np.inf)
        rise = 6 * s * (s - 1) * gap + h * ((1 - s) * (1 - 3 * s) * a[..., 2:] + s * (3 * s - 2) * b[..., 2:])
        bend = 6 * (2 * s - 1) * gap + h * ((6 * s - 4) * a[..., 2:] + (6 * s - 2) * b[..., 2:])
        return place, rise / wide, np.where(beyond == 0, bend / wide**2, 0.0)

    def _look(self, rows: Ints, times: Array) -> tuple[Array, Array, Array, Array, Array, Array]:
        knots, last = self.knots, self.knots.shape[1] - 2
        apart = 2 * (np.ptp(knots) + 1.0)  # rows one after the other make one rising line, to be searched at once
        line = (knots[:, :-1] - knots.min() + apart * np.arange(len(knots))[:, None]).ravel()
        inside = np.clip(times, knots[rows, :1], knots[rows, -1:])
        found = np.searchsorted(line, inside - knots.min() + apart * rows[:, None], side="right") - 1
        piece = np.clip(found - (last + 1) * rows[:, None], 0, last)
        row = rows[:, None]
        start = knots[row, piece]
        wide = knots[row, piece + 1] - start
        s = ((inside - start) / np.where(wide > 0, wide, 1.0))[..., None]
        a, b, h = self.left[row, piece], self.right[row, piece], wide[..., None]
        place = (1 - s) ** 2 * ((1 + 2 * s) * a[..., :2] + s * h * a[..., 2:])
        place += s**2 * ((3 - 2 * s) * b[..., :2] + (s - 1) * h * b[..., 2:])
        beyond = (times - inside)[..., None]
        return place + beyond * np.where(beyond > 0, b[..., 2:], a[..., 2:]), s, h, a, b, beyond


class Follower:
    """Where balls `rows` of a table are, for an iteration that asks for nearly the same times again and again.

    Times within NEARBY of those last looked up are reached by velocity and acceleration.
    """

    def __init__(self, table: Table, rows: Ints) -> None:
        self._table, self._rows = table, rows
        self._last: tuple[Ints, Array, Array, Array, Array] | None = None

    def __call__(self, times: Array, which: Any) -> Array:
        """Places (r, m, 2) of the balls rows[which] (r,) at times (r, m) or (1, m)."""
        rows = self._rows[which]
        times = np.broadcast_to(times, (len(rows), times.shape[1]))
        if self._last is not None and self._last[1].shape == times.shape and np.array_equal(self._last[0], rows):
            _, then, place, velocity, acceleration = self._last
            later = (times - then)[..., None]
            if np.abs(later).max() < NEARBY:
                return np.asarray(place + (velocity + acceleration / 2 * later) * later)
        self._last = (rows, times, *self._table.motion(rows, times))
        return self._last[2]


def around(meeting: Array, start: float, end: float) -> Array:
    """Knots (k, n) from start to end, dense about the times `meeting` (k,)."""
    longest = float(max(end - meeting.min(), meeting.max() - start, FINE))
    steps = np.arange(np.ceil(np.log1p(longest * COARSE / FINE) / COARSE) + 1)
    offsets = FINE / COARSE * np.expm1(COARSE * steps)
    return np.asarray(np.clip(meeting[:, None] + np.concatenate([-offsets[:0:-1], offsets]), start, end))


def between(ends: Array, wide: Array, shares: Array) -> Array:
    """Places (k, n - 1, m, 2) at `shares` (m,) of the pieces between (x, y, vx, vy) (k, n, 4); wide: s, (k, n - 1)."""
    s, h = shares[:, None], wide[..., None, None]
    a, b = ends[:, :-1, None], ends[:, 1:, None]
    left = (1 - s) ** 2 * ((1 + 2 * s) * a[..., :2] + s * h * a[..., 2:])
    return np.asarray(left + s**2 * ((3 - 2 * s) * b[..., :2] + (s - 1) * h * b[..., 2:]))
