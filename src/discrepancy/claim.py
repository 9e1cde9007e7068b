"""How significant: chi^2 as the |z| of a normal variable, and what the best of many candidates scores by chance."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, ndtri_exp

Array = NDArray[np.float64]

LEVEL = 1e-3  # of searches with nothing hidden that claim something
FLOOR = 4.0  # sigma: no claim under it, however few the candidates: the noise itself is only estimated
DRAWS = 40_000  # the level then lies within a sixth of LEVEL, and its sigma within a hundredth
AT_ONCE = 4_000
SEED = 20_260


def sigmas(chi2: float, dof: int) -> float:
    """The |z| of a normal variable as improbable as chi^2 with so many degrees of freedom."""
    if dof == 1:
        return float(np.sqrt(max(chi2, 0.0)))
    p = float(chdtrc(dof, max(chi2, 0.0)))
    if p > 1e-290:
        log_p = math.log(p)
    else:  # the leading term of the tail
        half, x = dof / 2, chi2 / 2
        log_p = half * math.log(x) - x - math.lgamma(half) - math.log(x - half + 1)
    return max(-float(ndtri_exp(log_p - math.log(2))), 0.0)


def by_chance(axes: Sequence[Array], one_sided: Sequence[bool], level: float = LEVEL) -> float:
    """The sigma that the best of all candidates exceeds in a share `level` of cases when nothing is hidden.

    axes: of each candidate an orthonormal basis (points, k) of what its signature leaves after the fit took its part.
    Their products with white noise are Gaussian with the products of the axes among themselves as covariance, so they
    are drawn at once, the same draws every time. one_sided: candidates of one strength that only scores when positive.
    """
    sizes = [a.shape[1] for a in axes]
    if not sum(sizes):
        return 0.0
    together = np.concatenate(axes, axis=1)
    values, turn = np.linalg.eigh(together.T @ together)
    kept = values > 1e-9 * values[-1]
    root = (turn[:, kept] * np.sqrt(values[kept])).T.astype(np.float32)
    starts = np.cumsum([0, *sizes[:-1]])
    owners = np.flatnonzero(np.array(sizes) > 0)
    rng, best = np.random.default_rng(SEED), []
    for _ in range(DRAWS // AT_ONCE):
        pulls = rng.standard_normal((AT_ONCE, len(root))).astype(np.float32) @ root
        single = np.flatnonzero([sizes[k] == 1 and one_sided[k] for k in range(len(sizes))])
        pulls[:, starts[single]] = np.maximum(pulls[:, starts[single]], 0.0)
        chi2 = np.add.reduceat(pulls**2, starts[owners], axis=1)
        each = np.zeros(AT_ONCE)
        for dof in {sizes[k] for k in owners}:
            largest = chi2[:, [i for i, k in enumerate(owners) if sizes[k] == dof]].max(axis=1)
            each = np.maximum(each, _interpolated(largest, dof))
        best.append(each)
    return float(np.quantile(np.concatenate(best), 1 - level))


def _interpolated(chi2: Array, dof: int) -> Array:
    """`sigmas` of many, from a table."""
    roots = np.sqrt(chi2)
    knots = np.linspace(0, roots.max(), 64)
    return np.asarray(np.interp(roots, knots, [sigmas(x * x, dof) for x in knots]))
