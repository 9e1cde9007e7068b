"""Inverse Cholesky factors, by which errors of known covariance become independent ones of unit size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def inverse_roots(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lower triangular W with W^T W = C^-1.

    Parameters
    ----------
    covariance : (..., n, n) array
        Positive definite.

    Returns
    -------
    (..., n, n) array
        W times errors of covariance C has unit covariance.

    Raises
    ------
    numpy.linalg.LinAlgError
        A covariance is not positive definite.
    """
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64)
