"""Errors that last over some frames, by the residuals of a smooth path: how large and how lasting they are.

The fit of a path takes the slow part of such errors with it. So its residuals are smaller, and correlate less, than the
errors. The path is taken as a polynomial, and the correlation as falling by the same factor from frame to frame.

Residuals of a short stretch hardly show the correlation: from 8 positions it is known to 0.5. Errors that would follow
from its estimate are too large, because they grow ever faster with it. So each of `CORRELATIONS` counts, with its
probability by the residuals of all stretches of a hit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from synthcam_shared.arrays import Array

CORRELATIONS = np.linspace(0.0, 0.9, 19)  # of the errors of neighbouring positions
INDEPENDENT_SHARE = 0.5  # prior probability of the first of them


@dataclass(frozen=True)
class LastingErrors:
    """Errors of n positions beside a polynomial, for each of `CORRELATIONS` (m,).

    left: variance of the residuals for a degree of freedom, over that of the errors. inflation: variance of the
    coefficients of orthonormal polynomials, in the mean, over that by independent errors. log_likelihood: logarithm of
    the probability of the residuals by this correlation, whatever the size of the errors.
    """

    left: Array
    inflation: Array
    log_likelihood: Array

    @staticmethod
    def of(residuals: Array, columns: int) -> LastingErrors:
        """The errors by residuals (n, 2) beside a polynomial of so many coefficients."""
        n = len(residuals)
        if n <= columns:
            return LastingErrors(np.ones(len(CORRELATIONS)), np.ones(len(CORRELATIONS)), np.zeros(len(CORRELATIONS)))
        shapes = _Shapes.of(n, columns)
        white = _whiten(residuals)
        of_path = np.linalg.solve(shapes.square, np.swapaxes(shapes.white, 1, 2) @ white)
        squares = ((white - shapes.white @ of_path) ** 2).sum(axis=(1, 2))
        log_likelihood = -shapes.log_volume - (n - columns) * np.log(np.maximum(squares, 1e-300))
        return LastingErrors(shapes.left, shapes.inflation, log_likelihood)


def measure_variances(
    residuals: Sequence[Array], freedom: Sequence[float], columns: Sequence[int]
) -> tuple[list[float], float]:
    """Measure the variance with which errors enter the path of each stretch of a hit, and its mean.

    residuals: of each stretch, (n, 2). freedom: their degrees of freedom. columns: coefficients of the path along an
    axis. The correlation is the same in all stretches. Their mean counts in each stretch as `shared` degrees of
    freedom do. The result is the geometric mean over the correlations.
    """
    shared = 8.0
    errors = [LastingErrors.of(left, k) for left, k in zip(residuals, columns, strict=True)]
    squares = np.array([(left**2).sum() / one.left for left, one in zip(residuals, errors, strict=True)])
    inflation, free = np.array([one.inflation for one in errors]), np.array(freedom)[:, None]
    mean = squares.sum(axis=0) / free.sum()
    usual = mean * (free * inflation).sum(axis=0) / free.sum()
    each = (squares + shared * mean) / (free + shared) * inflation
    weights = _weigh_correlations(np.sum([one.log_likelihood for one in errors], axis=0))
    *own, usual_square = np.exp(np.log(np.maximum([*each, usual], 1e-300)) @ weights).tolist()
    return own, usual_square


def _weigh_correlations(log_likelihood: Array) -> Array:
    """Probabilities of `CORRELATIONS` (m,) by the logarithms of their likelihoods, times the prior ones."""
    later = len(CORRELATIONS) - 1
    logs = log_likelihood + np.log(np.append(INDEPENDENT_SHARE, np.full(later, (1 - INDEPENDENT_SHARE) / later)))
    weights = np.exp(logs - logs.max())
    return np.asarray(weights / weights.sum())


@dataclass(frozen=True)
class _Shapes:
    """What the number of positions and of coefficients say about the errors, for each of `CORRELATIONS`.

    white (m, n, columns), square (m, columns, columns): polynomials whitened as the errors are, and their products.
    log_volume: half the logarithm of the determinant of the covariance of residuals, for both axes.
    """

    white: Array
    square: Array
    log_volume: Array
    left: Array
    inflation: Array

    @staticmethod
    @cache
    def of(n: int, columns: int) -> _Shapes:
        """Compute them for n even positions."""
        basis = np.linalg.qr(np.vander(np.linspace(-1, 1, n), columns))[0]
        white = _whiten(basis)
        square = np.swapaxes(white, 1, 2) @ white
        spread = np.stack([basis.T @ _correlate(rho, basis) for rho in CORRELATIONS])
        total = np.trace(spread, axis1=1, axis2=2)
        log_volume = (n - 1) * np.log(1 - CORRELATIONS**2) + np.linalg.slogdet(square)[1]
        return _Shapes(white, square, log_volume, (n - total) / (n - columns), total / columns)


def _whiten(values: Array) -> Array:
    """Turn values (n, k) with errors of each of `CORRELATIONS` into ones with independent errors (m, n, k)."""
    rho = CORRELATIONS[:, None, None]
    later = (values[1:] - rho * values[:-1]) / np.sqrt(1 - rho**2)
    return np.concatenate([np.broadcast_to(values[:1], (len(rho), 1, values.shape[1])), later], axis=1)


def _correlate(rho: float, values: Array) -> Array:
    """Multiply values (n, k) by the matrix of correlations, rho to the power of the distance."""
    return np.asarray(rho ** np.abs(np.subtract.outer(np.arange(len(values)), np.arange(len(values)))) @ values)
