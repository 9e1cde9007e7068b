"""How much a free curve explains, and what its freedom costs: Gaussian prior on the coefficients, size by the data.

With F the coefficients' information (all that the fit absorbs taken out), g their pull and s^2 K their prior
covariance, -2 ln of the marginal likelihood over that of no curve is  -g' (F + K^-1/s^2)^-1 g + ln det(1 + s^2 K F).
MacKay, Neural Computation 4 (1992) 415; Rasmussen & Williams, Gaussian Processes for Machine Learning (2006), ch. 5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from discrepancy.claim import sigmas
from discrepancy.slots import Slot

Array = NDArray[np.float64]

LENGTHS = (0.05, 0.12, 0.35, 1.0)  # over which the prior's curves change, shares of the range
SMOOTH = 0.35  # likewise, of the curves that a slot's significance is looked for in first
SEEN = 1e-8  # of the largest information: directions that show less count for nothing
SIZES = np.linspace(-4, 9, 79)  # ln of the prior's size over what the data could just see


@dataclass(frozen=True)
class Prior:
    """Independent coefficients: a curve of the standard deviation `size` that changes over `length`; spread: (J,)."""

    length: float
    size: float
    spread: Array

    @property
    def precision(self) -> Array:
        """(J, J)"""
        return np.diag(1 / (self.size**2 * self.spread))


@dataclass(frozen=True)
class Weight:
    """What a slot's coefficients explain: gain > 0 is better than no slot, in units of chi^2, freedom paid for."""

    gain: float
    prior: Prior
    coefs: Array


def freedom(information: Array, found: Array) -> float:
    """What the freedom of numbers fitted to be `found` costs, in chi^2: the same price as of a slot's coefficients.

    information: (k, k), in units in which realistic numbers are one.
    """
    values, axes = np.linalg.eigh(information)
    values = np.maximum(values, 1e-300)
    pulls = values * (axes.T @ found)
    sizes = np.exp(SIZES)[:, None] / np.sqrt(values[-1])
    gains = (sizes**2 * pulls**2 / (1 + sizes**2 * values) - np.log1p(sizes**2 * values)).sum(axis=1)
    return float((pulls**2 / values).sum() - max(gains.max(), 0.0))


def weigh(slot: Slot, information: Array, pull: Array) -> Weight:
    """The best of the priors for coefficients with this information F (J, J) and pull g (J,)."""
    best: Weight | None = None
    for length in LENGTHS:
        root = np.sqrt(slot.spread(length))
        values, axes = np.linalg.eigh(root[:, None] * information * root)
        values = np.maximum(values, 0.0)
        pulls = axes.T @ (root * pull)
        unit = 1 / np.sqrt(max(values[-1], 1e-300))
        sizes = unit * np.exp(SIZES)[:, None]
        gains = (sizes**2 * pulls**2 / (1 + sizes**2 * values) - np.log1p(sizes**2 * values)).sum(axis=1)
        k = int(gains.argmax())
        if best is None or gains[k] > best.gain:
            size = float(sizes[k, 0])
            coefs = root * (axes @ (size**2 / (1 + size**2 * values) * pulls))
            best = Weight(float(gains[k]), Prior(length, size, root**2), coefs)
    assert best is not None
    return best


def significance(slot: Slot, information: Array, pull: Array) -> float:
    """The slot's sigma: the best of its chi^2 in the 1, 2, 4, ... directions that show most, corrected for these looks.

    The directions are ordered by what a smooth curve would show in them. They are independent and of unit variance
    with nothing hidden.
    """
    root = np.sqrt(slot.spread(SMOOTH))
    values, axes = np.linalg.eigh(root[:, None] * information * root)
    seen = values > SEEN * max(values[-1], 1e-300)
    if not seen.any():
        return 0.0
    pulls = (axes[:, seen].T @ (root * pull)) / np.sqrt(values[seen])
    chi2 = np.cumsum(pulls[::-1] ** 2)
    looks = sorted({min(2**k, len(chi2)) for k in range(len(chi2).bit_length() + 1)})
    best = max(sigmas(float(chi2[m - 1]), m) for m in looks)
    return float(np.sqrt(max(best**2 - 2 * np.log(len(looks)), 0.0)))
