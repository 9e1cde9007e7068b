"""How significant: chi^2 as the |z| of a normal variable, and what the best of many candidates scores by chance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import gammaln
from scipy.stats import chi2 as chi2_law
from scipy.stats import norm

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
    log_p = float(chi2_law.logsf(chi2, dof))
    if not log_p > -600:  # beyond 1e-300: the leading term of the tail
        half, x = dof / 2, chi2 / 2
        log_p = float(half * np.log(x) - x - gammaln(half) - np.log(x - half + 1))
    if log_p > np.log(0.999):
        return 0.0
    return float(brentq(lambda z: norm.logsf(z) + np.log(2) - log_p, 0, np.sqrt(chi2) + 1))


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
    root = (turn[:, kept] * np.sqrt(values[kept])).T
    starts = np.cumsum([0, *sizes[:-1]])
    owners = np.flatnonzero(np.array(sizes) > 0)
    rng, best = np.random.default_rng(SEED), []
    for _ in range(DRAWS // AT_ONCE):
        pulls = rng.standard_normal((AT_ONCE, len(root))) @ root
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
