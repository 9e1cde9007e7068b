"""Departures from laws that both fits assume: one step from a fit, and the average over the laws and departures.

Examples are rolling losses that differ, and a friction that depends on the speed of slip. Chi^2 of all positions hardly
shows them, because few of its degrees of freedom have to do with them. One linear step from a fit shows a departure by
itself, and how it shifts every quantity.

Departures imitate one another in part, so that their measured values are correlated. The quantities are averaged over
all models in which each departure is zero or has a Cauchy prior. This is Bayesian model averaging (Hoeting et al.,
Stat. Sci. 14 (1999) 382). Such a prior (Jeffreys, Theory of Probability, 3rd ed. (1961), 5.2) does not pull a large
departure towards zero, unlike a normal one. All depends smoothly on the tracks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

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
    """A parameter that is zero if a law of the fits holds, as one fit shows it if all other laws hold.

    response (m,): by how much the value grows with each coordinate of the positions, per standard error of these.
    shared (k,): by how much the value grows per standard error of each key of the camera file.
    effect (20,): by how much the quantities of the fit are too low, per unit of the parameter.
    cov_with_tied (20,): of these quantities with the parameter by the tied fit, by the noise of the positions; of a
    free fit.
    typical: its size if the law does not hold, as expected before: half of the prior is nearer to zero.
    expected: probability that the law does not hold, before.
    is_shown: whether this fit shows the parameter well enough; otherwise only its effect and covariance count.
    """

    value: float
    std: float
    response: Floats
    shared: Floats
    effect: Floats
    cov_with_tied: Floats
    typical: float = 0.0
    expected: float = 0.5
    is_shown: bool = True

    @property
    def significance(self) -> float:
        """The parameter in standard errors, without its sign."""
        return abs(self.value) / self.std

    @property
    def p_value(self) -> float:
        """The probability of so large a value if the law holds."""
        return float(chdtrc(1, self.significance**2))


@dataclass(frozen=True)
class DeparturePosterior:
    """The posterior of n departures, each in standard errors of its measured value, averaged over all models.

    zero: probability that all are zero. mean (n,), cov (n, n). precision (n, n): the inverse covariance of an estimate
    of all together, which is also the covariance of the values as measured one by one.
    """

    zero: float
    mean: Floats
    cov: Floats
    precision: Floats

    @property
    def followed(self) -> Floats:
        """The shares (n, n) of the noise of the measured values that the mean follows.

        The covariance is also the derivative of the mean by normal measured values (Tweedie's formula; Efron, J. Am.
        Stat. Assoc. 106 (2011) 1602). If it exceeds that of the noise, it says that the models disagree, not that the
        mean follows the noise more.
        """
        root = np.linalg.cholesky(self.precision)
        shares, axes = np.linalg.eigh(root.T @ self.cov @ root)
        back = np.linalg.solve(root.T, axes)
        return np.asarray(back * np.minimum(shares, 1.0) @ back.T, dtype=np.float64)


def weigh_departures(departures: Sequence[LawDeparture]) -> DeparturePosterior:
    """Average n departures over the 2^n models in which each is zero or not."""
    size = [one.std for one in departures]
    noise = sum(
        rows @ rows.T
        for rows in (np.array([getattr(one, name) for one in departures]) for name in ("response", "shared"))
    )
    precision = noise / np.outer(size, size)
    np.fill_diagonal(precision, 1.0)
    z, typical = (np.array([getattr(one, name) for one in departures]) / size for name in ("value", "typical"))
    return find_posterior(z, precision, typical, [one.expected for one in departures])


def find_posterior(
    z: Floats, precision: Floats, scales: Floats, expected: Sequence[float], *, step: float = 0.3
) -> DeparturePosterior:
    """Find the posterior of n parameters that are zero or not, from measured values with normal errors.

    z (n,): the values, each as measured if all others are zero. precision (n, n): as of `DeparturePosterior`. scales
    (n,): half of the Cauchy prior of a parameter is nearer to zero. All are in standard errors of the values.
    expected: probabilities that the parameters are not zero, before.

    A Cauchy prior is a mixture of normal ones whose standard deviation is the scale over |u|, u standard normal
    (Andrews & Mallows, J. R. Stat. Soc. B 36 (1974) 99). With normal priors all is in closed form. The trapezoidal
    rule over log |u| converges exponentially (Trefethen & Weideman, SIAM Rev. 56 (2014) 385): to 1e-6 with this step.
    """
    log_u = np.arange(-10.0, 2.1, step)
    share = step * np.sqrt(2 / np.pi) * np.exp(log_u - np.exp(2 * log_u) / 2)  # wider normal priors explain nothing
    widths = [np.append(0.0, scale / np.exp(log_u)) for scale in scales]
    priors = [np.append(1 - p, p * share) for p in expected]
    width = np.stack(np.meshgrid(*widths, indexing="ij"), axis=-1).reshape(-1, len(z))
    prior = np.prod(np.meshgrid(*priors, indexing="ij"), axis=0).ravel()
    shrunk = np.eye(len(z)) + width[:, :, None] * precision * width[:, None, :]
    covs = width[:, :, None] * np.linalg.inv(shrunk) * width[:, None, :]
    means = covs @ z
    log_evidence = (means @ z - np.linalg.slogdet(shrunk)[1]) / 2
    weight = prior * np.exp(log_evidence - log_evidence.max())
    weight /= weight.sum()
    mean = weight @ means
    cov = np.tensordot(weight, covs, 1) + (weight[:, None] * (means - mean)).T @ (means - mean)
    return DeparturePosterior(float(weight[0]), mean, cov, precision)


def average_over_departures(
    values: DerivedValues, departures: Sequence[LawDeparture], tied: Sequence[LawDeparture] | None = None
) -> DerivedValues:
    """Average the quantities of a fit over its laws and departures from these.

    departures: by this fit. tied: the same by the tied fit, which replace those of a free fit. If the free fit shows a
    departure too, the tied fit's measured value shifts the free quantities by the difference of both effects. If both
    fits are linear, this lowers their variances (Hausman, Econometrica 46 (1978) 1251). Others may be far from it, such
    as those of a slide whose end is hardly seen. The covariance is therefore that of all derivatives by noise and by
    the camera's errors.
    """
    if not departures:
        return values
    used = departures if tied is None else tied
    posterior, size = weigh_departures(used), np.array([one.std for one in used])
    own, by_tied = (np.column_stack([one.effect for one in some]) * size for some in (departures, used))
    apart = (own - by_tied) * [one.is_shown for one in departures]  # effects of the values as measured
    effects = own - apart - apart @ (posterior.precision - np.eye(len(used)))  # each was measured as if others are zero
    followed = posterior.followed
    slopes = apart + effects @ followed  # of the averaged quantities by the values as measured
    response, shared = (np.array([getattr(one, name) / one.std for one in used]) for name in ("response", "shared"))
    together = values.shared @ shared.T
    if tied is not None:
        together = together + np.column_stack([one.cov_with_tied for one in departures]) / size
    mixed = together @ slopes.T
    unknown = effects @ (posterior.cov - followed @ posterior.precision @ followed) @ effects.T
    cov = values.cov + mixed + mixed.T + slopes @ (response @ response.T + shared @ shared.T) @ slopes.T + unknown
    value = values.value + apart @ [one.value / one.std for one in used] + effects @ posterior.mean
    return DerivedValues(value, cov, values.shared + slopes @ shared)


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
