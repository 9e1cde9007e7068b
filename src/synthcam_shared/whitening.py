"""Inverse Cholesky factors, by which errors of known covariance become independent ones of unit size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def inverse_roots(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lower triangular W (..., n, n) with W^T W = C^-1: W times errors of covariance C has unit covariance.

    Raises LinAlgError where a covariance is not positive definite.
    """
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64)
