"""A curve, or a map of the plate, from a table of its values: smooth in between, constant beyond the ends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
DEGREE = 3  # of the polynomials from place to place; less of fewer than four places
MOST = 10_000  # places
CLOSED = 1e-6  # rad: so near to a whole turn after the first the last place is the first again
SAME = 1e-9  # of the largest size: so near to each other two values are one


@dataclass(frozen=True)
class Table:
    """The interpolating cubic spline of a table ("not-a-knot" at the ends; of two or three places of lower degree).

    Beyond the ends of a line, or the edges of a map, it has the value at the nearest one. Over an angle it is periodic.

    Attributes
    ----------
    x : tuple of float, or of pairs
        Places, rising; of a map pairs that form a whole grid, in any order.
    y : tuple of float, or of pairs
        A value at each, or two.
    turn : bool
        x is an angle, rad, within one turn; where the last place is a whole turn after the first, so must its value be.

    Raises
    ------
    ValueError
        Says what was expected.

    Examples
    --------
    >>> curve = Table((0.0, 0.1, 0.2), (0.20, 0.23, 0.24))
    >>> [round(float(v), 3) for v in curve(np.array([0.1, 0.15, 5.0]))]
    [0.23, 0.238, 0.24]
    """

    x: tuple[Any, ...]
    y: tuple[Any, ...]
    turn: bool = False

    def __post_init__(self) -> None:
        if not 2 <= len(self.x) <= MOST:
            raise ValueError(f"x: expected 2 to {MOST} places, found {len(self.x)}")
        if len(self.y) != len(self.x):
            raise ValueError(f"y: expected a value for each of {len(self.x)} places, found {len(self.y)}")
        for name, values in (("x", self.x), ("y", self.y)):
            if not _alike(values):
                raise ValueError(f"{name}: expected finite numbers, or pairs of them")
        if not self.plane:
            if not all(a < b for a, b in zip(self.x, self.x[1:], strict=False)):
                raise ValueError("x: expected rising places")
            if self.turn and self.x[-1] - self.x[0] > 2 * math.pi + CLOSED:
                raise ValueError("x: expected angles within one turn, rad")
        elif len(set(self.x)) != len(self.x) or math.prod(map(len, self._sides)) != len(self.x):
            raise ValueError("x: expected pairs that form a whole grid, each once")
        elif min(map(len, self._sides)) < 2:
            raise ValueError("x: expected two places or more along each axis")
        if self.turn and self._closed and np.abs(np.subtract(self.y[0], self.y[-1])).max() > self._slight:
            raise ValueError("y: expected the same value after a whole turn as at first")

    @property
    def plane(self) -> bool:
        """Whether it is a map."""
        return isinstance(self.x[0], tuple)

    @property
    def parts(self) -> int:
        """How many numbers it has at each place: 1 or 2."""
        return len(self.y[0]) if isinstance(self.y[0], tuple) else 1

    @cached_property
    def _sides(self) -> tuple[list[float], list[float]]:
        """The places along each axis of a map."""
        one, other = zip(*self.x, strict=True)
        return sorted(set(one)), sorted(set(other))

    @property
    def _closed(self) -> bool:
        return bool(abs(self.x[-1] - self.x[0] - 2 * math.pi) < CLOSED)

    @property
    def _slight(self) -> float:
        return SAME * float(np.abs(self.y).max())

    @cached_property
    def _spline(self) -> Any:
        """Of two parts its values have a last axis of two."""
        from scipy.interpolate import NdBSpline, make_interp_spline

        y = np.array(self.y, dtype=float)
        if not self.plane:
            x = np.array(self.x, dtype=float)
            if not self.turn:
                return make_interp_spline(x, y, k=min(DEGREE, len(x) - 1))
            if not self._closed:
                x, y = np.append(x, x[0] + 2 * np.pi), np.concatenate([y, y[:1]])
            y[-1] = y[0]
            return make_interp_spline(x, y, k=DEGREE, bc_type="periodic")
        sides = [np.array(side) for side in self._sides]
        grid = np.empty((*map(len, sides), *y.shape[1:]))
        grid[tuple(np.searchsorted(s, v) for s, v in zip(sides, np.array(self.x).T, strict=True))] = y
        degrees = [min(DEGREE, len(side) - 1) for side in sides]
        one = make_interp_spline(sides[0], grid, k=degrees[0], axis=0)
        other = make_interp_spline(sides[1], np.moveaxis(one.c, 1, 0), k=degrees[1], axis=0)
        return NdBSpline((one.t, other.t), np.moveaxis(other.c, 0, 1), tuple(degrees))

    def __call__(self, *where: Any) -> Array:
        """The values at places.

        Parameters
        ----------
        *where : (...) array
            One, or two of a map.

        Returns
        -------
        (...) array, or (..., 2)
        """
        if self.plane:
            inside = [np.clip(w, side[0], side[-1]) for w, side in zip(where, self._sides, strict=True)]
            return np.asarray(self._spline(np.stack(np.broadcast_arrays(*inside), axis=-1)))
        if self.turn:
            return np.asarray(self._spline(self.x[0] + np.mod(np.asarray(where[0]) - self.x[0], 2 * np.pi)))
        return np.asarray(self._spline(np.clip(where[0], self.x[0], self.x[-1])))


def plain(values: Sequence[Any] | Array) -> tuple[Any, ...]:
    """Lists and arrays as tuples of floats, or of pairs of them, as a table has them; what is neither stays."""
    values = values.tolist() if isinstance(values, np.ndarray) else values
    return tuple(tuple(map(_number, v)) if isinstance(v, list | tuple) else _number(v) for v in values)


def _number(value: Any) -> Any:
    return float(value) if isinstance(value, int | float) else value


def _alike(values: tuple[Any, ...]) -> bool:
    """Whether all are finite numbers, or all pairs of them."""
    pairs = isinstance(values[0], tuple)
    rows = values if pairs else tuple((v,) for v in values)
    size = 2 if pairs else 1
    return all(isinstance(r, tuple) and len(r) == size and all(map(_finite, r)) for r in rows)


def _finite(value: Any) -> bool:
    return isinstance(value, float) and math.isfinite(value)
