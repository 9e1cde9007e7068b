"""Types of arrays by content, whose shape each use documents, factors that whiten errors, and nodes of quadrature."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Ints = NDArray[np.int64]
Index = NDArray[np.intp]
Flags = NDArray[np.bool_]


def inverse_roots(covariance: Array) -> Array:
    """Lower triangular W (..., n, n) with W^T W = C^-1: W times errors of covariance C is independent and of unit size.

    Raises LinAlgError where a covariance is not positive definite.
    """
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64)


@cache
def list_gauss_nodes(count: int) -> tuple[Array, Array]:
    """List the nodes (count,) of Gauss-Legendre quadrature from -1 to 1 and their weights, each found once."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    nodes.flags.writeable = weights.flags.writeable = False
    return nodes, weights
