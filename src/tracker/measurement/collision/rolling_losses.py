"""Tests the law that both balls have one rolling loss, and corrects the quantities for a difference.

The fits have one rolling loss. The struck ball shows it after its slide, the striker also before the hit. If the two
differ, the common loss shifts v0 and all that follows from it. Chi^2 of all positions hardly shows this.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from tracker.measurement.collision.derived import DerivedValues, derive_from_free, derive_from_tied
from tracker.measurement.collision.least_squares import CollisionFit, WhitenedResiduals

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class LossDifference:
    """By how much the struck ball's deceleration in rolling exceeds that of the striker, m/s^2.

    effect (20,): on the quantities of the fit, per m/s^2.
    """

    value: float
    std: float
    effect: Floats

    @property
    def significance(self) -> float:
        """The difference in standard errors, without its sign."""
        return abs(self.value) / self.std

    @property
    def p_value(self) -> float:
        """The probability of so large a difference if the losses are equal."""
        return float(chdtrc(1, self.significance**2))

    def correct(self, values: DerivedValues, significance: float, *, corrected_sigma: float = 2.0) -> DerivedValues:
        """Let the quantities of the fit carry the difference; `significance` is that of the fit which shows it best.

        From `corrected_sigma` standard errors on, the values are those of a fit in which each ball has its own loss,
        with their errors. Below, the values stay, and the variance that the difference has beyond its own error widens
        the errors. A difference below its error changes nothing.
        """
        corrected = significance > corrected_sigma
        size = self.std * (1.0 if corrected else np.sqrt(max(significance**2 - 1, 0.0)))
        shift, wider = self.effect * self.value * corrected, self.effect * size
        return replace(values, value=values.value + shift, cov=values.cov + np.outer(wider, wider))


def compare_losses(
    fit: CollisionFit, tied: bool, known: Floats | None = None, *, least_share: float = 1e-3
) -> LossDifference | None:
    """Find the difference of the rolling losses by one linear step from a tied or a free fit.

    known (m, k): derivatives of the whitened residuals by errors of the camera file, per standard error. None where
    the parameters of the fit absorb a difference, however large, but for `least_share` of its displacements.
    """
    problem = WhitenedResiduals(fit.pair, tied)
    residual, rows = problem(fit.parameters[problem.index])
    cov = fit.cov[np.ix_(problem.index, problem.index)]
    by = rows[:, problem.names.index("decel")].copy()
    by[2 * len(fit.pair.struck) :] = 0.0  # the striker's positions and the priors
    shift = -cov @ rows.T @ by
    left = by + rows @ shift
    square, pull = float(left @ left), float(left @ residual)
    if known is not None:  # the camera's errors are parameters with a prior
        rest = known - rows @ (cov @ (rows.T @ known))
        inverse = np.linalg.inv(np.eye(known.shape[1]) + rest.T @ rest)
        square -= float(left @ rest @ inverse @ rest.T @ left)
        pull -= float(left @ rest @ inverse @ rest.T @ residual)
    if not square > least_share**2 * float(by @ by):
        return None
    step = np.zeros(len(fit.parameters))
    step[problem.index] = shift
    std = 1.0 / np.sqrt(square)

    def derive(by: float) -> Floats:
        at = fit.parameters + by * std * step
        if tied:
            return derive_from_tied(at, fit.cov, fit.pair.diameter, fit.pair.spin).value
        return derive_from_free(at, fit.cov, fit.pair.diameter).value

    small = 0.01  # of a standard error
    effect = np.nan_to_num((derive(small) - derive(-small)) / (2 * small * std))
    return LossDifference(-pull / square, float(std), effect)
