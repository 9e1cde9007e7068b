"""Errors that last over some frames, by the residuals of a smooth path: how large and how lasting they are.

The fit of a path takes the slow part of such errors with it. So its residuals are smaller, and correlate less, than the
errors. The path is taken as a polynomial, and the correlation as falling by the same factor from frame to frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from synthcam_shared.arrays import Array


@dataclass(frozen=True)
class LastingErrors:
    """Errors of n positions with a correlation `rho` of neighbours, beside a polynomial.

    left: variance of the residuals for a degree of freedom, over that of the errors. inflation: variance of the
    coefficients of orthonormal polynomials, in the mean, over that by independent errors.
    """

    rho: float
    left: float
    inflation: float

    @staticmethod
    def of(rho: float, n: int, columns: int) -> LastingErrors:
        """The errors of n positions with this correlation, beside a polynomial of so many coefficients."""
        if n <= columns:
            return LastingErrors(0.0, 1.0, 1.0)
        basis, project = _make_polynomials(n, columns)
        cov = _correlate(np.array(rho), n)
        left = float(np.trace(project @ cov)) / (n - columns)
        return LastingErrors(rho, left, float(np.trace(basis.T @ cov @ basis)) / columns)


def estimate_correlation(left: Array, columns: int) -> float:
    """Estimate the correlation of neighbouring errors from residuals (n, 2); 0 if hardly more than a polynomial has.

    It is the one whose residuals beside a polynomial of so many coefficients correlate as these do.
    """
    min_freedom = 4  # of the residuals of an axis
    if len(left) < columns + min_freedom:
        return 0.0
    seen = float((left[1:] * left[:-1]).sum() / max(float((left**2).sum()), 1e-300))
    rhos, expected = _expect_correlations(len(left), columns)
    return float(np.interp(seen, expected, rhos))


def _correlate(rho: Array, n: int) -> Array:
    """Correlations (..., n, n) of the errors of n positions."""
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    return np.asarray(np.power(rho[..., None, None], apart))


@cache
def _make_polynomials(n: int, columns: int) -> tuple[Array, Array]:
    """Orthonormal polynomials (n, columns) of n even positions, and the projection (n, n) off them."""
    basis = np.linalg.qr(np.vander(np.linspace(-1, 1, n), columns))[0]
    return basis, np.eye(n) - basis @ basis.T


@cache
def _expect_correlations(n: int, columns: int) -> tuple[Array, Array]:
    """Correlations of errors, -0.5 to 0.9, and those of their residuals."""
    rhos, (_, project) = np.linspace(-0.5, 0.9, 29), _make_polynomials(n, columns)
    left = project @ _correlate(rhos, n) @ project
    return rhos, np.trace(left, 1, 1, 2) / np.trace(left, 0, 1, 2)
