"""Errors that last over some frames, by the residuals of a smooth path: how large and how lasting they are.

The fit of a path takes the slow part of such errors with it. So its residuals are smaller, and correlate less, than the
errors. The path is taken as a polynomial, fitted by least squares. The correlation falls by the same factor from frame
to frame; positions far from the contact are means of several frames.

Residuals of a short stretch hardly show the correlation: from 8 positions it is known to 0.5. So each of
`CORRELATIONS` counts, with its probability by the residuals of all stretches of a hit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from synthcam_shared.arrays import Array, Ints

CORRELATIONS = np.linspace(0.0, 0.9, 19)  # of the errors of neighbouring positions
INDEPENDENT_SHARE = 0.5  # prior probability of the first of them


@dataclass(frozen=True)
class LastingErrors:
    """Errors of n positions beside a polynomial, for each of `CORRELATIONS` (m,).

    left: variance of the residuals for a degree of freedom, over that of the errors. freedom: degrees of freedom that
    their sum of squares has: fewer than independent ones have. inflation: variance of the
    velocity at the contact, over that by independent errors. log_likelihood: logarithm of the probability of the
    residuals by this correlation, whatever the size of the errors.
    """

    left: Array
    freedom: Array
    inflation: Array
    log_likelihood: Array

    @staticmethod
    def of(residuals: Array, columns: int, count: Ints | None = None, first: float = 1.0) -> LastingErrors:
        """The errors by residuals (n, 2), from the contact on, beside a polynomial of so many coefficients.

        count: how many frames each position is the mean of (n,); one each by default. first: how many frames after the
        contact the first of these frames is, to a quarter.
        """
        n = len(residuals)
        if n <= columns:
            ones = np.ones(len(CORRELATIONS))
            return LastingErrors(ones, 0 * ones, ones, 0 * ones)
        shapes = _Shapes.of((1,) * n if count is None else tuple(count.tolist()), columns, round(4 * first))
        white = shapes.whitener @ residuals
        of_path = np.linalg.solve(shapes.square, np.swapaxes(shapes.white, 1, 2) @ white)
        squares = ((white - shapes.white @ of_path) ** 2).sum(axis=(1, 2))
        log_likelihood = -shapes.log_volume - (n - columns) * np.log(np.maximum(squares, 1e-300))
        return LastingErrors(shapes.left, shapes.freedom, shapes.inflation, log_likelihood)


def measure_variances(
    residuals: Sequence[Array],
    freedom: Sequence[float],
    columns: Sequence[int],
    counts: Sequence[Ints] | None = None,
    firsts: Sequence[float] | None = None,
) -> tuple[list[float], float, float]:
    """Measure the variance with which errors enter the velocity of each stretch of a hit, its mean, and their own.

    residuals: of each stretch, (n, 2), from the contact on. freedom: their degrees of freedom. columns: coefficients of
    the path along an axis. counts, firsts: as in `LastingErrors.of`. The correlation is the same in all stretches.
    Their mean counts in each stretch as `shared` degrees of freedom do. The result is the mean over the correlations.
    """
    shared = 8.0
    given: Sequence[Ints | None] = counts or [None] * len(residuals)
    errors = [
        LastingErrors.of(*each) for each in zip(residuals, columns, given, firsts or [1.0] * len(given), strict=True)
    ]
    squares = np.array([(left**2).sum() / one.left for left, one in zip(residuals, errors, strict=True)])
    inflation, free = np.array([one.inflation for one in errors]), np.array(freedom)[:, None]
    mean = squares.sum(axis=0) / free.sum()
    usual = mean * (free * inflation).sum(axis=0) / free.sum()
    each = (squares + shared * mean) / (free + shared) * inflation
    known = np.array([one.freedom for one in errors]) + shared
    each *= known / (known - 2)  # the mean of a variance that is known to so many degrees of freedom
    weights = _weigh_correlations(np.sum([one.log_likelihood for one in errors], axis=0))
    return (each @ weights).tolist(), float(usual @ weights), float(mean @ weights)


def _weigh_correlations(log_likelihood: Array) -> Array:
    """Probabilities of `CORRELATIONS` (m,) by the logarithms of their likelihoods, times the prior ones."""
    later = len(CORRELATIONS) - 1
    logs = log_likelihood + np.log(np.append(INDEPENDENT_SHARE, np.full(later, (1 - INDEPENDENT_SHARE) / later)))
    weights = np.exp(logs - logs.max())
    return np.asarray(weights / weights.sum())


@dataclass(frozen=True)
class _Shapes:
    """What the number of positions and of coefficients say about the errors, for each of `CORRELATIONS`.

    whitener (m, n, n): turns errors into independent ones of size 1. white (m, n, columns), square (m, columns,
    columns): polynomials so whitened, and their products. log_volume: half the logarithm of the determinant of the
    covariance of residuals, for both axes.
    """

    whitener: Array
    white: Array
    square: Array
    log_volume: Array
    left: Array
    freedom: Array
    inflation: Array

    @staticmethod
    @lru_cache(maxsize=64)
    def of(count: tuple[int, ...], columns: int, first: int) -> _Shapes:
        """Compute them for means of so many even frames; the first frame is `first` quarters after the contact."""
        frames, n = np.array(count), len(count)
        cov = _correlate_means(frames)
        since = first / 4 - 1 + np.cumsum(frames) - (frames - 1) / 2
        powers = np.vander(since / since[-1], columns, increasing=True) * np.sqrt(frames)[:, None]
        basis, triangle = np.linalg.qr(powers)
        velocity = basis @ np.linalg.solve(triangle.T, np.eye(columns)[1 if columns > 1 else 0])
        root = np.linalg.cholesky(cov)
        whitener = np.linalg.inv(root)
        white = whitener @ basis
        square = np.swapaxes(white, 1, 2) @ white
        total = np.trace(basis.T @ cov @ basis, axis1=1, axis2=2)  # that the path takes
        log_volume = 2 * np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1) + np.linalg.slogdet(square)[1]
        left = np.trace(cov, axis1=1, axis2=2) - total
        off_path = np.eye(n) - basis @ basis.T
        freedom = 2 * left**2 / ((off_path @ cov @ off_path) ** 2).sum(axis=(1, 2))  # of both axes
        inflation = velocity @ cov @ velocity / (velocity @ velocity)
        return _Shapes(whitener, white, square, log_volume, left / (n - columns), freedom, inflation)


def _correlate_means(count: Ints) -> Array:
    """Covariances (m, n, n) of means of so many neighbours (n,), times the root of either number."""
    rho, n = CORRELATIONS[:, None, None], len(count)
    end = np.cumsum(count)
    later = np.where(np.tri(n, k=-1, dtype=bool), np.subtract.outer(end - count, end - 1), 0)
    apart = later + later.T + np.eye(n)  # from the last frame of a group to the first of a later one
    sums = (1 - rho[..., 0] ** count) / (1 - rho[..., 0])  # of the correlations with the nearest
    cov = sums[:, :, None] * sums[:, None, :] * rho**apart
    cov[:, range(n), range(n)] = count + 2 * rho[..., 0] * (count - sums) / (1 - rho[..., 0])
    return np.asarray(cov / np.sqrt(np.outer(count, count)))
