"""Smooth initial-value problems, many at once: Chebyshev collocation, solved by Picard iteration.

The right-hand side is called on all nodes of all problems together, so laws written for arrays cost little. A piece
that the nodes do not resolve, or on which the iteration does not settle, is halved, for all problems alike.
See Clenshaw & Norton, Comput. J. 6 (1963) 88; Trefethen, Approximation Theory and Practice (2013).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

Array = NDArray[np.float64]
Right = Callable[[Array, Array], Array]  # x (n,), y (problems, n, k) -> (problems, n, k)

NODES, FEW = 32, 14
TOLERANCE = 1e-14  # of the iteration
SETTLED = 1e-12  # what rounding may leave of the iteration's changes
RESOLVED = 1e-13  # of the last coefficients
LENIENT = 100  # with the shortest pieces, where a coarser resolution was asked for: a kink is in it
DEEPEST = 12


@dataclass(frozen=True)
class Path:
    """Solutions in pieces: ends (p + 1,), from the start on; coefficients (p, problems, NODES, k)."""

    ends: Array
    coefficients: Array

    def __call__(self, x: Array) -> Array:
        """Values (problems, m, k) at x (problems, m); outside the ends the outermost piece is continued."""
        ends = self.ends
        if len(ends) == 2:
            return np.asarray(_polynomials((2 * x - ends[0] - ends[1]) / (ends[1] - ends[0])) @ self.coefficients[0])
        rising = ends[-1] >= ends[0]
        inner = ends[1:-1]
        which = np.searchsorted(inner, x) if rising else len(inner) - np.searchsorted(inner[::-1], x)
        a, b = ends[which], ends[which + 1]
        polynomials = _polynomials((2 * x - a - b) / (b - a))
        out = np.empty((*x.shape, self.coefficients.shape[-1]))
        for k in range(len(ends) - 1):
            here = which == k
            columns = np.flatnonzero(here.any(axis=0))
            if len(columns):
                first, last = columns[0], columns[-1] + 1
                values = polynomials[:, first:last] @ self.coefficients[k]
                out[:, first:last] = np.where(here[:, first:last, None], values, out[:, first:last])
        return out

    def with_slope(self, k: int) -> Path:
        """The k-th value and its derivative."""
        c = self.coefficients[..., k]
        slope = np.zeros_like(c)
        slope[..., :-1] = chebyshev.chebder(c, axis=-1) * (2 / np.diff(self.ends))[:, None, None]
        return Path(self.ends, np.stack([c, slope], axis=-1))


def _polynomials(x: Array) -> Array:
    """Chebyshev polynomials (..., NODES) at x."""
    out = np.empty((NODES, *x.shape))
    out[0], out[1] = 1.0, x
    twice = 2 * x
    for k in range(2, NODES):
        np.multiply(twice, out[k - 1], out=out[k])
        out[k] -= out[k - 2]
    return np.moveaxis(out, 0, -1)


@dataclass(frozen=True)
class Matrices:
    """On the nodes of [-1, 1]: values -> coefficients, -> integrals from -1, -> values on the nodes of either half."""

    nodes: Array
    coefficients: Array
    integral: Array
    halves: tuple[Array, Array]


@cache
def matrices(size: int = NODES) -> Matrices:
    nodes = -np.cos(np.pi * np.arange(size) / (size - 1))
    coefficients = np.asarray(np.linalg.inv(chebyshev.chebvander(nodes, size - 1)), dtype=np.float64)
    integral = np.asarray(chebyshev.chebvander(nodes, size) @ chebyshev.chebint(coefficients, lbnd=-1, axis=0))
    left, right = (chebyshev.chebvander((nodes + side) / 2, size - 1) @ coefficients for side in (-1, 1))
    return Matrices(nodes, coefficients, integral, (left, right))


def integrate(
    right: Right,
    a: float,
    b: float,
    start: Array,
    resolved: float = RESOLVED,
    deepest: int = DEEPEST,
    few: bool = False,
) -> Path:
    """y' = right(x, y) from a to b (b < a is allowed), y(a) = start (problems, k).

    resolved: how small the last coefficients must be, over the largest value. Raises ValueError when a law of motion is
    not smooth: a piece halved `deepest` times is still too long. few: try it first with few nodes.
    """
    y = np.asarray(start, dtype=float)
    if few:
        values, good = _piece(right, a, b, y, np.repeat(y[:, None], FEW, axis=1), resolved)
        if good:
            piece = np.zeros((1, len(y), NODES, y.shape[1]))
            piece[0, :, :FEW] = matrices(FEW).coefficients @ values
            return Path(np.array([a, b]), piece)
    ends, coefficients = [a], []
    stack = [(b, 0, np.repeat(y[:, None], NODES, axis=1))]
    while stack:
        end, depth, guess = stack.pop()
        enough = resolved if depth < deepest or resolved == RESOLVED else LENIENT * resolved
        values, good = _piece(right, ends[-1], end, y, guess, enough)
        if good:
            piece = matrices().coefficients @ values
            y = piece.sum(axis=-2)  # every Chebyshev polynomial is 1 at the right end
            ends.append(end)
            coefficients.append(piece)
        elif depth == deepest:
            raise ValueError("a leg could not be integrated: a law of motion is not smooth there")
        else:
            usable = bool(np.all(np.abs(values) < 1e6))  # False for infinite ones too
            first, second = (half @ (values if usable else guess) for half in matrices().halves)
            stack += [(end, depth + 1, second), ((ends[-1] + end) / 2, depth + 1, first)]
    return Path(np.array(ends), np.array(coefficients))


def _piece(right: Right, a: float, b: float, start: Array, guess: Array, resolved: float) -> tuple[Array, bool]:
    """Values at the nodes of [a, b], (problems, nodes, k) like the guess, and whether they are the solution."""
    on = matrices(guess.shape[1])
    x = (a + b) / 2 + (b - a) / 2 * on.nodes
    y, change = guess, np.inf
    for _ in range(40):
        with np.errstate(all="ignore"):  # a runaway piece is halved
            new = start[:, None] + (b - a) / 2 * (on.integral @ right(x, y))
            size = np.abs(new).max(axis=1, keepdims=True) + 1e-9
            last, change = change, float((np.abs(new - y) / size).max())
        y = new
        if not np.isfinite(change):
            return y, False
        if change < 1e-3:
            tail = float((np.abs(on.coefficients[-3:] @ y) / size).max())
            if tail > 10 * change + resolved:  # no further turn will mend it
                return y, False
            if change < TOLERANCE or (change < SETTLED and change > last / 2):
                return y, tail < resolved
    return y, False
