"""Departures from a law that both fits assume: one step from a fit, and the average over the law and a departure.

Examples are rolling losses that differ, and a friction that depends on the speed of slip. Chi^2 of all positions hardly
shows them, because few of its degrees of freedom have to do with them. One linear step from a fit shows the departure
by itself, and how it shifts every quantity.

The quantities are averaged over two models (Bayesian model averaging; Hoeting et al., Statist. Sci. 14 (1999) 382): the
law holds, or a departure has a Cauchy prior. Such a prior (Jeffreys, Theory of Probability, 3rd ed. (1961), 5.2) does
not pull a large departure towards zero, unlike a normal one. All depends smoothly on the tracks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, expit, logit, wofz

from tracker.measurement.collision.derived import (
    DerivedValues,
    derive_from_free,
    derive_from_tied,
    derive_values_from_tied,
)
from tracker.measurement.collision.least_squares import CollisionFit, WhitenedResiduals

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class LawDeparture:
    """A parameter that is zero if a law of the fits holds, as one fit shows it.

    response (m,): by how much the value grows with each coordinate of the positions, per standard error of these.
    shared (k,): by how much the value grows per standard error of each key of the camera file.
    effect (20,): by how much the quantities of the fit are too low, per unit of the parameter.
    cov_with_tied (20,): of these quantities with the parameter by the tied fit, by the noise of the positions; of a
    free fit.
    typical: its size if the law does not hold, as expected before: half of the prior is nearer to zero.
    expected: probability that the law does not hold, before.
    """

    value: float
    std: float
    response: Floats
    shared: Floats
    effect: Floats
    cov_with_tied: Floats
    typical: float = 0.0
    expected: float = 0.5

    @property
    def significance(self) -> float:
        """The parameter in standard errors, without its sign."""
        return abs(self.value) / self.std

    @property
    def p_value(self) -> float:
        """The probability of so large a value if the law holds."""
        return float(chdtrc(1, self.significance**2))

    @cached_property
    def weight(self) -> ModelWeight:
        """The comparison of both models."""
        return weigh_shift(self.value / self.std, self.typical / self.std, self.expected)


@dataclass(frozen=True)
class ModelWeight:
    """The posterior of a parameter that is zero or has a Cauchy prior, after one measurement, in its standard errors.

    probability: that the parameter is not zero. shifted, shifted_variance: mean and variance if so.
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

    @property
    def followed(self) -> float:
        """The share of the noise of the measurement that the mean follows.

        The variance is also the derivative of the mean by a normal measurement (Tweedie's formula). Above 1 it says
        that the models disagree, not that the mean follows the noise more.
        """
        return min(self.variance, 1.0)


def average_over_departures(
    values: DerivedValues, departures: Sequence[LawDeparture], tied: Sequence[LawDeparture] | None = None
) -> DerivedValues:
    """Average the quantities of a fit over its laws and departures from these.

    departures: by this fit. tied: the same by the tied fit, which replace those of a free fit. Their noise then shifts
    the free quantities also by the difference of both effects. If both fits are linear, this lowers their variances
    (Hausman, Econometrica 46 (1978) 1251). Others may be far from it, such as those of a slide whose end is hardly
    seen. The covariance is therefore that of all derivatives by noise and by the camera's errors.
    """
    if not departures:
        return values
    used = departures if tied is None else tied
    effects = np.column_stack([one.effect for one in used])
    apart = np.column_stack([one.effect for one in departures]) - effects
    std, mean, variance, followed = np.array(
        [(one.std, one.weight.mean, one.weight.variance, one.weight.followed) for one in used]
    ).T
    slopes = apart + effects * followed  # of the averaged quantities by the departures as measured
    response, shared = (np.array([getattr(one, name) for one in used]) for name in ("response", "shared"))
    together = values.shared @ shared.T
    if tied is not None:
        together = together + np.column_stack([one.cov_with_tied for one in departures])
    mixed = together @ slopes.T
    unknown = effects * std * np.sqrt(variance - followed**2)
    cov = values.cov + mixed + mixed.T + slopes @ (response @ response.T + shared @ shared.T) @ slopes.T
    value = values.value + apart @ np.array([one.value for one in used]) + effects @ (std * mean)
    return DerivedValues(value, cov + unknown @ unknown.T, values.shared + slopes @ shared)


