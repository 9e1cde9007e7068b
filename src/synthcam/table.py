"""A smooth curve, or a map of the plate, through a table of values, as integration needs it: without any kink.

Straight lines join the points. Gaussians with a standard deviation of 0.75 of the spacing round their corners. The
heights of the corners are such that the rounded line passes through the values. Beyond the ends the curve continues
straight and levels off within a twentieth of the range.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np

from synthcam_shared.arrays import Array

RELATIVE_TOLERANCE = 1e-9  # closer values, or edges of pieces, are the same
GAUSSIAN_WIDTH = 0.75  # over the mean spacing: curve and straight lines differ little
GAUSSIAN_REACH = 9.0  # standard deviations: beyond, a Gaussian is zero in double precision


@dataclass(frozen=True)
class _RoundedLines:
    """Lines that are straight between points except for their corners, which Gaussians round."""

    x: Array  # points (n,) at which the lines have heights
    period: float  # 0 for lines with ends
    corners: Array  # their positions (k,)
    width: Array  # standard deviations (k,) of their Gaussians
    bend: Array  # change (k, n) of slope at each corner for the line of height 1 at one point and 0 at the others

    @classmethod
    def of(cls, x: Array, period: float = 0.0) -> Self:
        if period:
            return cls._make_periodic(x, period)
        level_share = 0.05  # of the range: so far beyond its ends the curve is level
        gap, reach = np.diff(x), level_share * (x[-1] - x[0])
        slope = _slopes(gap, np.arange(len(x)), len(x))
        bend = np.concatenate([slope[:1], np.diff(slope, axis=0), -slope[-1:]])
        ends = [reach / (GAUSSIAN_REACH - 1)]
        width = np.concatenate([ends, GAUSSIAN_WIDTH * (gap[1:] + gap[:-1]) / 2, ends])
        return cls(x, 0.0, np.concatenate([[x[0] - reach], x[1:-1], [x[-1] + reach]]), width, bend)

    @classmethod
    def _make_periodic(cls, x: Array, period: float) -> Self:
        """Make periodic lines over as many turns to either side as the Gaussians reach."""
        gap = np.diff(np.append(x, x[0] + period))
        width = GAUSSIAN_WIDTH * (gap + np.roll(gap, 1)) / 2
        turns = np.arange(-1, 2) * (1 + math.ceil(GAUSSIAN_REACH * width.max() / period))
        turns = np.arange(turns[0], turns[-1] + 1)
        places = np.concatenate([x + period * t for t in turns])
        slope = _slopes(np.diff(places), np.arange(len(places)) % len(x), len(x))
        bend = np.concatenate([slope[:1], np.diff(slope, axis=0), -slope[-1:]])
        return cls(x, period, places, np.tile(width, len(turns)), bend)

    def inside(self, where: Any) -> Array:
        """Move points into the first turn, or to the range within which the curve is not level."""
        if self.period:
            return np.asarray(self.x[0] + np.mod(np.asarray(where) - self.x[0], self.period))
        return np.asarray(np.clip(where, *self._ends))

    @property
    def _ends(self) -> tuple[float, float]:
        if self.period:
            return float(self.x[0]), float(self.x[0] + self.period)
        reach = GAUSSIAN_REACH * self.width
        return float((self.corners - reach).min()), float((self.corners + reach).max())

    def through(self, values: Array) -> Array:
        """Return the heights (n, ...) with which the rounded line passes through values (n, ...). Raises ValueError."""
        worst_condition = 1e8  # beyond, the points are too uneven for the rounded line to follow the values
        matrix = self.pieces(np.eye(len(self.x)))(self.x)
        if not np.linalg.cond(matrix) < worst_condition:
            raise ValueError("x: expected points that are spaced more evenly")
        return np.asarray(np.linalg.solve(matrix, values.reshape(len(self.x), -1)).reshape(values.shape))

    def pieces(self, heights: Array) -> Any:
        """Return rounded lines of heights (n, lines) as piecewise polynomials that map points to (..., lines).

        A corner of width w at the distance z w adds w R(z). Here R = z P(z) + p(z), with the normal density p and its
        integral P. The m-th derivative of p is (-1)^m He_m(z) p(z), with the Hermite polynomials He_m.
        """
        from scipy.interpolate import PPoly
        from scipy.special import ndtr

        low, high = self._ends
        piece, terms = 0.5, 17  # length in standard deviations; the first term left out is 1e-16 of a corner
        steps = piece * np.arange(-round(GAUSSIAN_REACH / piece), round(GAUSSIAN_REACH / piece) + 1)
        breaks = np.unique(np.clip((self.corners[:, None] + self.width[:, None] * steps).ravel(), low, high))
        breaks = np.append(breaks[:-1][np.diff(breaks) > RELATIVE_TOLERANCE * (high - low)], high)
        breaks[0] = low
        bend = self.bend @ heights
        z = (breaks[:-1, None] - self.corners) / self.width
        near = abs(z) < GAUSSIAN_REACH - RELATIVE_TOLERANCE
        density = np.where(near, np.exp(-z * z / 2) / math.sqrt(2 * math.pi), 0.0)
        risen = np.where(near, ndtr(z), z > 0)
        out = np.empty((terms, len(z), heights.shape[1]))
        out[-1] = (self.width * (z * risen + density)) @ bend + heights[0]
        out[-2] = risen @ bend
        last, hermite = np.zeros_like(z), np.ones_like(z)
        for m in range(terms - 2):
            scale = (-1) ** m / math.factorial(m + 2)
            out[-3 - m] = (scale * hermite * density * self.width ** (-1.0 - m)) @ bend
            last, hermite = hermite, z * hermite - m * last
        return PPoly(out, breaks)


@dataclass(frozen=True)
class SmoothTable:
    """The smooth curve through the values of a table, periodic over an angle; or a map, smooth along each axis.

    Raises ValueError with what was expected.

    Examples
    --------
    >>> curve = SmoothTable((0.0, 0.1, 0.2), (0.20, 0.23, 0.24))
    >>> [round(float(v), 3) for v in curve(np.array([0.1, 0.15, 5.0]))]
    [0.23, 0.237, 0.24]
    """

    x: tuple[Any, ...]  # points, rising; for a map: pairs that form a whole grid, in any order
    y: tuple[Any, ...]  # a number, or a pair, at each point
    turn: bool = False  # x is an angle, rad, within one turn; a point a whole turn after the first must have its value

    def __post_init__(self) -> None:
        max_points, max_points_per_axis = 10_000, 1000
        if not 2 <= len(self.x) <= max_points:
            raise ValueError(f"x: expected 2 to {max_points} points, found {len(self.x)}")
        if len(self.y) != len(self.x):
            raise ValueError(f"y: expected a value for each of {len(self.x)} points, found {len(self.y)}")
        for name, values in (("x", self.x), ("y", self.y)):
            if not _are_uniform(values):
                raise ValueError(f"{name}: expected finite numbers, or pairs of them")
        if not self.plane:
            if not all(a < b for a, b in zip(self.x, self.x[1:], strict=False)):
                raise ValueError("x: expected rising points")
            if self.turn and self.x[-1] - self.x[0] > 2 * math.pi + 1e-6:
                raise ValueError("x: expected angles within one turn, rad")
        elif len(set(self.x)) != len(self.x) or math.prod(map(len, self._sides)) != len(self.x):
            raise ValueError("x: expected pairs that form a whole grid, each once")
        sides = [len(side) for side in self._sides] if self.plane else [len(self.x)]
        if max(sides) > max_points_per_axis:
            raise ValueError(f"x: expected at most {max_points_per_axis} points along an axis, found {max(sides)}")
        if min(sides) < 2 + self.turn:
            raise ValueError(f"x: expected {2 + self.turn} points or more along each axis")
        negligible = RELATIVE_TOLERANCE * float(np.abs(self.y).max())
        if self.turn and self._is_closed and np.abs(np.subtract(self.y[0], self.y[-1])).max() > negligible:
            raise ValueError("y: expected the same value after a whole turn as at first")
        _ = self._curve  # raises where the points are too uneven

    @property
    def plane(self) -> bool:
        """True for a map."""
        return isinstance(self.x[0], tuple)

    @property
    def parts(self) -> int:
        """Number of values at each point: 1 or 2."""
        return len(self.y[0]) if isinstance(self.y[0], tuple) else 1

    @cached_property
    def _sides(self) -> tuple[list[float], list[float]]:
        """The points along each axis of a map."""
        one, other = zip(*self.x, strict=True)
        return sorted(set(one)), sorted(set(other))

    @property
    def _is_closed(self) -> bool:
        return bool(abs(self.x[-1] - self.x[0] - 2 * math.pi) < 1e-6)

    @cached_property
    def _lines(self) -> tuple[_RoundedLines, ...]:
        """The rounded lines along each axis."""
        if self.plane:
            return tuple(_RoundedLines.of(np.array(side)) for side in self._sides)
        x = np.array(self.x[:-1] if self.turn and self._is_closed else self.x)
        return (_RoundedLines.of(x, 2 * np.pi if self.turn else 0.0),)

    @cached_property
    def _curve(self) -> Any:
        """The pieces of the curve, (..., parts); for a map the heights of the corners, (parts, points of each axis)."""
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
        """Return the values, (...) or (..., 2), at points: one array (...), two for a map."""
        inside = [line.inside(w) for line, w in zip(self._lines, where, strict=True)]
        if self.plane:
            one, other = (basis(w) for basis, w in zip(self._bases, inside, strict=True))
            out = np.einsum("...pj,...j->...p", np.tensordot(one, self._curve, (-1, 1)), other)
        else:
            out = self._curve(inside[0])
        return np.asarray(out if self.parts == 2 else out[..., 0])


Table = SmoothTable  # effect files that `discrepancy adopt` wrote of 0.1 import this name


def _slopes(gap: Array, columns: Any, count: int) -> Array:
    """Return slopes (gaps, count) of lines of height 1 at one point each; columns (gaps + 1,): which point."""
    out, row = np.zeros((len(gap), count)), np.arange(len(gap))
    np.add.at(out, (row, columns[:-1]), -1 / gap)
    np.add.at(out, (row, columns[1:]), 1 / gap)
    return out


def to_tuples(values: Sequence[Any] | Array) -> tuple[Any, ...]:
    """Turn lists and arrays into tuples of floats or of pairs, as a table holds them; other values stay."""
    values = values.tolist() if isinstance(values, np.ndarray) else values
    return tuple(tuple(map(_number, v)) if isinstance(v, list | tuple) else _number(v) for v in values)


def _number(value: Any) -> Any:
    return float(value) if isinstance(value, int | float) else value


def _are_uniform(values: tuple[Any, ...]) -> bool:
    """True when all values are finite numbers, or all are pairs of them."""
    pairs = isinstance(values[0], tuple)
    rows = values if pairs else [(v,) for v in values]
    same = all(isinstance(row, tuple) and len(row) == 1 + pairs for row in rows)
    return same and all(isinstance(v, float) and math.isfinite(v) for row in rows for v in row)
