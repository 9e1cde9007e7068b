"""Smooth initial-value problems, many at once: Chebyshev collocation, solved by Picard iteration.

The right-hand side is called on all nodes of all problems together, so laws written for arrays cost little. A piece
that few nodes do not resolve is solved again with as many nodes as the decay of its coefficients asks for. A piece that
no number of nodes resolves, or on which the iteration does not converge, is halved for all problems. Callers therefore
group similar problems. Arrays are (components, problems, nodes), since long last axes make numpy fast.

Clenshaw & Norton, Comput. J. 6 (1963) 88; Trefethen, Approximation Theory and Approximation Practice (2013).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import islice

import numpy as np
from numpy.polynomial import chebyshev

from synthcam_shared.arrays import Array

# A right-hand side takes x (n,) and y (c, problems, n) and yields groups of components with their derivatives. Between
# two groups y is integrated. Later groups can then use the new values of earlier ones, which saves iterations.
Parts = Iterator[tuple[slice, Array]]
Right = Callable[[Array, Array], Parts]
Pieces = list[tuple[Array, Array]]  # the nodes x (n,) of each piece of a solution, and y (c, problems, n) there

NODE_COUNTS = 14, 20, 26, 32, 40  # nodes of a piece, tried in this order
MAX_HALVINGS = 12
MAX_LAST_COEFFICIENT = 1e-13  # largest size of the last coefficients of a resolved piece, over that of the values


def evaluate_series(coefficients: Array, x: Array) -> Array:
    """Evaluate Chebyshev series (c, problems, nodes) at x (problems, m): (c, problems, m).

    T_2k(x) = T_k(y) and T_(2k+1)(x) = x W_k(y), with y = 2 x^2 - 1. So E and O in E + x O need half as many polynomials
    in y.
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
    parts = multiply_on_nodes(coefficients, _halves(size)).reshape(c, problems, 2, half).transpose(1, 0, 2, 3)
    found = parts.reshape(problems, 2 * c, half) @ polynomials.transpose(1, 0, 2)
    found = found.reshape(problems, c, 2, x.shape[1])
    out = np.empty((c, *x.shape))
    for one, two in zip(out, found.swapaxes(0, 1), strict=True):
        np.multiply(two[:, 1], x, out=one)
        one += two[:, 0]
    return out


