"""Tests the law that both balls have one rolling loss, and lets the quantities carry a possible difference.

The fits have one rolling loss. The struck ball shows it after its slide, the striker also before the hit. If the two
differ, the common loss shifts v0 and all that follows from it. Chi^2 of all positions hardly shows this.

The quantities are averaged over two models (Bayesian model averaging; Hoeting et al., Statist. Sci. 14 (1999) 382): the
losses are equal, or they differ by an amount with a Cauchy prior. Such a prior (Jeffreys, Theory of Probability, 3rd
ed. (1961), 5.2) does not pull a large difference towards zero, unlike a normal one. All depends smoothly on the tracks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, expit, wofz

from tracker.measurement.collision.derived import (
    QUANTITY_NAMES,
    DerivedValues,
    derive_from_free,
    derive_from_tied,
)
from tracker.measurement.collision.least_squares import CollisionFit, WhitenedResiduals

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class LossDifference:
    """By how much the struck ball's deceleration in rolling exceeds that of the striker, m/s^2.

    response (m,): by how much the value grows with each coordinate of the positions, per standard error of these.
    shared (k,): by how much the value grows per standard error of each key of the camera file.
    loss, loss_std: the deceleration of the fit, at the speed with which the struck ball begins to roll.
    effect (20,): by how much the quantities of the fit are too low, per m/s^2.
    cov_with_tied (20,): of these quantities with the difference of the tied fit, by the noise of the positions; of a
    free fit.
    """

    value: float
    std: float
    response: Floats
    shared: Floats
    loss: float
    loss_std: float
    effect: Floats
    cov_with_tied: Floats

    @property
    def significance(self) -> float:
        """The difference in standard errors, without its sign."""
        return abs(self.value) / self.std

    @property
    def p_value(self) -> float:
        """The probability of so large a difference if the losses are equal."""
        return float(chdtrc(1, self.significance**2))

    def weigh(self, typical_share: float) -> ModelWeight:
        """Compare equal losses with losses that differ, typically by a share of the loss.

        The loss is the root of its expected square: noise may make the fitted loss small, but not the true one.
        """
        typical = typical_share * float(np.hypot(self.loss, self.loss_std))
        return weigh_shift(self.value / self.std, typical / self.std)

    def correct(self, values: DerivedValues, weight: ModelWeight, tied: LossDifference | None = None) -> DerivedValues:
        """Average the quantities of a fit over both models.

        tied: a difference that replaces that of the fit itself, a free one. The noise of the tied difference then
        shifts the free quantities also by the difference of both effects. If both fits are linear, this lowers their
        variances (Hausman, Econometrica 46 (1978) 1251). Others may be far from it, such as those of a slide whose end
        is hardly seen. The covariance is therefore that of all derivatives by noise and by the camera's errors.
        """
        by = self if tied is None else tied
        apart = self.effect - by.effect
        # The posterior variance of a normal measurement is also the derivative of the mean by it (Tweedie). Above 1 it
        # says that the models disagree, not that the mean follows the noise more.
        followed = min(weight.variance, 1.0)
        slope = apart + followed * by.effect
        together = values.shared @ by.shared + (0.0 if tied is None else self.cov_with_tied)
        mixed, own = np.outer(slope, together), by.response @ by.response + by.shared @ by.shared
        cov = values.cov + mixed + mixed.T + own * np.outer(slope, slope)
        unknown = by.effect * by.std * np.sqrt(weight.variance - followed**2)
        value = values.value + apart * by.value + by.effect * by.std * weight.mean
        shared = values.shared + np.outer(slope, by.shared)
        return DerivedValues(value, cov + np.outer(unknown, unknown), shared)


@dataclass(frozen=True)
class ModelWeight:
    """The posterior of a parameter that is zero or has a Cauchy prior, after one measurement, in its standard errors.

    probability: that the parameter is not zero, given 1/2 before. shifted, shifted_variance: mean and variance if so.
    """

    probability: float
    shifted: float
    shifted_variance: float

    @property
    def mean(self) -> float:
        """The mean over both models."""
        return self.probability * self.shifted

    @property
    def variance(self) -> float:
        """The variance within the models and between them."""
        between = self.probability * (1 - self.probability) * self.shifted**2
        return self.probability * self.shifted_variance + between


def weigh_shift(z: float, scale: float) -> ModelWeight:
    """Compare a zero parameter with one of a Cauchy prior, from a measurement with a normal error.

    z: the measured value; scale: half of the prior is nearer to zero. Both are in standard errors.

    The measured value then has a Voigt profile, the real part of Faddeeva's function w. The derivatives of its
    logarithm give mean and variance (Tweedie's formula; Efron, J. Am. Stat. Assoc. 106 (2011) 1602).
    """
    if scale == 0:
        return ModelWeight(0.5, 0.0, 0.0)
    w, first, second = _differentiate_faddeeva((z + 1j * scale) / np.sqrt(2))
    slope, bend = first.real / w.real / np.sqrt(2), second.real / w.real / 2
    probability = float(expit(np.log(w.real) + z**2 / 2))
    return ModelWeight(probability, float(z + slope), float(max(1 + bend - slope**2, 0.0)))


def _differentiate_faddeeva(at: complex, *, far: float = 1e3) -> tuple[complex, complex, complex]:
    """Faddeeva's function w with two derivatives; beyond `far` by its asymptotic series, where the formulas cancel."""
    if abs(at) > far:
        per, nearly = 1j / (np.sqrt(np.pi) * at), 1 / at**2
        return per * (1 + nearly / 2), -per / at * (1 + 1.5 * nearly), 2 * per * nearly * (1 + 3 * nearly)
    w = complex(wofz(at))
    first = 2j / np.sqrt(np.pi) - 2 * at * w
    return w, first, -2 * (w + at * first)


def compare_losses(
    fit: CollisionFit,
    tied: bool,
    known: Floats | None = None,
    by_tied: LossDifference | None = None,
    *,
    least_share: float = 1e-3,
) -> LossDifference | None:
    """Find the difference of the rolling losses by one linear step from a tied or a free fit.

    known (m, k): derivatives of the whitened residuals by errors of the camera file, per standard error. by_tied: the
    difference of the tied fit of the same positions, for a free fit. None where the parameters of the fit absorb a
    difference, however large, but for `least_share` of its displacements.
    """
    problem = WhitenedResiduals(fit.pair, tied)
    residual, rows = problem(fit.parameters[problem.index])
    cov = fit.cov[np.ix_(problem.index, problem.index)]
    by = rows[:, problem.names.index("decel")].copy()
    positions = 2 * len(fit.pair)
    by[2 * len(fit.pair.struck) :] = 0.0  # the striker's positions and the priors
    shift = -cov @ rows.T @ by
    left = by + rows @ shift
    weighted = left
    if known is not None:  # the camera's errors are parameters with a prior
        rest = known - rows @ (cov @ (rows.T @ known))
        inverse = np.linalg.inv(np.eye(known.shape[1]) + rest.T @ rest)
        weighted = left - rest @ (inverse @ (rest.T @ left))
    square, pull = float(weighted @ left), float(weighted @ residual)
    if not square > least_share**2 * float(by @ by):
        return None
    std = 1.0 / np.sqrt(square)

    def derive(at: Floats) -> DerivedValues:
        if tied:
            return derive_from_tied(at, fit.cov, fit.pair.diameter, fit.pair.spin)
        return derive_from_free(at, fit.cov, fit.pair.diameter)

    def differentiate(by: Floats, size: float) -> Floats:
        """The change of the quantities per change `by` of the parameters, from so much of it."""
        step = np.zeros(len(fit.parameters))
        step[problem.index] = size * by
        return np.nan_to_num((derive(fit.parameters + step).value - derive(fit.parameters - step).value) / (2 * size))

    small = 0.01  # of a standard error
    effect = differentiate(shift, small * std)
    cov_with_tied = np.zeros(len(effect))
    if by_tied is not None:
        size = small / float(np.sqrt(by_tied.response @ by_tied.response))
        cov_with_tied = differentiate(-cov @ rows[:positions].T @ by_tied.response, size)
    loss, loss_std = _find_loss(derive(fit.parameters))
    return LossDifference(
        value=-pull / square,
        std=float(std),
        response=-weighted[:positions] / square,
        shared=np.zeros(0) if known is None else -(weighted @ known) / square,
        loss=loss,
        loss_std=loss_std,
        effect=effect,
        cov_with_tied=cov_with_tied,
    )


def _find_loss(values: DerivedValues) -> tuple[float, float]:
    """The deceleration with which the struck ball begins to roll, m/s^2, and its standard error."""
    index = [QUANTITY_NAMES.index(name) for name in ("drag", "decel", "v1f")]
    drag, decel, speed = np.nan_to_num(values.value[index])
    slope = np.array([speed, 1.0, drag])
    variance = slope @ np.nan_to_num(values.cov[np.ix_(index, index)]) @ slope
    return float(drag * speed + decel), float(np.sqrt(max(variance, 0.0)))
