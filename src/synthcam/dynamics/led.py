"""Motion without closed form, as it was solved: states and mean places at any times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from synthcam.dynamics.collocation import Path, matrices, product, series
from synthcam.dynamics.forces import Flags, Ints
from synthcam.dynamics.kinematics import Array, fly, plate_state
from synthcam.dynamics.slide_series import CLOSING, Reading

SLIGHT = 1e-16  # m: coefficients of all balls that together are not worth their time
GAUSS, WEIGHTS = np.polynomial.legendre.leggauss(4)  # exact for a parabola, 1e-15 m for a roll


@dataclass(frozen=True)
class Led:
    """Motion of m balls from the times `begins` on for `lasts`, s (m,), which may be negative, as series over z.

    path (c, m, n): x, y, qx, qy, and where a ball slides ux, uy, wz; last of all, where slips pace it, the time.
    states (m, 9): at the beginning. flies: balls in the air. power: of the share of time left whose root is as smooth
    as the path, 0 where it is the series of the time. log, cut (m,): by how much ln s falls up to z = 1 where it paces,
    else 0, and the time at which it has.
    """

    begins: Array
    lasts: Array
    states: Array
    radius: Array
    gravity: float
    path: Path
    slides: bool
    power: int
    flies: Flags
    log: Array
    cut: Array

    @classmethod
    def even(cls, gravity: float, radius: Array, states: Array, lasts: Array, path: Array) -> Led:
        """Of balls on the plate that roll or rest, on path (4, m, n) over `lasts`."""
        fixed = Path(np.array([0.0, 1.0]), (path,)), False, 0, np.zeros(len(lasts), dtype=bool), 0 * lasts, lasts
        return cls(0 * lasts, lasts, states, radius, gravity, *fixed)

    def __getitem__(self, rows: Ints) -> Led:
        path = Path(self.path.ends, tuple(c[:, rows] for c in self.path.coefficients))
        of = {f: getattr(self, f)[rows] for f in ("begins", "lasts", "states", "radius", "flies", "log", "cut")}
        return replace(self, path=path, **of)

    def later(self, by: Array) -> Led:
        return replace(self, begins=self.begins + by)

    def pieces(self) -> tuple[Array, list[Led]]:
        """Each a series of its own where the time paces it; and the times between which they hold, (pieces + 1, m)."""
        ends = self.path.ends if self.power == 0 and not self.flies.any() else np.array([0.0, 1.0])
        knots, parts = self.begins + ends[:, None] * self.lasts, [self]
        if len(ends) > 2:
            whole, each = (
                np.array([0.0, 1.0]),
                zip(knots[:-1], np.diff(knots, axis=0), self.path.coefficients, strict=True),
            )
            parts = [replace(self, begins=t, lasts=d, path=Path(whole, (c,)), cut=d) for t, d, c in each]
        return knots, parts

    def at(self, times: Array) -> Array:
        """States (m, k, 9) at times (m, k) within it."""
        elapsed = times - self.begins[:, None]
        return self.state(self.path(self._along(elapsed)), elapsed)

    def state(self, y: Array, elapsed: Array) -> Array:
        """The states of which y (c, m, ...) is kept."""
        shape = (-1,) + (1,) * (elapsed.ndim - 1)
        x, q = np.moveaxis(y[:2], 0, -1), np.moveaxis(y[2:4], 0, -1)
        u, wz = (np.moveaxis(y[4:6], 0, -1), y[6]) if self.slides else (np.zeros(2), self.states[:, 8].reshape(shape))
        out = plate_state(x, q, u, wz, self.radius.reshape(shape))
        if self.flies.any():
            which = self.flies
            out[which] = fly(self.states[which], self.gravity, elapsed[which].reshape(which.sum(), -1)).reshape(
                out[which].shape
            )
            out[which, ..., 0:2], out[which, ..., 3:5] = x[which], q[which]
        return out

    def means(self, middle: Array, wide: Any) -> Array:
        """Centres (2, m, k) averaged over the times `wide`, a number or (m, k), about times (m, k)."""
        elapsed = middle - self.begins[:, None]
        if self.power:
            return self._reading.means(elapsed, wide)
        if np.ndim(wide) == 0 and len(self.path.coefficients) == 1:
            return self._even_means(elapsed, wide)
        return averaged(lambda times: self.path(self._along(times))[:2], elapsed, wide)

    def _even_means(self, elapsed: Array, wide: float) -> Array:
        """The mean of f over x +- h is the sum of h^(2j)/(2j+1)! f^(2j)(x)."""
        (c,) = self.path.coefficients
        half = np.minimum(np.abs(wide / self.lasts), 1.0)[:, None]  # a longer one does not lie within
        worth = np.flatnonzero(_sizes(c[:2]) > SLIGHT).max(initial=1)
        term = mean = c[:2, :, : worth + 1]
        curvature = matrices(term.shape[-1]).curvature
        for j in range(1, (term.shape[-1] + 1) // 2):
            term = product(term, curvature) * (half * half / (2 * j * (2 * j + 1)))
            mean = mean + term
            if _sizes(term).max() < SLIGHT:
                break
        return series(mean, 2 * self._along(elapsed) - 1)

    @cached_property
    def _reading(self) -> Reading:
        pieces = [(y[-1], y[:2]) for _, y in self.path.nodes()]
        if not self.log.any():
            return Reading.of(pieces, self.power)
        y = series(self.path.coefficients[-1], 2 * np.repeat(CLOSING[None], len(self.lasts), axis=0) - 1)
        return Reading.of([*pieces[:-1], (y[-1], y[:2])], self.power)

    @cached_property
    def _timing(self) -> Path:
        """The time since the beginning and its slope along the path, (2, m, n)."""
        wide, pieces = np.diff(self.path.ends), [c[-1:] for c in self.path.coefficients]
        slopes = [product(c, matrices(c.shape[-1]).slope) * (2 / w) for c, w in zip(pieces, wide, strict=True)]
        return Path(self.path.ends, tuple(np.concatenate(both) for both in zip(pieces, slopes, strict=True)))

    def _along(self, elapsed: Array) -> Array:
        """Where on the path its own time is `elapsed`: Newton, kept in brackets."""
        last = self.path.ends[-1]
        if not self.power:
            return elapsed * (last / self.lasts[:, None])
        elapsed = np.clip(elapsed, 0.0, self.lasts[:, None])
        low, high = np.zeros(elapsed.shape), np.full(elapsed.shape, last)
        share, log = np.clip(elapsed / self.cut[:, None], 0.0, 1.0), self.log[:, None]
        along = share
        if np.any(log):  # exact for constant friction
            along = np.where(log < 0, np.log1p(share * np.expm1(log)) / np.where(log < 0, log, 1.0), share)
        tolerance = 1e-15 * np.abs(self.lasts)[:, None]
        for _ in range(60):
            time, slope = self._timing(along)
            late = time > elapsed
            low, high = np.where(late, low, along), np.where(late, along, high)
            new = along - (time - elapsed) / np.where(slope > 0, slope, np.inf)
            far = (new - along) ** 2 * slope > tolerance  # what this turn leaves
            along = np.where(far & ((new < low) | (new > high)), (low + high) / 2, new)
            if not far.any():
                break
        return np.asarray(along)


def _sizes(coefficients: Array) -> Array:
    """(c, m, n) -> (n,): roots of sums of squares, no less than any; a maximum takes numpy longer."""
    return np.asarray(np.sqrt(np.einsum("cmn,cmn->n", coefficients, coefficients)))


def averaged(places: Callable[[Array], Array], middle: Array, wide: Any) -> Array:
    """Means (2, m, k) of places (2, m, times) over the times `wide` about `middle`, by Gauss quadrature."""
    if np.ndim(wide) == 0 and wide == 0:
        return places(middle)
    times = middle[:, None] + GAUSS[:, None] * (np.asarray(wide) / 2 + 0 * middle)[:, None]
    found = places(times.reshape(len(middle), -1)).reshape(2, *times.shape)
    return np.asarray(np.tensordot(found, WEIGHTS / 2, axes=(2, 0)))


def arrived(now: Array, goal: Array | float) -> Array:
    """The goal where only rounding keeps it from having been reached."""
    return np.where(np.abs(now - goal) <= 1e-15 * (1 + np.abs(goal)), goal, now)
