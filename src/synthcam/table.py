"""A curve, or a map of the plate, from a table of its values: with no kink anywhere, for motion to be integrated.

Straight lines from place to place, their corners rounded by Gaussians of a standard deviation of .75 of the distance
between places, and the corners' heights such that the rounded line goes through the values. Beyond the ends it goes on
straight, and levels off within a twentieth of the range.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
MOST, MOST_A_SIDE = 10_000, 1000  # places
CLOSED = 1e-6  # rad: so near to a whole turn after the first the last place is the first again
SAME = 1e-9  # of the largest size: so near to each other two values are one
WIDTH = 0.75  # of the Gaussian at a place, over the mean distance to the places beside: curve and values differ little
LEVEL = 0.05  # of the range: so far beyond its ends a curve is level
FAR = 9.0  # standard deviations: what a Gaussian has beyond is nothing
PIECE = 0.5  # standard deviations: length of a piece that is one polynomial
TERMS = 17  # of a piece: the first that is left out is 1e-16 of a corner
STEEPEST = 1e8  # condition: with places that stand too unevenly the rounded line hardly follows the values


@dataclass(frozen=True)
class SmoothTable:
    """The smooth curve through a table's values; over an angle it is periodic, of a map it is so along each axis.

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
    >>> curve = SmoothTable((0.0, 0.1, 0.2), (0.20, 0.23, 0.24))
    >>> [round(float(v), 3) for v in curve(np.array([0.1, 0.15, 5.0]))]
    [0.23, 0.237, 0.24]
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
            if not _are_uniform(values):
                raise ValueError(f"{name}: expected finite numbers, or pairs of them")
        if not self.plane:
            if not all(a < b for a, b in zip(self.x, self.x[1:], strict=False)):
                raise ValueError("x: expected rising places")
            if self.turn and self.x[-1] - self.x[0] > 2 * math.pi + CLOSED:
                raise ValueError("x: expected angles within one turn, rad")
        elif len(set(self.x)) != len(self.x) or math.prod(map(len, self._sides)) != len(self.x):
            raise ValueError("x: expected pairs that form a whole grid, each once")
        sides = [len(side) for side in self._sides] if self.plane else [len(self.x)]
        if max(sides) > MOST_A_SIDE:
            raise ValueError(f"x: expected at most {MOST_A_SIDE} places along an axis, found {max(sides)}")
        if min(sides) < 2 + self.turn:
            raise ValueError(f"x: expected {2 + self.turn} places or more along each axis")
        if self.turn and self._is_closed and np.abs(np.subtract(self.y[0], self.y[-1])).max() > self._negligible:
            raise ValueError("y: expected the same value after a whole turn as at first")
        _ = self._curve  # places too uneven are found here

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
    def _is_closed(self) -> bool:
        return bool(abs(self.x[-1] - self.x[0] - 2 * math.pi) < CLOSED)

    @property
    def _negligible(self) -> float:
        return SAME * float(np.abs(self.y).max())

    @cached_property
    def _lines(self) -> tuple[_RoundedLines, ...]:
        """Along each axis."""
        if self.plane:
            return tuple(_RoundedLines.of(np.array(side)) for side in self._sides)
        x = np.array(self.x[:-1] if self.turn and self._is_closed else self.x)
        return (_RoundedLines.of(x, 2 * np.pi if self.turn else 0.0),)

    @cached_property
    def _curve(self) -> Any:
        """Its pieces, (..., parts); of a map the heights of the lines' corners, (parts, sides' places)."""
        y = np.array(self.y).reshape(len(self.x), -1)
        if not self.plane:
            (line,) = self._lines
            return line.pieces(line.through(y[: len(line.x)]))
        grid = np.empty((*map(len, self._sides), y.shape[1]))
        grid[tuple(np.searchsorted(s, v) for s, v in zip(self._sides, np.array(self.x).T, strict=True))] = y
        one, other = self._lines
        return np.moveaxis(other.through(one.through(grid).swapaxes(0, 1)), -1, 0).swapaxes(1, 2)

    @cached_property
    def _bases(self) -> tuple[Any, ...]:
        return tuple(line.pieces(np.eye(len(line.x))) for line in self._lines)

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
        inside = [line.inside(w) for line, w in zip(self._lines, where, strict=True)]
        if self.plane:
            one, other = (basis(w) for basis, w in zip(self._bases, inside, strict=True))
            out = np.einsum("...pj,...j->...p", np.tensordot(one, self._curve, (-1, 1)), other)
        else:
            out = self._curve(inside[0])
        return np.asarray(out if self.parts == 2 else out[..., 0])


Table = SmoothTable  # effect files that `discrepancy adopt` wrote of 0.1 import this name


