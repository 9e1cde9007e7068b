"""Smooth initial-value problems, many at once: Chebyshev collocation, solved by Picard iteration.

The right-hand side is called on all nodes of all problems together, so laws written for arrays cost little. A piece
that few nodes do not resolve is done again with as many as the fall of its coefficients asks for; one that the most do
not, or on which the iteration does not settle, is halved, for all problems alike: put together what is alike.
Arrays are (components, problems, nodes): long last axes make numpy fast.
See Clenshaw & Norton, Comput. J. 6 (1963) 88; Trefethen, Approximation Theory and Practice (2013).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import islice

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

Array = NDArray[np.float64]
# Right: x (n,), y (c, problems, n) -> some components after the other, and their derivatives. Between them y is led on:
# what comes later may lean on what has been integrated already, which saves turns.
Parts = Iterator[tuple[slice, Array]]
Right = Callable[[Array, Array], Parts]
Pieces = list[tuple[Array, Array]]  # of a solution: the nodes x (n,) of each piece, and y (c, problems, n) there

SIZES = 14, 20, 26, 32, 40  # nodes of a piece
TOLERANCE = 3e-14  # of the iteration
SETTLED = 1e-12  # what rounding may leave of the iteration's changes
RESOLVED = 1e-13  # of the last coefficients, over the largest value
DEEPEST = 12
HOPELESS = 100  # times what is to be resolved
TURNS = 40
CLOSE = 1e-3  # a change so small tells whether the nodes are enough
SOME = slice(1, None, 2)  # nodes at which changes are looked for
ALONE = 2**18  # multiplications; OpenBLAS shares out products of more


def series(coefficients: Array, x: Array) -> Array:
    """Chebyshev series (c, problems, nodes) at x (problems, m): (c, problems, m).

    T_2k(x) = T_k(y) and T_(2k+1)(x) = x W_k(y), y = 2 x^2 - 1: half as many polynomials, in y, of E and O in E + x O.
    """
    c, problems, size = coefficients.shape
    half = (size + 1) // 2
    y = 2 * x * x - 1
    polynomials = np.empty((half, *x.shape))
    polynomials[0], polynomials[1:2] = 1.0, y
    for k in range(2, half):
        np.multiply(polynomials[1], polynomials[k - 1], out=polynomials[k])
        polynomials[k] *= 2
        polynomials[k] -= polynomials[k - 2]
    parts = multiply(coefficients, _halves(size)).reshape(c, problems, 2, half).transpose(1, 0, 2, 3)
    found = parts.reshape(problems, 2 * c, half) @ polynomials.transpose(1, 0, 2)
    found = found.reshape(problems, c, 2, x.shape[1])
    out = np.empty((c, *x.shape))
    for one, two in zip(out, found.swapaxes(0, 1), strict=True):
        np.multiply(two[:, 1], x, out=one)
        one += two[:, 0]
    return out


@cache
def _halves(size: int) -> Array:
    """A series' coefficients -> those in T_k(y) of E, then of O: from W_k = 2 T_k - W_(k-1)."""
    half = (size + 1) // 2
    out = np.zeros((size, 2 * half))
    out[::2, :half] = np.eye(half)
    for k in range(1, size, 2):
        out[k, half : half + k // 2 + 1] = 2 * (-1.0) ** (k // 2 - np.arange(k // 2 + 1))
        out[k, half] /= 2
    return out


def resample(values: Array, places: Array, size: int) -> Array:
    """Values (c, k, n) at rising places (k, n) from -1 to 1 -> (c, k, size) on nodes.

    Places that are a smooth function of nodes: the interpolant is rational, with the signs of the nodes for weights.
    Baltensperger, Berrut & Noel, Math. Comp. 68 (1999) 1109.
    """
    signs = (-1.0) ** np.arange(places.shape[-1])
    signs[[0, -1]] /= 2
    gap = matrices(size).nodes - places[..., None]
    gap += 1e-300  # a node that is met takes all the weight
    weighed = np.concatenate([values * signs, np.broadcast_to(signs, (1, *places.shape))]).swapaxes(0, 1)
    found = (weighed @ np.reciprocal(gap, out=gap)).swapaxes(0, 1)
    return np.asarray(found[:-1] / found[-1])


@dataclass(frozen=True)
class Matrices:
    """On the nodes of [-1, 1]: values -> coefficients and back, values -> integrals from -1.

    All are to be multiplied from the right. slope, curvature: of a series' coefficients.
    """

    nodes: Array
    coefficients: Array
    values: Array
    integral: Array
    slope: Array
    curvature: Array


@cache
def matrices(size: int) -> Matrices:
    nodes = -np.cos(np.pi * np.arange(size) / (size - 1))
    values = chebyshev.chebvander(nodes, size - 1)
    coefficients = np.linalg.inv(values)
    integral = np.asarray(chebyshev.chebvander(nodes, size) @ chebyshev.chebint(coefficients, lbnd=-1, axis=0))
    slope = np.zeros((size, size))
    slope[:-1] = chebyshev.chebder(np.eye(size), axis=0)
    lines = coefficients, values, integral, slope, slope @ slope
    c, v, i, s, ss = (np.ascontiguousarray(x.T, dtype=np.float64) for x in lines)
    return Matrices(nodes, c, v, i, s, ss)


@cache
def refine_matrix(old: int, new: int, side: int) -> Array:
    """Values on `old` nodes -> on `new` ones of all of [-1, 1], side 0, or of its left or right half, side -1 or 1."""
    nodes = (matrices(new).nodes + side) / (2 if side else 1)
    return np.ascontiguousarray(matrices(old).coefficients @ chebyshev.chebvander(nodes, old - 1).T)


def integrate(
    right: Right,
    knots: Sequence[float],
    start: Array,
    guess: Callable[[Array], Array] | None = None,
    deepest: int = DEEPEST,
    few: int = SIZES[0],
    feed: int | None = None,
) -> Pieces:
    """y' = right(x, y) from the first knot to the last, piece by piece between them (falling ones are allowed).

    y = start (c, problems) at the first. guess: x (n,) -> (c, problems, n), what y may be like. few: the nodes to try
    first. feed: how many of the parts that `right` yields, the first, it makes use of itself; all if None. The others
    are integrated when these are known.
    Raises ValueError when a law of motion is not smooth: a piece halved `deepest` times is still too long.
    """
    y = np.asarray(start, dtype=float)
    begin, pieces = float(knots[0]), Pieces()
    stack: list[tuple[float, int, int, Array | None]] = [(float(end), 0, few, None) for end in reversed(knots[1:])]
    while stack:
        end, depth, size, values = stack.pop()
        middle = (begin + end) / 2
        x = middle + (end - begin) / 2 * matrices(size).nodes
        if values is None:
            values = np.repeat(y[..., None], size, axis=-1) if guess is None else guess(x)
            values += (y - values[..., 0])[..., None]
        values, good, tail = _solve_piece(right, begin, end, y, values, feed)
        if good:
            begin, y = end, values[..., -1]
            pieces.append((x, values))
            continue
        runaway = not np.all(np.abs(values) < 1e6)  # True for infinite ones too
        if runaway:
            guess = None
        wanted = size * np.log(RESOLVED) / np.log(tail) if RESOLVED < tail < 1 else np.inf  # were their fall geometric
        more = next((n for n in SIZES if n >= max(wanted, size + 1)), None)
        if more is not None:
            stack.append((end, depth, more, None if runaway else multiply(values, refine_matrix(size, more, 0))))
        elif depth < deepest:
            more = next((n for n in SIZES if n >= wanted / 2), SIZES[-1])
            halves = [None if runaway else multiply(values, refine_matrix(size, more, side)) for side in (-1, 1)]
            stack += [(end, depth + 1, more, halves[1]), (middle, depth + 1, more, halves[0])]
        else:
            raise ValueError("a leg could not be integrated: a law of motion is not smooth there")
    return pieces


def _solve_piece(
    right: Right, a: float, b: float, start: Array, guess: Array, feed: int | None
) -> tuple[Array, bool, float]:
    """Values at the nodes of [a, b], (c, problems, nodes) like the guess; are they the solution; the last coefficients.

    Gives up at once where already the guess leads to more than these nodes hold.
    """
    on = matrices(guess.shape[-1])
    x = (a + b) / 2 + (b - a) / 2 * on.nodes
    integral = (b - a) / 2 * on.integral
    y, change, fed = guess.copy(), np.inf, slice(None)

    def turn(parts: int | None) -> slice:
        """Integrate these parts, in y; which components feed back."""
        fed = slice(0)
        for k, (part, slope) in enumerate(islice(right(x, y), parts)):
            np.add(multiply(slope, integral), start[part, :, None], out=y[part])
            fed = slice(part.stop) if feed is None or k < feed else fed
        return fed

    def last_ones(of: slice) -> float:
        return float((_norm(multiply(y[of], on.coefficients[:, -3:])) / size[of]).max())

    with np.errstate(all="ignore"):  # a runaway piece is halved
        for k in range(TURNS):
            old = y[fed][..., SOME].copy()
            fed = turn(feed if k else None)
            if k < 2:
                size = _norm(y).mean(axis=1, keepdims=True) / np.sqrt(len(x)) + 1e-9  # no coordinate is small by chance
            last, change = change, SOME.step * float((_norm(y[fed][..., SOME] - old[fed]) / size[fed]).max())
            if not np.isfinite(change):
                return y, False, 0.0
            gain = min(change / last, 1.0) if k else 1.0
            more = gain if feed is None else gain * gain  # one more turn is to come
            settled = change * more < TOLERANCE or (change < SETTLED and change > last / 2)
            if k == 0 or settled or change < CLOSE <= last:
                tail = last_ones(fed if k else slice(None))
                if tail > 10 * change + RESOLVED or (k == 0 and tail > HOPELESS * RESOLVED):
                    return y, False, tail  # no further turn will mend it
            if settled:
                if feed is not None:
                    turn(None)
                    tail = last_ones(slice(None))
                return y, tail < RESOLVED, tail
    return y, False, 0.0


def multiply(values: Array, matrix: Array) -> Array:
    """values (c, k, n) @ matrix (n, m), in blocks that BLAS leaves to one core: sharing them out costs far more."""
    block = ALONE // matrix.size
    if values.shape[1] <= block:
        return np.asarray(values @ matrix)
    out = np.empty((*values.shape[:-1], matrix.shape[-1]))
    for first in range(0, values.shape[1], block):
        np.matmul(values[:, first : first + block], matrix, out=out[:, first : first + block])
    return out


def _norm(values: Array) -> Array:
    """Root of the sum of squares over the last axis: a maximum takes numpy longer."""
    return np.asarray(np.sqrt(np.einsum("...n,...n->...", values, values)))