def weigh_shift(z: float, scale: float, expected: float = 0.5) -> ModelWeight:
    """Compare a zero parameter with one of a Cauchy prior, from a measurement with a normal error.

    z: the measured value; scale: half of the prior is nearer to zero. Both are in standard errors.
    expected: probability that the parameter is not zero, before.

    The measured value then has a Voigt profile, the real part of Faddeeva's function w. The derivatives of its
    logarithm give mean and variance (Tweedie's formula; Efron, J. Am. Stat. Assoc. 106 (2011) 1602).
    """
    if scale == 0:
        return ModelWeight(expected, 0.0, 0.0)
    w, first, second = _differentiate_faddeeva((z + 1j * scale) / np.sqrt(2))
    slope, bend = first.real / w.real / np.sqrt(2), second.real / w.real / 2
    probability = float(expit(np.log(w.real) + z**2 / 2 + logit(expected)))
    return ModelWeight(probability, float(z + slope), float(max(1 + bend - slope**2, 0.0)))


def _differentiate_faddeeva(at: complex, *, far: float = 1e3) -> tuple[complex, complex, complex]:
    """Faddeeva's function w with two derivatives; beyond `far` by its asymptotic series, where the formulas cancel."""
    if abs(at) > far:
        per, nearly = 1j / (np.sqrt(np.pi) * at), (1 / at) ** 2
        return per * (1 + nearly / 2), -per / at * (1 + 1.5 * nearly), 2 * per * nearly * (1 + 3 * nearly)
    w = complex(wofz(at))
    first = 2j / np.sqrt(np.pi) - 2 * at * w
    return w, first, -2 * (w + at * first)


def derive_quantities(fit: CollisionFit, tied: bool) -> DerivedValues:
    """Derive the quantities of a fit."""
    if tied:
        return derive_from_tied(fit.parameters, fit.cov, fit.pair.diameter, fit.pair.spin)
    return derive_from_free(fit.parameters, fit.cov, fit.pair.diameter)


def find_departure(
    fit: CollisionFit,
    tied: bool,
    displace: Callable[[WhitenedResiduals, Floats], Floats],
    known: Floats | None = None,
    by_tied: LawDeparture | None = None,
    *,
    least_share: float = 1e-3,
) -> LawDeparture | None:
    """Find a departure by one linear step from a tied or a free fit, without what is expected of it before.

    displace(problem, rows): derivative of the whitened residuals (m,) by the parameter; `rows` (m, p) has those by the
    fitted parameters. known (m, k): derivatives by errors of the camera file, per standard error. by_tied: the same
    departure by the tied fit of the same positions, for a free fit. None where the parameters of the fit absorb the
    departure, however large, but for `least_share` of its displacements.
    """
    problem = WhitenedResiduals(fit.pair, tied)
    residual, rows = problem(fit.parameters[problem.index])
    cov = fit.cov[np.ix_(problem.index, problem.index)]
    by = displace(problem, rows)
    positions = 2 * len(fit.pair)
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
    by_camera = None  # shifts of the parameters; they change the weights with which a free fit averages both balls
    if known is not None:
        by_camera = np.zeros((len(fit.parameters), known.shape[1]))
        by_camera[problem.index] = -cov @ rows.T @ known

    def derive_values(at: Floats) -> Floats:
        if tied:
            return derive_values_from_tied(at, fit.pair.diameter, fit.pair.spin)
        return derive_from_free(at, fit.cov, fit.pair.diameter, by_camera).value

    def differentiate(by: Floats, size: float) -> Floats:
        """The change of the quantities per change `by` of the parameters, from so much of it."""
        step = np.zeros(len(fit.parameters))
        step[problem.index] = size * by
        more, less = (derive_values(fit.parameters + sign * step) for sign in (1, -1))
        return np.nan_to_num((more - less) / (2 * size))

    small = 0.01  # of a standard error
    effect = differentiate(shift, small * std)
    cov_with_tied = np.zeros(len(effect))
    if by_tied is not None:
        size = small / float(np.sqrt(by_tied.response @ by_tied.response))
        cov_with_tied = differentiate(-cov @ rows[:positions].T @ by_tied.response, size)
    return LawDeparture(
        value=-pull / square,
        std=float(std),
        response=-weighted[:positions] / square,
        shared=np.zeros(0) if known is None else -(weighted @ known) / square,
        effect=effect,
        cov_with_tied=cov_with_tied,
    )
