"""The marginal likelihood of a free curve, and the costs in chi^2 of freedom, strengths and choices.

The coefficients have a Gaussian prior, whose size maximises the marginal likelihood. F is the information of the
coefficients, marginal over all that the fit absorbs. Their pull g is the gradient of -chi^2/2, and s^2 K is their prior
covariance. Then -2 ln of the marginal likelihood, relative to no curve, is -g' (F + K^-1/s^2)^-1 g + ln det(1 + s^2 K
F).

MacKay, Neural Computation 4 (1992) 415; Rasmussen & Williams, Gaussian Processes for Machine Learning (2006), ch. 5.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from discrepancy.fitting.significance import chi2_to_sigma
from discrepancy.free_laws.law_kinds import FreeLaw
from discrepancy.policy import current_policy
from synthcam_shared.arrays import Array

PRIOR_LENGTHS = (0.05, 0.12, 0.35, 1.0)  # over which curves of a prior change, as shares of the range
IDLE_VARIANCE = 1e-9  # prior variance of a part that does not act, relative to one that does


@dataclass(frozen=True)
class CoefficientPrior:
    """A Gaussian prior of independent coefficients."""

    length: float  # over which its curves change, as a share of the range
    size: float  # the standard deviation of its curves
    spread: Array  # (J,): the coefficients' variances at size one
    cost: float = 0.0  # of choosing this prior among all, in chi^2

    @property
    def precision(self) -> Array:
        """The inverse covariance, (J, J)."""
        return np.diag(1 / (self.size**2 * self.spread))


@dataclass(frozen=True)
class CurveEvidence:
    """The best prior of a free law, and how much the law then explains."""

    gain: float  # in chi^2 over no law, freedom subtracted; positive is better than no law
    prior: CoefficientPrior
    coefs: Array  # (J,): the most probable ones


def cost_of_choice(count: int) -> float:
    """The cost in chi^2 of choosing one of `count` alternatives of equal prior probability."""
    return current_policy().choice_cost * math.log(count)


def cost_of_strengths(information: Array, found: Array) -> float:
    """The cost in chi^2 of an effect's free strengths, by the same rule as for a free law's coefficients.

    Either all strengths may differ from zero or one of them alone, whichever has the larger marginal likelihood. The
    information (k, k) and the fitted strengths (k,) are in units in which realistic strengths are one.
    """
    pull, one = information @ found, cost_of_choice(1 + len(found))
    alone = [(np.array([k]), one) for k in range(len(found)) if len(found) > 1]
    gains = []
    for subset, cost in [(np.arange(len(found)), 0.0), *alone]:
        values, axes = np.linalg.eigh(information[np.ix_(subset, subset)])
        values = np.maximum(values, 1e-300)
        _, each = _gain_at_sizes(values, axes.T @ pull[subset])
        gains.append(each.max() - cost)
    return float(found @ pull - max(*gains, 0.0))


def _gain_at_sizes(values: Array, pulls: Array) -> tuple[Array, Array]:
    """Sizes of a prior, from 0.02 to 8,000 times what data could just detect, and the gain of each; values ascend."""
    sizes = np.exp(np.linspace(-4, 9, 79)) / np.sqrt(max(values[-1], 1e-300))
    square = sizes[:, None] ** 2
    return sizes, (square * pulls**2 / (1 + square * values) - np.log1p(square * values)).sum(axis=1)


def iterate_priors(law: FreeLaw) -> Iterator[tuple[float, Array, float]]:
    """Yield the priors of a free curve: the length of change, the variances (J,), and the cost of the choice.

    A map may change along both axes or along one of them, and a vector may have both components or one of them. Each of
    the three alternatives costs a choice.
    """
    one, flat = cost_of_choice(3), 5.0  # the length along an axis of no change, in ranges
    for length in PRIOR_LENGTHS:
        shapes = [(law.prior_variances(length), 0.0)]
        if len(law.axes) == 2:
            shapes += [(law.prior_variances(length, flat), one), (law.prior_variances(flat, length), one)]
        for spread, cost in shapes:
            yield length, spread, cost
            for part in range(law.parts if law.parts > 1 else 0):
                acts = np.repeat(np.arange(law.parts) == part, law.size // law.parts)
                yield length, np.where(acts, spread, IDLE_VARIANCE * spread), cost + one


def maximise_evidence(law: FreeLaw, information: Array, pull: Array) -> CurveEvidence:
    """Choose the prior of a free law that maximises the marginal likelihood, and its most probable coefficients.

    All lengths have the same prior probability, so the gain is that of their mean likelihood. The difference from the
    best length is the cost of choosing it. information, pull: (J, J) and (J,), of its J coefficients, from
    `ModelFit.information`.
    """
    best: CurveEvidence | None = None
    gains = dict.fromkeys(PRIOR_LENGTHS, -math.inf)
    for length, spread, cost in iterate_priors(law):
        acts = np.flatnonzero(spread > IDLE_VARIANCE * spread.max())  # an idle part explains next to nothing
        root = np.sqrt(spread[acts])
        values, axes = np.linalg.eigh(root[:, None] * information[np.ix_(acts, acts)] * root)
        values = np.maximum(values, 0.0)
        pulls = axes.T @ (root * pull[acts])
        sizes, each = _gain_at_sizes(values, pulls)
        k = int(each.argmax())
        gain = float(each[k]) - cost
        gains[length] = max(gains[length], gain)
        if best is None or gain > best.gain:
            size = float(sizes[k])
            coefs = np.zeros(len(spread))
            coefs[acts] = root * (axes @ (size**2 / (1 + size**2 * values) * pulls))
            best = CurveEvidence(gain, CoefficientPrior(length, size, spread, cost), coefs)
    assert best is not None
    mean = 2 * float(logsumexp(np.array(list(gains.values())) / 2) - np.log(len(gains)))
    prior = replace(best.prior, cost=best.prior.cost + best.gain - mean)
    return replace(best, gain=mean, prior=prior)


def compute_significance(law: FreeLaw, information: Array, pull: Array) -> float:
    """Compute the significance of a free law, in sigma, from information and pull as for `maximise_evidence`.

    It is the largest significance of chi^2 in the first 1, 2, 4, ... directions, corrected for these trials. The
    directions are ordered by how well a smooth curve would be detected along them. Without a hidden law the pulls along
    them are independent and of unit variance.
    """
    length = 0.35  # over which smooth curves change, as a share of the range
    root = np.sqrt(law.prior_variances(length))
    values, axes = np.linalg.eigh(root[:, None] * information * root)
    informative = values > 1e-8 * max(values[-1], 1e-300)  # below that it is rounding error
    if not informative.any():
        return 0.0
    pulls = (axes[:, informative].T @ (root * pull)) / np.sqrt(values[informative])
    chi2 = np.cumsum(pulls[::-1] ** 2)
    counts = sorted({min(2**k, len(chi2)) for k in range(len(chi2).bit_length() + 1)})
    best = max(chi2_to_sigma(float(chi2[m - 1]), m) for m in counts)
    return float(np.sqrt(max(best**2 - 2 * np.log(len(counts)), 0.0)))