@dataclass(frozen=True)
class _RoundedLines:
    """Lines that are straight from place to place but for their corners, rounded by Gaussians.

    Attributes
    ----------
    x : (n,) array
        Places, at which they have heights.
    period : float
        0 where they have ends.
    corners, width : (k,) array
        Where the corners are, and the standard deviations of what rounds them.
    bend : (k, n) array
        The change of slope at each corner, of the line that has the height 1 at one place and 0 at the others.
    """

    x: Array
    period: float
    corners: Array
    width: Array
    bend: Array

    @classmethod
    def of(cls, x: Array, period: float = 0.0) -> _RoundedLines:
        if period:
            return cls._make_periodic(x, period)
        gap, reach = np.diff(x), LEVEL * (x[-1] - x[0])
        slope = _slopes(gap, np.arange(len(x)), len(x))
        bend = np.concatenate([slope[:1], np.diff(slope, axis=0), -slope[-1:]])
        width = np.concatenate([[reach / (FAR - 1)], WIDTH * (gap[1:] + gap[:-1]) / 2, [reach / (FAR - 1)]])
        return cls(x, 0.0, np.concatenate([[x[0] - reach], x[1:-1], [x[-1] + reach]]), width, bend)

    @classmethod
    def _make_periodic(cls, x: Array, period: float) -> _RoundedLines:
        """Over as many turns to either side as the Gaussians reach."""
        gap = np.diff(np.append(x, x[0] + period))
        width = WIDTH * (gap + np.roll(gap, 1)) / 2
        turns = np.arange(-1, 2) * (1 + math.ceil(FAR * width.max() / period))
        turns = np.arange(turns[0], turns[-1] + 1)
        places = np.concatenate([x + period * t for t in turns])
        slope = _slopes(np.diff(places), np.arange(len(places)) % len(x), len(x))
        bend = np.concatenate([slope[:1], np.diff(slope, axis=0), -slope[-1:]])
        return cls(x, period, places, np.tile(width, len(turns)), bend)

    def inside(self, where: Any) -> Array:
        """Places as the pieces have them: within the first turn, or no farther out than where it is level."""
        if self.period:
            return np.asarray(self.x[0] + np.mod(np.asarray(where) - self.x[0], self.period))
        return np.asarray(np.clip(where, *self._ends))

    @property
    def _ends(self) -> tuple[float, float]:
        if self.period:
            return float(self.x[0]), float(self.x[0] + self.period)
        return float((self.corners - FAR * self.width).min()), float((self.corners + FAR * self.width).max())

    def through(self, values: Array) -> Array:
        """The heights (n, ...) with which the rounded line goes through these values (n, ...). Raises ValueError."""
        matrix = self.pieces(np.eye(len(self.x)))(self.x)
        if not np.linalg.cond(matrix) < STEEPEST:
            raise ValueError("x: expected places that stand apart more evenly")
        return np.asarray(np.linalg.solve(matrix, values.reshape(len(self.x), -1)).reshape(values.shape))

    def pieces(self, heights: Array) -> Any:
        """Polynomials, pieces of the rounded lines of heights (n, lines): called with places, they give (..., lines).

        Of a corner of width w that is z w away: w R(z), R = z P(z) + p(z), with the normal density p and its integral
        P; the m-th derivative of p is (-1)^m He_m(z) p(z), with Hermite's polynomials.
        """
        from scipy.interpolate import PPoly
        from scipy.special import ndtr

        low, high = self._ends
        steps = PIECE * np.arange(-round(FAR / PIECE), round(FAR / PIECE) + 1)
        breaks = np.unique(np.clip((self.corners[:, None] + self.width[:, None] * steps).ravel(), low, high))
        breaks = np.append(breaks[:-1][np.diff(breaks) > SAME * (high - low)], high)
        breaks[0] = low
        bend = self.bend @ heights
        z = (breaks[:-1, None] - self.corners) / self.width
        near = abs(z) < FAR - SAME
        density = np.where(near, np.exp(-z * z / 2) / math.sqrt(2 * math.pi), 0.0)
        risen = np.where(near, ndtr(z), z > 0)
        out = np.empty((TERMS, len(z), heights.shape[1]))
        out[-1] = (self.width * (z * risen + density)) @ bend + heights[0]
        out[-2] = risen @ bend
        last, hermite = np.zeros_like(z), np.ones_like(z)
        for m in range(TERMS - 2):
            scale = (-1) ** m / math.factorial(m + 2)
            out[-3 - m] = (scale * hermite * density * self.width ** (-1.0 - m)) @ bend
            last, hermite = hermite, z * hermite - m * last
        return PPoly(out, breaks)


def _slopes(gap: Array, columns: Any, count: int) -> Array:
    """Of lines (gaps, count), each of the height 1 at one place: columns (gaps + 1,) says whose place it is."""
    out, row = np.zeros((len(gap), count)), np.arange(len(gap))
    np.add.at(out, (row, columns[:-1]), -1 / gap)
    np.add.at(out, (row, columns[1:]), 1 / gap)
    return out


def to_tuples(values: Sequence[Any] | Array) -> tuple[Any, ...]:
    """Lists and arrays as tuples of floats, or of pairs of them, as a table has them; what is neither stays."""
    values = values.tolist() if isinstance(values, np.ndarray) else values
    return tuple(tuple(map(_number, v)) if isinstance(v, list | tuple) else _number(v) for v in values)


def _number(value: Any) -> Any:
    return float(value) if isinstance(value, int | float) else value


def _are_uniform(values: tuple[Any, ...]) -> bool:
    """Whether all are finite numbers, or all pairs of them."""
    pairs = isinstance(values[0], tuple)
    rows = values if pairs else tuple((v,) for v in values)
    size = 2 if pairs else 1
    return all(isinstance(r, tuple) and len(r) == size and all(map(_finite, r)) for r in rows)


def _finite(value: Any) -> bool:
    return isinstance(value, float) and math.isfinite(value)
