"""Factors that make errors of known covariance independent and of unit size: inverse Cholesky factors."""

import numpy as np

from synthcam_shared.arrays import Array


def inverse_roots(covariance: Array) -> Array:
    """Lower triangular W (..., n, n) with W^T W = C^-1: W times errors of covariance C has unit covariance.

    Raises LinAlgError where a covariance is not positive definite.
    """
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64)
