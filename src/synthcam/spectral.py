"""Smooth initial-value problems to machine precision: Chebyshev collocation, solved by Picard iteration.

The right-hand side is called on all nodes of a piece at once, so laws written for arrays cost little. A piece that the
nodes do not resolve, or on which the iteration does not settle, is halved.
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
Right = Callable[[Array, Array], Array]  # (n,), (n, k) -> (n, k)

NODES = 32
DEEPEST = 14


@dataclass(frozen=True)
class Path:
    """A solution in pieces: ends (p + 1,), coefficients (p, NODES, k)."""

    ends: Array
    coefficients: Array

    def __call__(self, x: Array) -> Array:
        """Values (len(x), k); outside the ends the outermost piece is continued."""
        rising = self.ends[-1] >= self.ends[0]
        inner = self.ends[1:-1]
        which = np.searchsorted(inner, x) if rising else len(inner) - np.searchsorted(inner[::-1], x)
        out = np.empty((len(x), self.coefficients.shape[2]))
        for k in np.unique(which):
            here, a, b = which == k, self.ends[k], self.ends[k + 1]
            out[here] = chebyshev.chebval((2 * x[here] - a - b) / (b - a), self.coefficients[k]).T
        return out


@cache
def _matrices() -> tuple[Any, Any, Any]:
    """Nodes on [-1, 1]; values -> coefficients; values -> integral from -1 at the nodes."""
    nodes = -np.cos(np.pi * np.arange(NODES) / (NODES - 1))
    to_coefficients = np.linalg.inv(chebyshev.chebvander(nodes, NODES - 1))
    integral = chebyshev.chebint(to_coefficients, lbnd=-1, axis=0)
    return nodes, to_coefficients, chebyshev.chebvander(nodes, NODES) @ integral


def integrate(right: Right, a: float, b: float, start: Array) -> Path:
    """y' = right(x, y) from a to b (b < a is allowed), y(a) = start (k,). Raises ValueError when it is not smooth."""
    ends, coefficients = [a], []
    y, stack = np.asarray(start, dtype=float), [(b, 0)]
    while stack:
        end, depth = stack.pop()
        piece = _piece(right, ends[-1], end, y)
        if piece is not None:
            y = piece.sum(axis=0)  # every Chebyshev polynomial is 1 at the right end
            ends.append(end)
            coefficients.append(piece)
        elif depth == DEEPEST:
            raise ValueError("a leg could not be integrated: a law of motion is not smooth there")
        else:
            stack += [(end, depth + 1), ((ends[-1] + end) / 2, depth + 1)]
    return Path(np.array(ends), np.array(coefficients))


@np.errstate(over="ignore", invalid="ignore")  # a piece that is too long may run away
def _piece(right: Right, a: float, b: float, start: Array) -> Array | None:
    """Coefficients (NODES, k) on [a, b], or None when the piece is too long."""
    nodes, to_coefficients, integral = _matrices()
    x = (a + b) / 2 + (b - a) / 2 * nodes
    y = np.repeat(start[None], NODES, axis=0)
    for _ in range(40):
        new = start + (b - a) / 2 * (integral @ right(x, y))
        size = np.abs(new).max(axis=0) + 1e-9
        change = float((np.abs(new - y) / size).max())
        y = new
        if not np.isfinite(change):
            return None
        if change < 1e-14:
            break
    else:
        return None
    c: Array = to_coefficients @ y
    return c if float((np.abs(c[-3:]) / size).max()) < 1e-13 else None
