"""How much a free curve explains, and what its freedom costs: Gaussian prior on the coefficients, size by the data.

With F the coefficients' information (all that the fit absorbs taken out), g their pull and s^2 K their prior
covariance, -2 ln of the marginal likelihood over that of no curve is  -g' (F + K^-1/s^2)^-1 g + ln det(1 + s^2 K F).
MacKay, Neural Computation 4 (1992) 415; Rasmussen & Williams, Gaussian Processes for Machine Learning (2006), ch. 5.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from discrepancy.arrays import Array
from discrepancy.fitting.significance import chi2_to_sigma
from discrepancy.free_laws.law_kinds import FreeLaw
from discrepancy.policy import current_policy

LENGTHS = (0.05, 0.12, 0.35, 1.0)  # over which the prior's curves change, shares of the range
FLAT = 5.0  # likewise, of a field that hardly changes along an axis
SMOOTH = 0.35  # likewise, of the curves that a free law's significance is looked for in first
SEEN = 1e-8  # of the largest information: directions that show less count for nothing
IDLE = 1e-9  # times the variance of a part that acts: of one that does not
SIZES = np.linspace(-4, 9, 79)  # ln of the prior's size over what the data could just see


@dataclass(frozen=True)
class Prior:
    """Independent coefficients: a curve of the standard deviation `size` that changes over `length`; spread: (J,).

    cost: of its choice, in chi^2.
    """

    length: float
    size: float
    spread: Array
    cost: float = 0.0

    @property
    def precision(self) -> Array:
        """(J, J)"""
        return np.diag(1 / (self.size**2 * self.spread))


@dataclass(frozen=True)
class CurveEvidence:
    """What a free law's coefficients explain: gain > 0 is better than no law, in units of chi^2, freedom paid for."""

    gain: float
    prior: Prior
    coefs: Array


def cost_of_choice(count: int) -> float:
    """What it costs to choose one of so many that are alike beforehand, in chi^2."""
    return current_policy().choice_cost * math.log(count)


def cost_of_strengths(information: Array, found: Array) -> float:
    """What the freedom of an effect's strengths costs, by the same rule as of a free law's coefficients.

    Either all of them may differ from zero or only one, whichever is the likelier.

    Parameters
    ----------
    information : (k, k) array
        In units in which realistic strengths are one.
    found : (k,) array
        The strengths fitted, in the same units.

    Returns
    -------
    float
        In chi^2.
    """
    pull, one = information @ found, cost_of_choice(1 + len(found))
    ways = [(np.arange(len(found)), 0.0)] + [(np.array([k]), one) for k in range(len(found)) if len(found) > 1]
    gains = []
    for way, cost in ways:
        values, axes = np.linalg.eigh(information[np.ix_(way, way)])
        values = np.maximum(values, 1e-300)
        _, each = _gain_at_sizes(values, axes.T @ pull[way])
        gains.append(each.max() - cost)
    return float(found @ pull - max(*gains, 0.0))


def _gain_at_sizes(values: Array, pulls: Array) -> tuple[Array, Array]:
    """The sizes tried of a prior, and the gain of each, from the information (rising) and the pull along its axes."""
    sizes = np.exp(SIZES) / np.sqrt(max(values[-1], 1e-300))
    square = sizes[:, None] ** 2
    return sizes, (square * pulls**2 / (1 + square * values) - np.log1p(square * values)).sum(axis=1)


def iterate_priors(law: FreeLaw) -> Iterator[tuple[float, Array, float]]:
    """What the coefficients may be like: the length of change, their variances (J,), and the cost of the choice.

    A field changes along both axes or along one, and acts along both or along one: three ways of each.
    """
    one = cost_of_choice(3)
    for length in LENGTHS:
        ways = [(law.prior_variances(length), 0.0)]
        if len(law.axes) == 2:
            ways += [(law.prior_variances(length, FLAT), one), (law.prior_variances(FLAT, length), one)]
        for spread, cost in ways:
            yield length, spread, cost
            for part in range(law.parts if law.parts > 1 else 0):
                acts = np.repeat(np.arange(law.parts) == part, law.size // law.parts)
                yield length, np.where(acts, spread, IDLE * spread), cost + one


def maximise_evidence(law: FreeLaw, information: Array, pull: Array) -> CurveEvidence:
    """Choose a free law's prior by the evidence, and the coefficients that are likeliest with it.

    All lengths are as likely beforehand: the gain is that of their mean likelihood, which the best one's choice costs.

    Parameters
    ----------
    law : FreeLaw
    information, pull : (J, J) array, (J,) array
        Of its J coefficients, as of `Fit.information`.

    Returns
    -------
    Weight
    """
    best: CurveEvidence | None = None
    gains = dict.fromkeys(LENGTHS, -math.inf)
    for length, spread, cost in iterate_priors(law):
        acts = np.flatnonzero(spread > IDLE * spread.max())  # of a part that does not, next to nothing is explained
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
            best = CurveEvidence(gain, Prior(length, size, spread, cost), coefs)
    assert best is not None
    mean = 2 * float(logsumexp(np.array(list(gains.values())) / 2) - np.log(len(gains)))
    prior = replace(best.prior, cost=best.prior.cost + best.gain - mean)
    return replace(best, gain=mean, prior=prior)


def compute_significance(law: FreeLaw, information: Array, pull: Array) -> float:
    """How significant a free law is, in sigma: the best of its chi^2 in 1, 2, 4, ... directions, less these trials.

    The directions are those in which a smooth curve would show most. With nothing hidden the pull along them is
    independent and of unit variance. Arguments as of `weigh`.
    """
    root = np.sqrt(law.prior_variances(SMOOTH))
    values, axes = np.linalg.eigh(root[:, None] * information * root)
    seen = values > SEEN * max(values[-1], 1e-300)
    if not seen.any():
        return 0.0
    pulls = (axes[:, seen].T @ (root * pull)) / np.sqrt(values[seen])
    chi2 = np.cumsum(pulls[::-1] ** 2)
    counts = sorted({min(2**k, len(chi2)) for k in range(len(chi2).bit_length() + 1)})
    best = max(chi2_to_sigma(float(chi2[m - 1]), m) for m in counts)
    return float(np.sqrt(max(best**2 - 2 * np.log(len(counts)), 0.0)))
