"""Factors that make errors of known covariance independent and of unit size: inverse Cholesky factors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def inverse_roots(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lower triangular W (..., n, n) with W^T W = C^-1: W times errors of covariance C has unit covariance.

    Raises LinAlgError where a covariance is not positive definite.
    """
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64)
