"""Smooth initial-value problems, many at once: Chebyshev collocation, solved by Picard iteration.

The right-hand side is called on all nodes of all problems together, so laws written for arrays cost little. A piece
that few nodes do not resolve is done again with more; one that the most do not, or on which the iteration does not
settle, is halved, for all problems alike. Arrays are (components, problems, nodes): long last axes make numpy fast.
See Clenshaw & Norton, Comput. J. 6 (1963) 88; Trefethen, Approximation Theory and Practice (2013).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

Array = NDArray[np.float64]
Right = Callable[[Array, Array], Array]  # x (n,), y (c, problems, n) -> (c, problems, n)

FEWEST, MOST = 14, 32  # nodes of a piece
TOLERANCE = 1e-14  # of the iteration
SETTLED = 1e-12  # what rounding may leave of the iteration's changes
RESOLVED = 1e-13  # of the last coefficients
LENIENT = 100  # with the shortest pieces, where a coarser resolution was asked for: a kink is in it
DEEPEST = 12
HOPELESS = 100  # times what is to be resolved
TURNS = 40
BLOCK = 240  # problems; OpenBLAS shares out products of over 2^18 multiplications


@dataclass(frozen=True)
class Path:
    """Solutions in pieces: ends (p + 1,), from the start on; coefficients (c, problems, nodes) of each piece."""

    ends: Array
    coefficients: tuple[Array, ...]

    def __call__(self, x: Array) -> Array:
        """Values (c, problems, m) at x (problems, m); outside the ends the outermost piece is continued."""
        ends = self.ends
        if len(self.coefficients) == 1:
            return series(self.coefficients[0], (2 * x - ends[0] - ends[1]) / (ends[1] - ends[0]))
        rising = ends[-1] >= ends[0]
        inner = ends[1:-1]
        which = np.searchsorted(inner, x) if rising else len(inner) - np.searchsorted(inner[::-1], x)
        out = np.empty((len(self.coefficients[0]), *x.shape))
        for k, coefficients in enumerate(self.coefficients):
            here = which == k
            columns = np.flatnonzero(here.any(axis=0))
            if len(columns):
                part = slice(columns[0], columns[-1] + 1)
                local = (2 * x[:, part] - ends[k] - ends[k + 1]) / (ends[k + 1] - ends[k])
                values = series(coefficients, np.clip(local, -1.1, 1.1))
                out[..., part] = np.where(here[:, part], values, out[..., part])
        return out

    def last(self) -> Array:
        """Values (c, problems) at the end."""
        return np.asarray(self.coefficients[-1].sum(axis=-1))  # every Chebyshev polynomial is 1 there


def series(coefficients: Array, x: Array) -> Array:
    """Chebyshev series (c, problems, nodes) at x (problems, m): (c, problems, m)."""
    size = coefficients.shape[-1]
    polynomials = np.empty((len(x), size, x.shape[1]))
    polynomials[:, 0], polynomials[:, 1] = 1.0, x
    twice = 2 * x
    for k in range(2, size):
        np.multiply(twice, polynomials[:, k - 1], out=polynomials[:, k])
        polynomials[:, k] -= polynomials[:, k - 2]
    return (np.ascontiguousarray(coefficients.swapaxes(0, 1)) @ polynomials).swapaxes(0, 1)


@dataclass(frozen=True)
class Matrices:
    """On the nodes of [-1, 1]: values -> coefficients, -> integrals from -1, -> values on the nodes of either half.

    All are to be multiplied from the right. slope, curvature: of a series' coefficients.
    """

    nodes: Array
    coefficients: Array
    integral: Array
    halves: tuple[Array, Array]
    slope: Array
    curvature: Array


@cache
def matrices(size: int) -> Matrices:
    nodes = -np.cos(np.pi * np.arange(size) / (size - 1))
    coefficients = np.asarray(np.linalg.inv(chebyshev.chebvander(nodes, size - 1)), dtype=np.float64)
    integral = np.asarray(chebyshev.chebvander(nodes, size) @ chebyshev.chebint(coefficients, lbnd=-1, axis=0))
    left, right = (chebyshev.chebvander((nodes + side) / 2, size - 1) @ coefficients for side in (-1, 1))
    slope = np.zeros((size, size))
    slope[:-1] = chebyshev.chebder(np.eye(size), axis=0)
    lines = coefficients, integral, left, right, slope, slope @ slope
    c, i, a, b, s, ss = (np.ascontiguousarray(x.T) for x in lines)
    return Matrices(nodes, c, i, (a, b), s, ss)


@cache
def finer(few: int, more: int) -> Array:
    """Values on few nodes -> on more."""
    onto = chebyshev.chebvander(matrices(more).nodes, few - 1)
    return np.asarray(matrices(few).coefficients @ onto.T)


def integrate(
    right: Right,
    knots: Sequence[float],
    start: Array,
    guess: Callable[[Array], Array] | None = None,
    resolved: float = RESOLVED,
    deepest: int = DEEPEST,
    few: int = FEWEST,
) -> Path:
    """y' = right(x, y) from the first knot to the last, piece by piece between them (falling ones are allowed).

    y = start (c, problems) at the first. guess: x (n,) -> (c, problems, n), what y may be like. resolved: how small the
    last coefficients must be, over the largest value. few: the nodes to try first. Raises ValueError when a law of
    motion is not smooth: a piece halved `deepest` times is still too long.
    """
    y = np.asarray(start, dtype=float)
    ends, coefficients = [float(knots[0])], []
    stack: list[tuple[float, int, Array | None]] = [(float(end), 0, None) for end in reversed(knots[1:])]
    while stack:
        end, depth, values = stack.pop()
        begin = ends[-1]
        enough = resolved if depth < deepest or resolved == RESOLVED else LENIENT * resolved
        good, tail = False, 0.0
        for size in (few, MOST) if values is None else (MOST,):
            if tail ** (MOST / few) > HOPELESS * enough:  # so much would more nodes leave
                break
            if values is None:
                x = (begin + end) / 2 + (end - begin) / 2 * matrices(size).nodes
                values = np.repeat(y[..., None], size, axis=-1) if guess is None else guess(x)
            elif values.shape[-1] < size:
                values = product(values, finer(values.shape[-1], size))
            values, good, tail = _piece(right, begin, end, y, values, enough)
            if good:
                break
            if not np.all(np.abs(values) < 1e6):  # False for infinite ones too
                values, guess = None, None
        if good:
            assert values is not None
            piece = product(values, matrices(values.shape[-1]).coefficients)
            y = piece.sum(axis=-1)
            ends.append(end)
            coefficients.append(piece)
        elif depth == deepest:
            raise ValueError("a leg could not be integrated: a law of motion is not smooth there")
        elif values is None or values.shape[-1] < MOST:
            stack += [(end, depth + 1, None), ((begin + end) / 2, depth + 1, None)]
        else:
            first, second = (product(values, half) for half in matrices(MOST).halves)
            stack += [(end, depth + 1, second), ((begin + end) / 2, depth + 1, first)]
    return Path(np.array(ends), tuple(coefficients))


def _piece(right: Right, a: float, b: float, start: Array, guess: Array, resolved: float) -> tuple[Array, bool, float]:
    """Values at the nodes of [a, b], (c, problems, nodes) like the guess; are they the solution; the last coefficients.

    Gives up at once where already the guess leads to more than these nodes hold.
    """
    on = matrices(guess.shape[-1])
    x = (a + b) / 2 + (b - a) / 2 * on.nodes
    integral, ending = (b - a) / 2 * on.integral, on.coefficients[:, -3:]
    y, size, change = guess, np.empty(0), np.inf
    for turn in range(TURNS):
        with np.errstate(all="ignore"):  # a runaway piece is halved
            new = start[..., None] + product(right(x, y), integral)
            size = _norm(new) / np.sqrt(len(x)) + 1e-9 if turn < 2 else size
            last, change = change, float((_norm(new - y) / size).max())
        y = new
        if not np.isfinite(change):
            return y, False, 0.0
        if change < 1e-3 or turn == 0:
            tail = float((_norm(product(y, ending)) / size).max())
            if tail > 10 * change + resolved or (turn == 0 and tail > HOPELESS * resolved):
                return y, False, tail  # no further turn will mend it
            to_come = change * min(change / last, 1.0) if turn else change
            if to_come < TOLERANCE or (change < SETTLED and change > last / 2):
                return y, tail < resolved, tail
    return y, False, 0.0


def product(values: Array, matrix: Array) -> Array:
    """values (c, k, n) @ matrix (n, m), in blocks that BLAS leaves to one core: sharing them out costs far more."""
    if values.shape[1] <= BLOCK:
        return np.asarray(values @ matrix)
    out = np.empty((*values.shape[:-1], matrix.shape[-1]))
    for first in range(0, values.shape[1], BLOCK):
        np.matmul(values[:, first : first + BLOCK], matrix, out=out[:, first : first + BLOCK])
    return out


def _norm(values: Array) -> Array:
    """Root of the sum of squares over the last axis: a maximum takes numpy longer."""
    return np.asarray(np.sqrt(np.einsum("...n,...n->...", values, values)))