@cache
def _halves(size: int) -> Array:
    """Return the matrix from the coefficients of a series to those in T_k(y) of E, then of O: W_k = 2 T_k - W_(k-1)."""
    half = (size + 1) // 2
    out = np.zeros((size, 2 * half))
    out[::2, :half] = np.eye(half)
    for k in range(1, size, 2):
        out[k, half : half + k // 2 + 1] = 2 * (-1.0) ** (k // 2 - np.arange(k // 2 + 1))
        out[k, half] /= 2
    return out


def resample_on_nodes(values: Array, places: Array, size: int) -> Array:
    """Interpolate values (c, k, n) at rising points (k, n) from -1 to 1 on `size` collocation nodes: (c, k, size).

    The places must be a smooth function of Chebyshev nodes. The interpolant is rational, with alternating signs for
    weights: Baltensperger, Berrut & Noel, Math. Comp. 68 (1999) 1109.
    """
    signs = (-1.0) ** np.arange(places.shape[-1])
    signs[[0, -1]] /= 2
    gap = make_matrices(size).nodes - places[..., None]
    gap += 1e-300  # a place on a node takes all the weight
    weighed = np.concatenate([values * signs, np.broadcast_to(signs, (1, *places.shape))]).swapaxes(0, 1)
    found = (weighed @ np.reciprocal(gap, out=gap)).swapaxes(0, 1)
    return np.asarray(found[:-1] / found[-1])


@dataclass(frozen=True)
class CollocationMatrices:
    """Matrices on the Chebyshev nodes of [-1, 1], to be multiplied from the right.

    coefficients, values: from values to coefficients and back. integral: from values to integrals from -1. slope,
    curvature: from the coefficients of a series to those of its derivatives.
    """

    nodes: Array
    coefficients: Array
    values: Array
    integral: Array
    slope: Array
    curvature: Array


@cache
def make_matrices(size: int) -> CollocationMatrices:
    """Return the matrices of a collocation on `size` nodes."""
    nodes = -np.cos(np.pi * np.arange(size) / (size - 1))
    values = chebyshev.chebvander(nodes, size - 1)
    coefficients = np.linalg.inv(values)
    integral = np.asarray(chebyshev.chebvander(nodes, size) @ chebyshev.chebint(coefficients, lbnd=-1, axis=0))
    slope = np.zeros((size, size))
    slope[:-1] = chebyshev.chebder(np.eye(size), axis=0)
    lines = coefficients, values, integral, slope, slope @ slope
    c, v, i, s, ss = (np.ascontiguousarray(x.T, dtype=np.float64) for x in lines)
    return CollocationMatrices(nodes, c, v, i, s, ss)


@cache
def refine_matrix(old: int, new: int, side: int) -> Array:
    """Return the collocation matrix from `old` to `new` nodes, of all of [-1, 1] (side 0), or of a half (-1, 1)."""
    nodes = (make_matrices(new).nodes + side) / (2 if side else 1)
    return np.ascontiguousarray(make_matrices(old).coefficients @ chebyshev.chebvander(nodes, old - 1).T)


def integrate_by_collocation(
    right: Right,
    knots: Sequence[float],
    start: Array,
    guess: Callable[[Array], Array] | None = None,
    max_halvings: int = MAX_HALVINGS,
    few: int = NODE_COUNTS[0],
    feed: int | None = None,
) -> Pieces:
    """Solve y' = right(x, y) by collocation from the first knot to the last, piece by piece.

    right: see `Right` above.
    knots: where pieces meet; they may fall.
    start: (c, problems), y at the first knot.
    guess: maps x (n,) to a first guess of y, (c, problems, n).
    max_halvings: how often a piece may be halved.
    few: nodes to try first.
    feed: how many of the groups that `right` yields, the first ones, it uses itself; default: all. The others are
    integrated once these are known.

    Raises ValueError if a law of motion is not smooth: a piece is still too long after `max_halvings`.
    """
    y = np.asarray(start, dtype=float)
    begin, pieces = float(knots[0]), Pieces()
    stack: list[tuple[float, int, int, Array | None]] = [(float(end), 0, few, None) for end in reversed(knots[1:])]
    while stack:
        end, depth, size, values = stack.pop()
        middle = (begin + end) / 2
        x = middle + (end - begin) / 2 * make_matrices(size).nodes
        if values is None:
            values = np.repeat(y[..., None], size, axis=-1) if guess is None else guess(x)
            values += (y - values[..., 0])[..., None]
        values, good, tail = _solve_piece(right, begin, end, y, values, feed)
        if good:
            begin, y = end, values[..., -1]
            pieces.append((x, values))
            continue
        runaway = not np.all(np.abs(values) < 1e6)  # also true where a value is infinite
        if runaway:
            guess = None
        decays = MAX_LAST_COEFFICIENT < tail < 1  # the coefficients, as we assume geometrically
        wanted = size * np.log(MAX_LAST_COEFFICIENT) / np.log(tail) if decays else np.inf
        more = next((n for n in NODE_COUNTS if n >= max(wanted, size + 1)), None)
        sides = {0: end}  # the ends of the pieces to solve next, the last one first
        if more is None and depth < max_halvings:
            more = next((n for n in NODE_COUNTS if n >= wanted / 2), NODE_COUNTS[-1])
            sides, depth = {1: end, -1: middle}, depth + 1
        if more is not None:
            for side, until in sides.items():
                better = None if runaway else multiply_on_nodes(values, refine_matrix(size, more, side))
                stack.append((until, depth, more, better))
        else:
            raise ValueError("a leg could not be integrated: a law of motion is not smooth there")
    return pieces


def _solve_piece(
    right: Right, a: float, b: float, start: Array, guess: Array, feed: int | None
) -> tuple[Array, bool, float]:
    """Solve one piece [a, b] on the nodes of the guess, (c, problems, nodes).

    Returns the values at the nodes, whether they are the solution, and the size of the last coefficients. Gives up at
    once where even the guess leads to more than these nodes resolve.
    """
    tolerance, rounding = 3e-14, 1e-12  # of a change of the iteration: converged; what rounding may leave of it
    close = 1e-3  # a change so small shows whether the nodes are enough
    some = slice(1, None, 2)  # every other node is enough to measure a change
    on = make_matrices(guess.shape[-1])
    x = (a + b) / 2 + (b - a) / 2 * on.nodes
    integral = (b - a) / 2 * on.integral
    y, change, fed = guess.copy(), np.inf, slice(None)

    def turn(parts: int | None) -> slice:
        """Integrate these groups into y; return which components feed back."""
        fed = slice(0)
        for k, (part, slope) in enumerate(islice(right(x, y), parts)):
            np.add(multiply_on_nodes(slope, integral), start[part, :, None], out=y[part])
            fed = slice(part.stop) if feed is None or k < feed else fed
        return fed

    def last_ones(of: slice) -> float:
        return float((_norm(multiply_on_nodes(y[of], on.coefficients[:, -3:])) / size[of]).max())

    with np.errstate(all="ignore"):  # overflows: such a piece is halved
        for k in range(40):
            old = y[fed][..., some].copy()
            fed = turn(feed if k else None)
            if k < 2:
                size = _norm(y).mean(axis=1, keepdims=True) / np.sqrt(len(x)) + 1e-9  # no coordinate is small by chance
            last, change = change, some.step * float((_norm(y[fed][..., some] - old[fed]) / size[fed]).max())
            if not np.isfinite(change):
                return y, False, 0.0
            gain = min(change / last, 1.0) if k else 1.0
            more = gain if feed is None else gain * gain  # one more iteration follows
            settled = change * more < tolerance or (change < rounding and change > last / 2)
            if k == 0 or settled or change < close <= last:
                tail = last_ones(fed if k else slice(None))
                if tail > 10 * change + MAX_LAST_COEFFICIENT or (k == 0 and tail > 100 * MAX_LAST_COEFFICIENT):
                    return y, False, tail  # no further iteration can help
            if settled:
                if feed is not None:
                    turn(None)
                    tail = last_ones(slice(None))
                return y, tail < MAX_LAST_COEFFICIENT, tail
    return y, False, 0.0


def multiply_on_nodes(values: Array, matrix: Array) -> Array:
    """Multiply values (c, k, n) on collocation nodes by a matrix (n, m), in blocks that BLAS leaves to one core.

    OpenBLAS distributes products of more than 2^18 multiplications over cores, which costs far more than it saves.
    """
    block = 2**18 // matrix.size
    if values.shape[1] <= block:
        return np.asarray(values @ matrix)
    out = np.empty((*values.shape[:-1], matrix.shape[-1]))
    for first in range(0, values.shape[1], block):
        np.matmul(values[:, first : first + block], matrix, out=out[:, first : first + block])
    return out


def _norm(values: Array) -> Array:
    """Return the root of the sum of squares over the last axis; a maximum takes numpy longer."""
    return np.asarray(np.sqrt(np.einsum("...n,...n->...", values, values)))
