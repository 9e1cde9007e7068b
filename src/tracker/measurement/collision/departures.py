"""Departures from laws that both fits assume: one step from a fit, and the average over the laws and departures.

Chi^2 of all positions hardly shows them, because few of its degrees of freedom have to do with them. One linear step
from a fit shows a departure by itself, and how it shifts every quantity.

Departures imitate one another in part, so that their measured values are correlated. The quantities are averaged over
all models in which each departure is zero or has a Cauchy prior. This is Bayesian model averaging (Hoeting et al.,
Stat. Sci. 14 (1999) 382). Such a prior (Jeffreys, Theory of Probability, 3rd ed. (1961), 5.2) does not pull a large
departure towards zero, unlike a normal one. All depends smoothly on the tracks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from synthcam_shared.arrays import Array, Ints
from tracker.measurement.collision.adequacy import compute_p_of_rise
from tracker.measurement.collision.collision_model import AFTER, FREE, SLIP_RATE, tied_to_free
from tracker.measurement.collision.derived import (
    QUANTITY_NAMES,
    DerivedValues,
    derive_from_free,
    derive_from_tied,
    derive_values_from_tied,
)
from tracker.measurement.collision.least_squares import CollisionFit, WhitenedResiduals


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
    response: Array
    shared: Array
    effect: Array
    cov_with_tied: Array
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
    mean: Array
    cov: Array
    precision: Array

    @property
    def followed(self) -> Array:
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
    response, shared = (np.array([getattr(one, name) for one in departures]) for name in ("response", "shared"))
    noise = response @ response.T + shared @ shared.T
    precision = noise / np.outer(size, size)
    np.fill_diagonal(precision, 1.0)
    z, typical = (np.array([getattr(one, name) for one in departures]) / size for name in ("value", "typical"))
    return find_posterior(z, precision, typical, [one.expected for one in departures])


def find_posterior(z: Array, precision: Array, scales: Array, expected: Sequence[float]) -> DeparturePosterior:
    """Find the posterior of n parameters that are zero or not, from measured values with normal errors.

    z (n,): the values, each as measured if all others are zero.
    precision (n, n): as of `DeparturePosterior`.
    scales (n,): half of the Cauchy prior of a parameter is nearer to zero. All are in standard errors of the values.
    expected: probabilities that the parameters are not zero, before.

    A Cauchy prior is a mixture of normal ones whose standard deviation is the scale over |u|, u standard normal
    (Andrews & Mallows, J. R. Stat. Soc. B 36 (1974) 99). With normal priors all is in closed form. The trapezoidal
    rule over log |u| converges exponentially (Trefethen & Weideman, SIAM Rev. 56 (2014) 385): to 1e-6 with this step.
    """
    step = 0.3
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


def derive_quantities(fit: CollisionFit) -> DerivedValues:
    """Derive the quantities of a fit."""
    if fit.is_tied:
        return derive_from_tied(fit.parameters, fit.cov, fit.pair.diameter, fit.pair.spin)
    return derive_from_free(fit.parameters, fit.cov, fit.pair.diameter)


def derive_values(fit: CollisionFit, at: Array, diameter: float, shift: Array | None = None) -> Array:
    """Derive the quantities (20,) of a fit at other parameters and diameter (m); shift: as for `derive_from_free`."""
    if fit.is_tied:
        return derive_values_from_tied(at, diameter, fit.pair.spin)
    return derive_from_free(at, fit.cov, diameter, shift).value


def find_departure(
    fit: CollisionFit,
    displace: Callable[[WhitenedResiduals, Array], Array],
    known: Array | None = None,
    by_tied: LawDeparture | None = None,
) -> LawDeparture | None:
    """Find a departure by one linear step from a tied or a free fit, without what is expected of it before.

    displace(problem, rows): derivative of the whitened residuals (m,) by the parameter; `rows` (m, p) has those by the
    fitted parameters. known (m, k): derivatives by errors of the camera file, per standard error. by_tied: the same
    departure by the tied fit of the same positions, for a free fit. None where the parameters of the fit absorb the
    departure, however large, but for a thousandth of its displacements.
    """
    problem, residual, rows, cov = fit.linearised
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
    if not square > 1e-3**2 * float(by @ by):
        return None
    std = 1.0 / np.sqrt(square)
    by_camera = None  # shifts of the parameters; they change the weights with which a free fit averages both balls
    if known is not None:
        by_camera = np.zeros((len(fit.parameters), known.shape[1]))
        by_camera[problem.index] = -cov @ rows.T @ known

    def differentiate(by: Array, size: float) -> Array:
        """The change of the quantities per change `by` of the parameters, from so much of it."""
        step = np.zeros(len(fit.parameters))
        step[problem.index] = size * by
        at = (fit.parameters + sign * step for sign in (1, -1))
        more, less = (derive_values(fit, parameters, fit.pair.diameter, by_camera) for parameters in at)
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


def compare_losses(
    fit: CollisionFit, known: Array | None = None, by_tied: LawDeparture | None = None
) -> LawDeparture | None:
    """Find by how much the struck ball's deceleration in rolling exceeds that of the striker, m/s^2.

    The struck ball shows the loss of the fits after its slide, the striker also before the hit. If the two differ, the
    common loss shifts v0 and all that follows from it. The difference is typically a share of the loss,
    `rolling_loss_difference` of the settings. The loss is the root of its expected square: noise may make the fitted
    loss small, but not the true one. known, by_tied: as for `find_departure`.
    """

    def displace(problem: WhitenedResiduals, rows: Array) -> Array:
        by = rows[:, problem.names.index("decel")].copy()
        by[2 * len(fit.pair.struck) :] = 0.0  # the striker's positions and the priors
        return by

    found = find_departure(fit, displace, known, by_tied)
    if found is None:
        return None
    values, index = derive_quantities(fit), [QUANTITY_NAMES.index(name) for name in ("drag", "decel", "v1f")]
    drag, decel, speed = np.nan_to_num(values.value[index])
    slope = np.array([speed, 1.0, drag])
    variance = slope @ np.nan_to_num(values.cov[np.ix_(index, index)]) @ slope
    loss = float(np.hypot(drag * speed + decel, np.sqrt(max(variance, 0.0))))
    return replace(found, typical=fit.pair.settings.rolling_loss_difference * loss)


def find_slope_of_friction(
    fit: CollisionFit, known: Array | None = None, by_tied: LawDeparture | None = None, *, expected: float = 0.03
) -> LawDeparture | None:
    """Find k of mu(u) = mu (1 + k u), s/m, u the speed of slip. For a free fit, find only its effect on the quantities.

    A ball then slides more strongly at first, and rolls earlier. One collision hardly shows k, but the tracks cannot
    give mu, the friction at slow slip, without it. It typically changes the friction at the fastest slip by
    `friction_change` of the settings. None if the striker slides up to the contact.

    known, by_tied: as for `find_departure`. expected: probability before that friction changes. With constant friction
    the median error of mu_k is 3 % larger with 0.03, 8 % with 0.08, and 69 % with 0.5.
    """
    if fit.pair.striker_slides:
        return None
    free = np.asarray(tied_to_free(fit.parameters, fit.pair.spin), dtype=np.float64) if fit.is_tied else fit.parameters
    slides = {ball: float(np.exp(free[at + 4])) for ball, at in AFTER.items()}
    changes = {ball: free[at + 2 : at + 4] - free[at : at + 2] for ball, at in AFTER.items()}
    slips = {ball: SLIP_RATE * float(np.hypot(*changes[ball])) for ball in AFTER}  # at the contact, m/s

    def displace(problem: WhitenedResiduals, rows: Array) -> Array:
        """A ball is ahead, along the change of its velocity, by what it gained in its slide."""
        since = problem.start + fit.pair.struck.exposure / 2 - free[0]
        out = np.zeros((len(since), 2))
        for ball, tau in slides.items():
            slide = np.clip(since, 0.0, tau)
            gain = slips[ball] / tau * (slide**2 / 2 - slide**3 / (6 * tau))
            out += np.outer((problem.ball == ball) * gain, changes[ball])
        return np.append(problem.whiten(out[None])[0], np.zeros(len(rows) - 2 * len(fit.pair)))

    found = find_departure(fit, displace, known, by_tied)
    if found is None:
        return None
    effect = found.effect.copy()
    for ball, tau in slides.items():  # a slide by mu (1 + k u) ends at log(1 + k u) / (k u) of the time
        effect[QUANTITY_NAMES.index(f"tau{ball}")] -= tau * slips[ball] / 2
    typical = fit.pair.settings.friction_change / max(*slips.values(), 1e-30)
    return replace(found, effect=effect, typical=typical, expected=expected, is_shown=fit.is_tied)


def find_p_of_motion(free: CollisionFit, noise_dof: float) -> float:
    """Find the probability of so large a gain of chi^2 from other laws of motion, if those of the free fit are true.

    Chi^2 of all positions hardly shows a friction that falls with the speed, or a slope. The displacements that such
    laws cause are tested alone, by one linear step. NaN where the fit itself absorbs all of them. noise_dof: as in
    `compute_p_value`.
    """
    problem, residual, rows, _ = free.linearised
    since = problem.start + free.pair.struck.exposure / 2 - free.parameters[0]
    whitened = problem.whiten(_displace_by_other_laws(free.parameters, problem.ball, since)).T
    others = np.concatenate([whitened, np.zeros((len(residual) - len(whitened), whitened.shape[1]))])
    size = np.linalg.norm(others, axis=0)
    others = others[:, size > 0] / size[size > 0]
    known = np.linalg.qr(rows / np.maximum(np.linalg.norm(rows, axis=0), 1e-30))[0]
    left = others - known @ (known.T @ others)
    basis, values, _ = np.linalg.svd(left, full_matrices=False)
    basis = basis[:, values > 1e-3]  # of a displacement, that the parameters of the fit leave
    return compute_p_of_rise(float(((residual @ basis) ** 2).sum()), basis.shape[1], noise_dof)


def _displace_by_other_laws(free: Array, ball: Ints, since: Array) -> Array:
    """Displacements (8, n, 2) of balls in any unit, each by a law of motion that a free fit (22,) does not contain.

    In a slide the acceleration changes with time, at the same velocities at its ends. Before the contact and after a
    slide a constant acceleration acts along the way or across it. ball (n,): 1 or 2; since (n,): the contact, s.
    """

    def move(way: Array, size: Array) -> Array:
        return np.outer(size, way / max(float(np.hypot(*way)), 1e-30))

    def turn(displacement: Array) -> Array:
        return np.column_stack([-displacement[:, 1], displacement[:, 0]])

    out = []
    for number, at in AFTER.items():
        own, tau = ball == number, np.exp(free[at + 4])
        slide, roll = np.clip(since, 0.0, tau), np.maximum(since - tau, 0.0)
        out.append(move(free[at + 2 : at + 4] - free[at : at + 2], own * (slide**3 / (6 * tau) - slide**2 / 4)))
        along = move(free[at + 2 : at + 4], own * roll**2)
        out += [along, turn(along)]
    heading = free[FREE.index("heading")]
    before = move(np.array([np.cos(heading), np.sin(heading)]), (ball == 2) * np.minimum(since, 0.0) ** 2)
    return np.array([*out, before, turn(before)])
