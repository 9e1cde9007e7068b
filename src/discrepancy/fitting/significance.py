"""Converts chi^2 to sigma, counts independent trials, and computes the chance threshold of the best of many."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import chdtrc, ndtri_exp

from discrepancy.policy import current_policy
from synthcam_shared.arrays import Array


def chi2_to_sigma(chi2: float, dof: int, trials_factor: float = 1.0) -> float:
    """Convert a chi^2 to the |z| of a normal variable with the same p-value; 0 where it is as large by chance.

    trials_factor: the number of independent trials, if chi^2 is the best of several (look-elsewhere effect). Twice its
    logarithm is subtracted from sigma squared, the leading term for rare events.
    """
    if trials_factor > 1:
        return math.sqrt(max(chi2_to_sigma(chi2, dof) ** 2 - 2 * math.log(trials_factor), 0.0))
    if dof == 1:
        return math.sqrt(max(chi2, 0.0))
    p = float(chdtrc(dof, max(chi2, 0.0)))
    if p > 1e-290:
        log_p = math.log(p)
    else:  # the leading term of the tail
        half, x = dof / 2, chi2 / 2
        log_p = half * math.log(x) - x - math.lgamma(half) - math.log(x - half + 1)
    return max(-float(ndtri_exp(log_p - math.log(2))), 0.0)


def explains_too_little(without: float, with_: float, share: float) -> bool:
    """Compare chi^2 per point with and without a claim: true if far more is missing than the claim explains.

    without, with_: chi^2 per point without and with the claim. share: of the excess of chi^2 per point over one that
    the claim must remove.
    """
    return with_ > current_policy().poor_chi2_per_point and without - with_ < share * (without - 1)


def count_trials(every: Sequence[Array]) -> float:
    """Effective number of independent trials of several signatures, each a basis (points, k); 1 if all are the same.

    It is the participation ratio of their Gram matrix, over the largest number of axes of one signature.
    """
    columns = np.concatenate(every, axis=1)
    length = np.linalg.norm(columns, axis=0)
    unit = columns[:, length > 0] / length[length > 0]
    alike = ((unit.T @ unit) ** 2).sum()
    most = max(a.shape[1] for a in every)
    return max(unit.shape[1] ** 2 / float(alike) / most, 1.0) if unit.size else 1.0


def chance_threshold(
    gram: Array,
    sizes: Sequence[int],
    one_sided: Sequence[bool],
    level: float | None = None,
    trials_factors: Sequence[float] = (),
) -> float:
    """The sigma that the best of all candidates exceeds by chance, in a share of cases when nothing is hidden.

    The products of the candidates' signatures with white noise are Gaussian with covariance `gram`. Draws of them,
    40,000 with a fixed seed, give the level to a sixth of itself and its sigma to 1 %.

    gram: (K, K), products of the axes of all candidates. A candidate's axes are an orthonormal basis of its signature
    after projection off everything that the fit absorbs.
    sizes: how many axes each candidate has; their sum is K.
    one_sided: which candidates have a single strength that can have one sign only.
    level: that share; by default `SearchPolicy.significance_level`.
    trials_factors: one for each candidate; by default 1.
    """
    draws, batch, seed = 40_000, 4_000, 20_260
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
    rng, best = np.random.default_rng(seed), []
    for _ in range(draws // batch):
        pulls = rng.standard_normal((batch, len(root))).astype(np.float32) @ root
        single = np.flatnonzero([sizes[k] == 1 and one_sided[k] for k in range(len(sizes))])
        pulls[:, starts[single]] = np.maximum(pulls[:, starts[single]], 0.0)
        chi2 = np.add.reduceat(pulls**2, starts[owners], axis=1)
        each = np.zeros(batch)
        for (dof, factor), rows in alike.items():
            each = np.maximum(each, _tabulate_sigma(chi2[:, rows].max(axis=1), dof, factor))
        best.append(each)
    share = current_policy().significance_level if level is None else level
    return float(np.quantile(np.concatenate(best), 1 - share))


def _tabulate_sigma(chi2: Array, dof: int, trials_factor: float) -> Array:
    """`chi2_to_sigma` of many values, interpolated in a table."""
    roots = np.sqrt(chi2)
    knots = np.linspace(0, roots.max(), 64)
    return np.asarray(np.interp(roots, knots, [chi2_to_sigma(x * x, dof, trials_factor) for x in knots]))
