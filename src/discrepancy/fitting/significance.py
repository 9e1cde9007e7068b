"""How significant: chi^2 as the |z| of a normal variable, and what the best of many candidates scores by chance."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import chdtrc, ndtri_exp

from discrepancy import policy
from discrepancy.arrays import Array

DRAWS = 40_000  # the level then lies within a sixth of the one asked for, and its sigma within a hundredth
AT_ONCE = 4_000
SEED = 20_260


def sigmas(chi2: float, dof: int, trials_factor: float = 1.0) -> float:
    """The |z| of a normal variable as improbable as chi^2 of so many degrees of freedom, the best of many trials."""
    if trials_factor > 1:
        return math.sqrt(max(sigmas(chi2, dof) ** 2 - 2 * math.log(trials_factor), 0.0))
    if dof == 1:
        return math.sqrt(max(chi2, 0.0))
    p = float(chdtrc(dof, max(chi2, 0.0)))
    if p > 1e-290:
        log_p = math.log(p)
    else:  # the leading term of the tail
        half, x = dof / 2, chi2 / 2
        log_p = half * math.log(x) - x - math.lgamma(half) - math.log(x - half + 1)
    return max(-float(ndtri_exp(log_p - math.log(2))), 0.0)


def trials_factor(every: Sequence[Array]) -> float:
    """How many independent trials these are, each a basis (points, k): 1 for one, or many that are alike."""
    columns = np.concatenate(every, axis=1)
    length = np.linalg.norm(columns, axis=0)
    unit = columns[:, length > 0] / length[length > 0]
    alike = ((unit.T @ unit) ** 2).sum()
    most = max(a.shape[1] for a in every)
    return max(unit.shape[1] ** 2 / float(alike) / most, 1.0) if unit.size else 1.0


def by_chance(
    gram: Array,
    sizes: Sequence[int],
    one_sided: Sequence[bool],
    level: float | None = None,
    trials_factors: Sequence[float] = (),
) -> float:
    """The sigma that the best of all candidates exceeds in a share of cases when nothing is hidden.

    gram (K, K): products of the axes of all candidates among themselves. Each has of its own an orthonormal basis of
    `sizes` axes, of what its signature leaves after the fit took its part. Their products with white noise are Gaussian
    with this covariance, so they are drawn at once, the same draws every time. one_sided: candidates of one strength
    that only scores when positive. trials_factors: of each candidate, by which it is corrected. level: that share;
    by default that of a claim.
    """
    if not sum(sizes):
        return 0.0
    values, turn = np.linalg.eigh(gram)
    kept = values > 1e-9 * values[-1]
    root = (turn[:, kept] * np.sqrt(values[kept])).T.astype(np.float32)
    starts = np.cumsum([0, *sizes[:-1]])
    owners = np.flatnonzero(np.array(sizes) > 0)
    alike: dict[tuple[int, float], list[int]] = {}
    for i, k in enumerate(owners):
        alike.setdefault((sizes[int(k)], trials_factors[int(k)] if trials_factors else 1.0), []).append(i)
    rng, best = np.random.default_rng(SEED), []
    for _ in range(DRAWS // AT_ONCE):
        pulls = rng.standard_normal((AT_ONCE, len(root))).astype(np.float32) @ root
        single = np.flatnonzero([sizes[k] == 1 and one_sided[k] for k in range(len(sizes))])
        pulls[:, starts[single]] = np.maximum(pulls[:, starts[single]], 0.0)
        chi2 = np.add.reduceat(pulls**2, starts[owners], axis=1)
        each = np.zeros(AT_ONCE)
        for (dof, factor), rows in alike.items():
            each = np.maximum(each, _interpolated(chi2[:, rows].max(axis=1), dof, factor))
        best.append(each)
    return float(np.quantile(np.concatenate(best), 1 - (policy.SIGNIFICANCE_LEVEL if level is None else level)))


def _interpolated(chi2: Array, dof: int, trials_factor: float) -> Array:
    """`sigmas` of many, from a table."""
    roots = np.sqrt(chi2)
    knots = np.linspace(0, roots.max(), 64)
    return np.asarray(np.interp(roots, knots, [sigmas(x * x, dof, trials_factor) for x in knots]))
