"""Smooth initial-value problems, many at once: Chebyshev collocation, solved by Picard iteration.

The right-hand side is called on all nodes of all problems together, so laws written for arrays cost little. A piece
that the nodes do not resolve, or on which the iteration does not settle, is halved, for all problems alike.
See Clenshaw & Norton, Comput. J. 6 (1963) 88; Trefethen, Approximation Theory and Practice (2013).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

Array = NDArray[np.float64]
Right = Callable[[Array, Array], Array]  # x (n,), y (problems, n, k) -> (problems, n, k)

NODES = 32
TOLERANCE = 1e-14
DEEPEST = 12


@dataclass(frozen=True)
class Path:
    """Solutions in pieces: ends (p + 1,), from the start on; coefficients (p, problems, NODES, k)."""

    ends: Array
    coefficients: Array

    def __call__(self, x: Array) -> Array:
        """Values (problems, m, k) at x (problems, m); outside the ends the outermost piece is continued."""
        if len(self.ends) == 2:
            return _series(self.coefficients[0], self._scaled(0, x))
        rising = self.ends[-1] >= self.ends[0]
        inner = self.ends[1:-1]
        which = np.searchsorted(inner, x) if rising else len(inner) - np.searchsorted(inner[::-1], x)
        out = np.empty((*x.shape, self.coefficients.shape[-1]))
        for k in range(len(self.ends) - 1):
            here = which == k
            if np.any(here):
                out = np.where(here[..., None], _series(self.coefficients[k], self._scaled(k, x)), out)
        return out

    def _scaled(self, k: int, x: Array) -> Array:
        a, b = self.ends[k], self.ends[k + 1]
        return np.asarray((2 * x - a - b) / (b - a))


def _series(c: Array, x: Array) -> Array:
    """Clenshaw's recurrence: c (problems, n, k) at x (problems, m) -> (problems, m, k)."""
    x2 = 2 * x[..., None]
    c = c[:, None]
    one, two = c[..., -2, :], c[..., -1, :]
    for k in range(3, c.shape[-2] + 1):
        one, two = c[..., -k, :] - two, one + two * x2
    return np.asarray(one + two * x[..., None])


@cache
def _matrices() -> tuple[Any, Any, Any]:
    """Nodes on [-1, 1]; values -> coefficients; values -> integral from -1 at the nodes."""
    nodes = -np.cos(np.pi * np.arange(NODES) / (NODES - 1))
    to_coefficients = np.linalg.inv(chebyshev.chebvander(nodes, NODES - 1))
    integral = chebyshev.chebint(to_coefficients, lbnd=-1, axis=0)
    return nodes, to_coefficients, chebyshev.chebvander(nodes, NODES) @ integral


def integrate(
    right: Right, a: float, b: float, start: Array, tolerance: float = TOLERANCE, deepest: int = DEEPEST
) -> Path:
    """y' = right(x, y) from a to b (b < a is allowed), y(a) = start (problems, k).

    Raises ValueError when a law of motion is not smooth: a piece halved `deepest` times is still too long.
    """
    ends, coefficients = [a], []
    y, stack = np.asarray(start, dtype=float), [(b, 0)]
    while stack:
        end, depth = stack.pop()
        piece = _piece(right, ends[-1], end, y, tolerance)
        if piece is not None:
            y = piece.sum(axis=-2)  # every Chebyshev polynomial is 1 at the right end
            ends.append(end)
            coefficients.append(piece)
        elif depth == deepest:
            raise ValueError("a leg could not be integrated: a law of motion is not smooth there")
        else:
            stack += [(end, depth + 1), ((ends[-1] + end) / 2, depth + 1)]
    return Path(np.array(ends), np.array(coefficients))


def _piece(right: Right, a: float, b: float, start: Array, tolerance: float) -> Array | None:
    """Coefficients (problems, NODES, k) on [a, b], or None when the piece is too long."""
    nodes, to_coefficients, integral = _matrices()
    x = (a + b) / 2 + (b - a) / 2 * nodes
    y = np.repeat(start[:, None], NODES, axis=1)
    for _ in range(40):
        with np.errstate(all="ignore"):  # a runaway piece is halved below
            new = start[:, None] + (b - a) / 2 * (integral @ right(x, y))
        size = np.abs(new).max(axis=1, keepdims=True) + 1e-9
        change = float((np.abs(new - y) / size).max())
        y = new
        if not np.isfinite(change):
            return None
        if change < tolerance:
            break
    else:
        return None
    c: Array = to_coefficients @ y
    return c if float((np.abs(c[:, -3:]) / size).max()) < 10 * tolerance else None
