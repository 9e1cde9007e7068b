"""Slides solved, as series that are quick to read: places, and their means over exposures.

A series in w, a root of the share of time left. The cube root, where a slip turns: towards the end it turns as ln w, of
which only terms as small as w^6 ln w are left in the place. A mean is the difference of two sums over time, of which
dt ~ w^2 dw makes series in w again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.dynamics.collocation import matrices, product, reread, series
from synthcam.dynamics.kinematics import Array

SIZES = 10, 16, 24, 40, 64  # nodes of a series; the first piece begins with the second
TRUE = 3e-15  # m, of the last coefficients
ROUNDING = 3e-16
CLOSING = (
    1 - ((1 - matrices(10).nodes) / 2) ** 3
)  # of the time of a uniform end: nodes in the cube root of what is left
NARROW = 3e-4  # of a slide: over so little time a parabola says as much, and a difference of sums would be rounded


@dataclass(frozen=True)
class Reading:
    """Paths of k balls, from time 0 to `lasts` (k,).

    knots (p + 1, k): w where pieces end, falling from 1 to 0. Of each piece the coefficients (2, k, nodes) of the place
    and of its sum over the share of time, both less the place half way `base` (2, k, 1): sums are the smaller for it.
    """

    lasts: Array
    base: Array
    power: int
    knots: Array
    places: tuple[Array, ...]
    sums: tuple[Array, ...]

    @classmethod
    def of(cls, pieces: Sequence[tuple[Array, Array]], power: int) -> Reading:
        """pieces: times (k, n), rising, and places (2, k, n) at them, a smooth image of n Chebyshev nodes."""
        lasts, base = pieces[-1][0][:, -1], (pieces[0][1][..., :1] + pieces[-1][1][..., -1:]) / 2
        knots, places, sums = [np.ones(len(lasts))], list[Array](), list[Array]()
        sofar = np.zeros_like(base)
        for times, values in pieces:
            w = _root(times, lasts, power)
            knots.append(w[:, -1])
            first, wide = w[:, :1], w[:, :1] - w[:, -1:]
            here = 2 * (first - w) / wide - 1
            limit = TRUE + ROUNDING * np.abs(values).max()
            for size in SIZES[len(places) == 0 :]:
                c = product(reread(values - base, here, size), matrices(size).coefficients)
                if np.abs(c[..., -2:]).max() < limit:
                    break
            more = matrices(size + power)
            w = first - wide / 2 * (1 + more.nodes)
            rate = product(c, more.values[:size]) * (power * w ** (power - 1) * wide / 2)
            total = product(rate, more.integral) + sofar
            places.append(c)
            sums.append(product(total, more.coefficients))
            sofar = total[..., -1:]
        return cls(lasts, base, power, np.array(knots), tuple(places), tuple(sums))

    def means(self, middle: Array, wide: Any) -> Array:
        """Places (2, k, m) averaged over the times `wide`, a number or (k, m), about times (k, m)."""
        narrow = wide < NARROW * self.lasts[:, None] + 0 * middle
        out = np.zeros((2, *middle.shape))
        if not narrow.all():
            a, b = self._read(self.sums, middle, wide / 2)
            out = (b - a) * (self.lasts[:, None] / np.where(narrow, 1.0, wide))
        if narrow.any():
            a, b = self._read(self.places, middle, wide / np.sqrt(12))
            out = np.where(narrow, (a + b) / 2, out)
        return np.asarray(out + self.base)

    def _read(self, coefficients: Sequence[Array], middle: Array, half: Any) -> tuple[Array, Array]:
        """The series, (2, k, m), at the times middle - half and middle + half."""
        times = np.stack([middle - half, middle + half], axis=-1).reshape(len(middle), -1)
        w = _root(times, self.lasts, self.power)
        out = np.empty((2, *w.shape))
        for k, c in enumerate(coefficients):
            a, b = self.knots[k, :, None], self.knots[k + 1, :, None]
            late = w < a
            columns = np.flatnonzero(late.any(axis=0)) if k else np.arange(w.shape[1])
            if len(columns):
                part = slice(columns[0], columns[-1] + 1)
                found = series(c, np.clip((a + b - 2 * w[:, part]) / (a - b), -1.0, 1.0))
                out[..., part] = np.where(late[:, part], found, out[..., part]) if k else found
        return out[..., ::2], out[..., 1::2]


def _root(times: Array, lasts: Array, power: int) -> Array:
    left = 1 - np.clip(times / lasts[:, None], 0.0, 1.0)
    return np.asarray(left if power == 1 else np.cbrt(left))
