"""Contacts that last: rubber, springs and tape need several frames to throw two balls back, or never do.

Outside the contact, the impulse acts as if it came at one instant, whatever the law of the force. Let the balls close
at speed v, and let the impulse have its mean time t after they touch at separation D. The paths before and after it
cross then, at the separation d = D - v t. The fits here leave out the frames in contact and let d be a parameter.

Two results follow from the fitted paths alone, without a law of the force. The duration is the time for which the
centres are nearer than D. The ratio of radial speeds compares how fast they leave and enter D. A force that springs
back gives back what a constant push costs, so that this ratio is the restitution. Plate friction, which acts from the
first touch on, is such a push. So is the centrifugal acceleration in an oblique hit, the other way. A force that loses
energy gives back a part of it; see `force_laws`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.measurement.collision.adequacy import TOO_FEW, compute_p_of_rise, compute_p_value, find_impossible_values
from tracker.measurement.collision.collision_model import (
    AFTER,
    FREE,
    GRAVITY,
    SLIP_RATE,
    TIED,
    compute_unit_vectors,
    mean_positions,
    tied_to_free,
)
from tracker.measurement.collision.contacts import ContactCandidate, EarlierHit, fit_velocity, prepare_contact
from tracker.measurement.collision.derived import (
    QUANTITY_NAMES,
    DerivedValues,
    derive_from_each_ball,
    derive_from_free,
    derive_from_tied,
    dot,
)
from tracker.measurement.collision.force_laws import solve_restitutions
from tracker.measurement.collision.least_squares import (
    BROAD_PRIORS,
    FINE_TOLERANCE,
    ROUGH_TOLERANCE,
    BallPair,
    CollisionFit,
    PairResiduals,
    covariance,
    find_best_minimum,
)
from tracker.measurement.collision.noise_correlation import with_correlated_noise
from tracker.measurement.positions import BallTrack, measure_separation
from tracker.settings import FitSettings

MIN_FRAMES = 4  # outside the contact, before and after it
MAX_WINDOWS = 12  # of frames in contact that are tried one after the other
MIN_SIGNIFICANCE = 4.0  # standard errors by which the lines cross at less than one diameter
STRAIGHT_CHI2 = 16.0  # rise of chi^2 up to which straight lines describe the balls after the hit
STRAIGHT = (*FREE[:8], "v1x", "v1y", "v2x", "v2y", *FREE[-2:])  # free motions without a slide
_TAU = [FREE.index("log_tau1"), FREE.index("log_tau2")]


class LastingResiduals(PairResiduals):
    """Residuals of two balls' positions outside a contact.

    The last two parameters are lengths: by how much the paths miss each other across the line of centres, and d. Those
    of a tied motion follow two numbers that the law of the force determines: by how much its slides are delayed (see
    `delay_of_slides`), and its impulse is turned (see `turn_of_impulse`). kind: "tied", "free", or "straight", a free
    motion that no friction slows down. friction: of a tied motion, if it is known within a quarter.
    """

    def __init__(self, pair: BallPair, kind: str, friction: float | None = None) -> None:
        held = pair.zero_parameters | ({"drag", "decel"} if kind == "straight" else set())
        super().__init__(pair, {"tied": TIED, "free": FREE, "straight": STRAIGHT}[kind], held)
        self.kind = kind
        given = {} if friction is None else {"log_mu": (float(np.log(friction)), 0.25)}
        priors = [given.get(name, BROAD_PRIORS.get(name, (0.0, np.inf))) for name in self.names]
        priors += [(0.0, 1.0)] * self.laws_of_force
        self.prior = np.array([*(centre for centre, _ in priors), 0.0, pair.diameter])
        self.prior_weight = np.array([*(1 / width for _, width in priors), 200 / pair.diameter, 1 / pair.diameter])

    @property
    def laws_of_force(self) -> int:
        """Number of parameters that the law of the force determines."""
        return 2 if self.kind == "tied" else 0

    def to_free(self, x: NDArray[np.inexact]) -> NDArray[np.inexact]:
        """The free parameters (..., 22) of x (..., p)."""
        whole = np.zeros((*x.shape[:-1], self.size), dtype=x.dtype)
        whole[..., self.index] = x[..., : len(self.index)]
        if self.kind == "free":
            return whole
        if self.kind == "tied":
            before = time_before_crossing(whole[..., 4], whole[..., 5], x[..., -1], self.pair.diameter)
            closing = whole[..., 5] * np.cos(whole[..., 4])
            depth = self.pair.diameter - x[..., -1]
            lasts, delay = delay_of_slides(closing, whole[..., 8], whole[..., 9], before, depth, x[..., -4])
            delay = np.where(delay.real < 0.5 * before.real, delay, 0.5 * before)
            turned = whole.copy()
            turned[..., 4] -= turn_of_impulse(whole[..., 4], whole[..., 5] * lasts / self.pair.diameter, x[..., -3])
            free = tied_to_free(turned, self.pair.spin)
            free[..., 4] = whole[..., 4]
            return advance_slides(free, before - delay)
        free = np.zeros((*x.shape[:-1], len(FREE)), dtype=x.dtype)
        free[..., :8], free[..., -2:] = whole[..., :8], whole[..., -2:]
        short_slide = np.log(1e-4)  # log s
        for ball, at in AFTER.items():
            velocity = whole[..., 6 + 2 * ball : 8 + 2 * ball]
            free[..., at : at + 2] = free[..., at + 2 : at + 4] = velocity
            free[..., at + 4] = short_slide
        return free

    def predict(self, x: Array, ball: Ints, start: Array) -> tuple[Array, Array]:
        """Positions (n, 2) of exposures and their derivatives (n, 2, p)."""
        free = np.asarray(self.to_free(x).real, dtype=np.float64)
        steps = x + 1e-30j * np.eye(len(x))
        by = np.asarray(self.to_free(steps).imag.T / 1e-30, dtype=np.float64)  # (22, p)
        position, slope = mean_positions(free, ball, start, self.pair.struck.exposure, float(x[-1]))
        slope = slope @ by
        _, n, t = compute_unit_vectors(free[3], free[4])
        slope[..., -1] -= (ball == 2)[:, None] * n
        across = np.where(start < free[0], 0.0, 1.5 - ball)[:, None] * t
        position += x[-2] * across
        slope[..., -2] += across
        return position, slope

    def displace(self, x: Array) -> tuple[Array, Array]:
        position, slope = self.predict(x, self.ball, self.start)
        return position, np.moveaxis(slope, -1, 0)


def time_before_crossing(
    beta: NDArray[np.inexact], v0: NDArray[np.inexact], distance: NDArray[np.inexact], diameter: float
) -> NDArray[np.inexact]:
    """Seconds from the first touch of a lasting contact to the crossing of the paths at a distance (m), angle beta."""
    reach = diameter**2 - (distance * np.sin(beta)) ** 2
    return np.asarray((np.sqrt(np.where(reach.real > 0, reach, 0.0)) - distance * np.cos(beta)) / v0)


def delay_of_slides(
    closing: NDArray[np.inexact],
    r: NDArray[np.inexact],
    log_mu: NDArray[np.inexact],
    before: NDArray[np.inexact],
    depth: NDArray[np.inexact],
    excess: NDArray[np.inexact],
) -> tuple[NDArray[np.inexact], NDArray[np.inexact]]:
    """Seconds that a contact lasts, and by which it delays slides: balls roll until the push exceeds 7/2 mu g.

    - closing, m/s; r of the whole impulse; before: s from the touch to t_c.
    - depth: of the crossing of the paths, m within one diameter.
    - excess over the mean of five laws of the force, in their standard deviations.

    Until then friction is 2/7 of the push, so that half of this time counts. That is 7/2 mu g T^2/(pi^2 J) for a push
    like a half sine. A push as of Hertz rises later. A dashpot pushes from the touch on, the more the lower the speed
    is at which the balls part. Let this be k times that of closing. The shares of half a sine that five laws integrate
    to are k^3 +- .6 k^1.5, for contacts of 1 to 30 ms with r from .2 to .95.
    """
    braking = 2 * np.exp(log_mu) * GRAVITY  # of both balls
    crossing = r * closing - braking * before
    slowest = 0.05 * closing
    crossing = np.where(crossing.real > slowest.real, crossing, slowest)
    square = crossing**2 - 2 * braking * depth
    parting = np.sqrt(np.where(square.real > slowest.real**2, square, slowest**2))
    lasts = before + 2 * depth / (crossing + parting)
    half_sine = SLIP_RATE * braking / 2 * lasts**2 / (np.pi**2 * (1 + r) / 2 * closing)
    root = (parting / closing) ** 1.5
    return np.asarray(lasts), np.asarray((root**2 + 0.6 * root * excess) * half_sine)


def turn_of_impulse(
    beta: NDArray[np.inexact], way: NDArray[np.inexact], excess: NDArray[np.inexact]
) -> NDArray[np.inexact]:
    """Angle between the impulse and the line of centres at the crossing of the paths, in the sense in which it turns.

    way: of the free balls against each other in the time of the contact, in diameters; excess as for `delay_of_slides`.
    Balls are further apart late in the contact, where the line turns slower. Five laws of the force
    integrate to .8 +- .8 % of its turn.
    """
    return np.asarray(0.008 * (1 + excess) * np.sin(beta) * way)


def advance_slides(free: NDArray[np.inexact], delay: NDArray[np.inexact]) -> NDArray[np.inexact]:
    """Advance slides that a lasting contact delays: free parameters (..., 22) at t_c, from those at their start."""
    out = free.copy()
    for at in AFTER.values():
        v, f, past = free[..., at : at + 2], free[..., at + 2 : at + 4], delay / np.exp(free[..., at + 4])
        most = 0.7  # share of a slide from which on the rest gets ever smaller, so that some of it is left
        left = np.where(past.real < most, 1 - past, (1 - most) * np.exp((most - past) / (1 - most)))
        out[..., at : at + 2] = f + left[..., None] * (v - f)
        out[..., at + 4] = free[..., at + 4] + np.log(left)
    return out


def rewind_slides(free: Array, delay: Array) -> Array:
    """Rewind slides that a lasting contact delays: free parameters (..., 22) at their start, from those at t_c."""
    out = free.copy()
    for at in AFTER.values():
        v, f, tau = free[..., at : at + 2], free[..., at + 2 : at + 4], np.exp(free[..., at + 4])
        out[..., at : at + 2] = v + (delay / tau)[..., None] * (v - f)
        out[..., at + 4] = np.log(tau + delay)
    return out


def _part(free: Array, start: Array, time: Array) -> tuple[Array, Array]:
    """Separation (..., 2) and its rate, `time` (...) s after the paths cross at the separation `start` (..., 2)."""
    apart, speed = start, np.zeros_like(start)
    for sign, at in zip((1, -1), AFTER.values(), strict=True):
        v, f, tau = free[..., at : at + 2], free[..., at + 2 : at + 4], np.exp(free[..., at + 4])
        slid = np.minimum(time, tau)[..., None]
        bend = (f - v) / tau[..., None]
        apart = apart + sign * (v * slid + bend * slid**2 / 2 + f * (time[..., None] - slid))
        speed = speed + sign * (v + bend * slid)
    return apart, speed


@dataclass(frozen=True)
class LastingContact:
    """A contact that lasts, measured from the frames outside it."""

    first: int  # frame that is left out
    last: int
    duration: float  # s, if the diameter is right
    duration_std: float
    is_certain: bool  # whether the frames in contact show a bend; if not, the diameter may be wrong instead


@dataclass(frozen=True)
class LastingFit:
    """One motion fitted to the frames outside a contact."""

    problem: LastingResiduals
    x: Array  # (p,), as in `LastingResiduals`
    cov: Array  # (p, p)
    chi2: float
    dof: int
    converged: bool

    @staticmethod
    def to(
        pair: BallPair,
        kind: str,
        starts: list[Array],
        friction: float | None = None,
        tolerance: float = FINE_TOLERANCE,
    ) -> LastingFit:
        """Fit a motion from starts (p,); tolerance: as for `find_best_minimum`."""
        problem = LastingResiduals(pair, kind, friction)
        best, converged = find_best_minimum(problem, starts, tolerance)
        residual, rows = problem(best)
        n = 2 * len(pair)
        chi2 = float(residual[:n] @ residual[:n])
        return LastingFit(problem, best, covariance(rows), chi2, n - len(best) + problem.laws_of_force, converged)

    @property
    def diameter(self) -> float:
        """The balls' diameter, m."""
        return self.problem.pair.diameter

    @property
    def free(self) -> Array:
        """(22,) parameters."""
        return self.to_free(self.x)

    @property
    def tied(self) -> tuple[Array, Array]:
        """Parameters (16,) of a tied motion, and their covariance."""
        n = len(self.problem.index)
        return self.problem.whole(self.x[:n]), self.problem.whole_cov(self.cov[:n, :n])

    def to_free(self, x: Array) -> Array:
        """The free parameters (..., 22) of x (..., p)."""
        return np.asarray(self.problem.to_free(x), dtype=np.float64)

    def slopes(self, function) -> Array:  # type: ignore[no-untyped-def]
        """Derivatives (m, p) of a function of x (..., p)."""
        size = 0.01 * np.sqrt(np.diag(self.cov))
        moved = function(self.x + np.diag(size)) - function(self.x - np.diag(size))
        return np.asarray((moved / (2 * size[:, None])).T, dtype=np.float64)

    def times(self, x: Array) -> Array:
        """(..., 2) of x (..., p): seconds from the first touch to t_c, and from t_c to the end."""
        return np.stack(self._passage(x)[:2], -1)

    def _passage(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Return times from the first touch to t_c and on to the end, s, and radial speeds at both; x: (..., p)."""
        free = self.to_free(x)
        d, n, t = (np.asarray(a, dtype=np.float64) for a in compute_unit_vectors(free[..., 3], free[..., 4]))
        v0, distance = free[..., 5], x[..., -1]
        before = np.asarray(time_before_crossing(free[..., 4], v0, distance, self.diameter), dtype=np.float64)
        coming = n * distance[..., None] + d * (v0 * before)[..., None]
        closing = v0 * dot(d, coming) / self.diameter
        start, least = n * distance[..., None] + t * x[..., -2, None], 0.02 * closing
        parting = dot(free[..., 8:10] - free[..., 13:15], n)
        after = (self.diameter - distance) / np.maximum(parting, least)
        longest = np.abs(self.diameter - distance) / least
        for _ in range(4):  # Newton's steps to the time at which they are a diameter apart
            apart, speed = _part(free, start, after)
            size = np.hypot(apart[..., 0], apart[..., 1])
            slope = np.maximum(dot(apart, speed) / size, least)
            after = np.clip(after - (size - self.diameter) / slope, -longest, longest)
        apart, speed = _part(free, start, after)
        return before, after, closing, dot(apart, speed) / np.hypot(apart[..., 0], apart[..., 1])

    def at_touch(self, x: Array) -> Array:
        """The free parameters (..., 22) of x (..., p), the slides beginning at the first touch."""
        free = self.to_free(x)
        return free if self.problem.kind == "straight" else rewind_slides(free, self.times(x)[..., 0])

    def restitution(self, x: Array) -> Array:
        """(..., 2): the restitution, as the mean by five laws of the force, and their standard deviation."""
        free = self.to_free(x)
        before, after, closing, parting = self._passage(x)
        n = np.asarray(compute_unit_vectors(free[..., 3], free[..., 4])[1], dtype=np.float64)
        at_crossing = dot(free[..., 8:10] - free[..., 13:15], n)
        late = free if self.problem.kind == "straight" else rewind_slides(free, -after)
        lost = (at_crossing - dot(late[..., 8:10] - late[..., 13:15], n)) / closing
        offset = np.clip(x[..., -1] * np.sin(free[..., 4]) / self.diameter, -0.95, 0.95)
        lasts = np.maximum(before + after, 0.0)
        pressed = lost * lasts / np.maximum(after, 1e-3 * lasts + 1e-9)
        every = (parting / closing, pressed, offset / np.sqrt(1 - offset**2), closing * lasts / self.diameter)
        r = solve_restitutions(*(np.ravel(each) for each in every)).reshape(*np.shape(lasts), 5)
        return np.stack([r.mean(axis=-1), r.std(axis=-1)], -1)

    @cached_property
    def values(self) -> DerivedValues:
        """The quantities that it determines."""
        if self.problem.kind == "tied":
            found = derive_from_tied(*self.tied, self.diameter, self.problem.pair.spin)
        else:
            slope = self.slopes(self.at_touch)
            with np.errstate(invalid="ignore", divide="ignore"):  # without a slide there is no friction
                found = derive_from_free(self.at_touch(self.x), slope @ self.cov @ slope.T, self.diameter)
        return self._with_restitution(found)

    def _with_restitution(self, found: DerivedValues) -> DerivedValues:
        """The quantities with r, its error by the law of the force, and with b in diameters."""
        value, cov = found.value.copy(), found.cov.copy()
        b, r = QUANTITY_NAMES.index("b"), QUANTITY_NAMES.index("r")
        distance = float(self.x[-1]) / self.diameter
        value[b], cov[b], cov[:, b] = value[b] * distance, cov[b] * distance, cov[:, b] * distance
        cov[b, b] += (value[b] * float(np.sqrt(self.cov[-1, -1])) / self.diameter) ** 2
        size = 0.01 * np.sqrt(np.diag(self.cov))
        moves = np.concatenate([0 * size[None], np.diag(size), -np.diag(size)])  # at once: the integration is slow
        found_r = self.restitution(self.x + moves)
        high, low = np.split(found_r[1:, 0], 2)
        by = (high - low) / (2 * size)
        value[r], error = found_r[0]
        cov[r, r] = float(by @ self.cov @ by) + error**2
        if self.problem.kind == "tied":  # laws that push late delay slides more, and keep more of the speed
            cov[r, r] += 2 * error * abs(by @ self.cov[:, -4])
        return replace(found, value=value, cov=cov)

    def predict_left_out(self, rows: BallTrack, ball: int) -> tuple[Array, Array]:
        """Positions (n, 2) that were left out, less those of an instantaneous contact, and derivatives (n, 2, p)."""
        position, slope = self.problem.predict(self.x, np.full(len(rows), ball), rows.start)
        return rows.position - position, slope


@dataclass(frozen=True)
class LastingFits:
    """The fits of one contact."""

    contact: LastingContact | None  # None if it is as good as instantaneous, and the balls move straight after it
    pair: BallPair  # without the frames in contact
    tied: LastingFit
    free: LastingFit  # straight lines, and `tied` the same, where no friction slows the balls
    slide_ends_seen: tuple[bool, bool]
    hides_slide: bool  # whether the balls may have slid while they were in contact, or hardly longer
    is_balanced: bool = True  # whether straight lines keep the momentum of equal balls


def fit_lasting_contact(
    candidate: ContactCandidate,
    diameter: float,
    earlier: Mapping[int, EarlierHit],
    settings: FitSettings,
    least_sigma: float = MIN_SIGNIFICANCE,
) -> LastingFits | str | None:
    """Fit a contact that lasts by the frames outside it, or an instantaneous one of balls that move straight after it.

    diameter in m, earlier as for `prepare_contact`. The contact lasts if the paths cross within one diameter by
    `least_sigma` standard errors. None if it does not and the balls slide after it, or if it is no collision. A reason
    if too few frames remain.
    """
    min_duration_frames = 0.25  # a shorter contact is as good as instantaneous
    window = _frames_within(candidate, diameter)
    contact = prepare_contact(replace(candidate, frame=window[0]), diameter, earlier, settings)
    if contact.reason:
        return TOO_FEW
    pair, level = contact.pair, settings.rejection_level
    if window[0] == window[1] and _is_hopeless(pair, window[0], level):
        return None
    found = _find_frames_in_contact(pair, window)
    if found is None or isinstance(found, str):
        return found
    rough, window = found
    fit = _refine(rough, diameter)
    outside, is_straight = fit.problem.pair, fit.problem.kind == "straight"
    noise_dof, step = outside.striker.noise_dof, float(np.median(np.diff(pair.striker.start)))
    if compute_p_value(fit.chi2, fit.dof, noise_dof) < level:
        return None
    tied = fit if is_straight else _fit_tied(fit)
    best = fit
    if not is_straight and not compute_p_of_rise(tied.chi2 - fit.chi2, tied.dof - fit.dof, noise_dof) < level:
        best = max(fit, tied, key=_sigmas_within)
    lasting = None
    if _sigmas_within(best) > least_sigma and fit.times(fit.x).sum() > min_duration_frames * step:
        lasting = _measure_duration(best, pair, window)
    elif not is_straight or abs(_sigmas_within(best)) > least_sigma:
        return None if is_straight or shows_friction(tied.values, settings) else _fit_impact(fit, pair, level)
    if is_straight:
        balanced = not _momentum_p(fit) < level
        if lasting is None and not balanced:
            return None
        return LastingFits(lasting, outside, fit, fit, (False, False), _may_hide_slide(fit), balanced)
    left = float(np.exp(fit.free[_TAU]).min()) - fit.times(fit.x)[1]  # of the slides once the balls have parted, s
    hides = left < MIN_FRAMES * step or (not shows_friction(tied.values, settings) and _may_hide_slide(tied))
    one, two = (_is_slide_end_seen(fit, ball, track) for ball, track in outside.balls)
    return LastingFits(lasting, outside, tied, fit, (one, two), hides)


def _refine(rough: LastingFit, diameter: float) -> LastingFit:
    """Fit in full what was fitted roughly, with the correlated noise that the tracks show."""
    outside, kind = rough.problem.pair, rough.problem.kind
    fit = LastingFit.to(outside, kind, [rough.x])
    correlated = with_correlated_noise(replace(outside, diameter=float(fit.x[-1])), _as_free(fit))
    return fit if correlated is None else LastingFit.to(replace(correlated, diameter=diameter), kind, [fit.x])


def _fit_impact(fit: LastingFit, pair: BallPair, level: float) -> LastingFits | None:
    """Fit straight lines, which may describe an impact whose slides no fit shows; None if they do not."""
    outside = fit.problem.pair
    straight = LastingFit.to(outside, "straight", [_straighten(fit, pair)])
    p = compute_p_value(straight.chi2, straight.dof, outside.striker.noise_dof)
    if p < 1e-3 or _momentum_p(straight) < level:
        return None
    return LastingFits(None, outside, straight, straight, (False, False), _may_hide_slide(straight))


def _find_frames_in_contact(pair: BallPair, window: tuple[int, int]) -> tuple[LastingFit, tuple[int, int]] | str | None:
    """Leave out more frames until the others fit: a rough fit, and the first and last frame that are left out."""
    fit = None
    for _ in range(MAX_WINDOWS):
        outside = _leave_out(pair, *window)
        if outside is None:
            return TOO_FEW
        fit = _fit_outside(outside, window, fit)
        if fit is None:
            return None
        wider = _widen(fit, pair, window)
        if wider == window:
            break
        window = wider
    assert fit is not None
    return fit, window


def _measure_duration(best: LastingFit, pair: BallPair, window: tuple[int, int]) -> LastingContact:
    """The duration of a contact by its best fit, and whether the frames left out show that the paths bend there."""
    before, after = best.times(best.x)
    both = best.slopes(best.times).sum(axis=0)
    own = float(both @ best.cov @ both) * max(1.0, best.chi2 / best.dof)
    duration_std = float(np.sqrt(own))
    is_certain = _bend(best, pair, window) > 3.5  # standard errors
    return LastingContact(*window, float(before + after), duration_std, is_certain)


def _is_hopeless(pair: BallPair, frame: int, level: float) -> bool:
    """Decide whether the data reject the free motion in whatever frames a contact at this frame may last.

    That is so if they reject it without the frames that could at most be left out: fewer positions never raise chi^2.
    """
    outside = _leave_out(pair, frame - MAX_WINDOWS, frame + MAX_WINDOWS)
    starts = _guess(pair, frame, frame)
    if outside is None or not starts:
        return False
    fit = LastingFit.to(outside, "free", starts, tolerance=ROUGH_TOLERANCE)
    dof = fit.dof + 2 * (len(pair) - len(outside))
    if not compute_p_value(fit.chi2, dof, pair.striker.noise_dof) < level:
        return False
    return with_correlated_noise(replace(outside, diameter=float(fit.x[-1])), _as_free(fit)) is None


def _momentum_p(straight: LastingFit) -> float:
    """p-value of the momentum that equal balls gain in a hit, which is none."""

    def gain(x: Array) -> Array:
        free = straight.to_free(x)
        launch, _, _ = compute_unit_vectors(free[..., 3], free[..., 4])
        after = free[..., 8:10] + free[..., 13:15]
        return np.asarray(after - 2 * free[..., -2:] - free[..., 5, None] * np.real(launch), dtype=np.float64)

    slope, change = straight.slopes(gain), gain(straight.x)
    cov = slope @ straight.cov @ slope.T
    return compute_p_value(float(change @ np.linalg.solve(cov, change)), 2.0, straight.problem.pair.striker.noise_dof)


def _sigmas_within(fit: LastingFit) -> float:
    """Standard errors by which the paths cross within one diameter."""
    std = float(np.sqrt(fit.cov[-1, -1] * max(1.0, fit.chi2 / fit.dof)))
    return float(fit.diameter - fit.x[-1]) / std


def _fit_outside(pair: BallPair, window: tuple[int, int], last: LastingFit | None) -> LastingFit | None:
    """A rough free fit, of straight lines where the balls do not slide visibly. None if there is no collision."""
    kind = "free" if last is None else last.problem.kind
    starts = [last.x] if last is not None else _guess(pair, *window)
    if not starts:
        return None
    free = LastingFit.to(pair, "free", starts, tolerance=ROUGH_TOLERANCE) if kind == "free" else None
    dof, level = pair.striker.noise_dof, 1e-3
    if free is not None and compute_p_value(_chi2_of_lines(pair, *window), 2 * len(pair), dof) < level:
        return free
    start = _straighten(free, pair) if free is not None else starts[0]
    straight = LastingFit.to(pair, "straight", [start], tolerance=ROUGH_TOLERANCE)
    if free is None:
        free = LastingFit.to(pair, "free", _guess(pair, *window), tolerance=ROUGH_TOLERANCE)
    if compute_p_value(straight.chi2, straight.dof, dof) < level:
        return free
    return straight if straight.chi2 < free.chi2 + STRAIGHT_CHI2 else free


def _chi2_of_lines(pair: BallPair, first: int, last: int) -> float:
    """A lower bound on chi^2 of straight motions: each ball by itself, before and after the frames in contact."""
    square = 0.0
    for _, track in pair.balls:
        for rows in (track.frame < first, track.frame > last):
            part = track.where(rows)
            if len(part) < 3:
                continue
            columns = np.zeros((5, len(part), 2))
            columns[0, :, 0] = columns[1, :, 1] = 1.0
            columns[2, :, 0] = columns[3, :, 1] = part.time - part.time.mean()
            columns[4] = part.position - part.position.mean(axis=0)
            r = np.linalg.qr(part.whiten(columns).T, mode="r")
            square += float(np.diag(r)[-1] ** 2)
    return square


def count_contact_frames(candidate: ContactCandidate, diameter: float) -> int:
    """Count the frames of a contact that lasts: balls are nearer than a diameter (m) by more than their noise."""
    one, two = candidate.one, candidate.other
    frames, apart, first, second = measure_separation(one, two)
    noise = np.sqrt(np.trace(one.cov[first] + two.cov[second], axis1=1, axis2=2) / 2)
    return int(((apart < diameter - 3 * noise) & (np.abs(frames - candidate.frame) < 100)).sum())


def _frames_within(candidate: ContactCandidate, diameter: float) -> tuple[int, int]:
    """First and last frame about a contact in which the balls are within a diameter; the frame itself if none."""
    frames, apart, _, _ = measure_separation(candidate.one, candidate.other)
    at, outside = int(np.argmin(np.abs(frames - candidate.frame))), np.flatnonzero(apart >= diameter)
    begin = int(outside[outside < at].max(initial=-1)) + 1
    end = int(outside[outside > at].min(initial=len(frames))) - 1
    return int(frames[min(begin, at)]), int(frames[max(end, at)])


def _leave_out(pair: BallPair, first: int, last: int) -> BallPair | None:
    """The pair without some frames; None if it is then not seen for long enough before and after."""
    struck, striker = (track.where((track.frame < first) | (track.frame > last)) for _, track in pair.balls)
    for track in (struck, striker):
        few = 1 if track is struck and not pair.target_moves else MIN_FRAMES
        if (track.frame < first).sum() < few or (track.frame > last).sum() < MIN_FRAMES + 1:
            return None
    return replace(pair, struck=struck, striker=striker)


def _guess(pair: BallPair, first: int, last: int) -> list[Array]:
    """Starts (p,) of a free fit: straight lines before and after, and several slide times."""
    near, fitted = 8, LastingResiduals(pair, "free").index

    def line(track: BallTrack, rows: Flags) -> tuple[Array, Array]:
        part = track.where(rows)
        velocity, middle, _ = fit_velocity(part)
        return velocity, middle - velocity * part.time.mean()

    (v1, x1), (v2, x2) = (line(t, (t.frame < first) & (t.frame >= first - near)) for _, t in pair.balls)
    if not pair.target_moves:
        rest = pair.struck.where(pair.struck.frame < first)
        v1, x1 = np.zeros(2), rest.position.mean(axis=0)
    (w1, y1), (w2, y2) = (line(t, (t.frame > last) & (t.frame <= last + near)) for _, t in pair.balls)
    jump, gap = (w1 - w2) - (v1 - v2), (y1 - y2) - (x1 - x2)
    launch = v2 - v1
    if not (jump @ jump > 0 and launch @ launch > 0):
        return []
    t_c = -float(jump @ gap) / float(jump @ jump)
    apart = (x1 - x2) + (v1 - v2) * t_c
    heading = float(np.arctan2(launch[1], launch[0]))
    beta = float(np.angle(np.exp(1j * (heading - np.arctan2(apart[1], apart[0])))))
    if abs(beta) > 1.5:
        return []
    ends = [fit_velocity(t.where(t.frame > max(last, t.frame[-1] - 3 * near)))[0] for _, t in pair.balls]
    base = [t_c, *(x1 + v1 * t_c), heading, beta, float(np.hypot(*launch)), 0.0, 0.0]
    slides = np.log([0.05, 0.015, 0.15])
    starts = (np.array([*base, *w1, *ends[0], log, *w2, *ends[1], log, 0, 0, *v1]) for log in slides)
    return [np.append(free[fitted], [0.0, np.hypot(*apart)]) for free in starts]


def _widen(fit: LastingFit, pair: BallPair, window: tuple[int, int]) -> tuple[int, int]:
    """Frames in contact by a fit, no fewer than before; one more on a side if the frames beside them do not fit."""
    before, after = fit.times(fit.x)
    step = float(np.median(np.diff(pair.striker.start)))
    margin = 0.5 * step + 0.05 * max(before + after, 0.0)
    begin, end = fit.x[0] - before - margin, fit.x[0] + after + margin
    first, last = window
    for _, track in pair.balls:
        inside = track.frame[(track.start + track.exposure > begin) & (track.start < end)]
        if len(inside) and abs(end - begin) < 200 * step:
            first, last = min(first, int(inside[0])), max(last, int(inside[-1]))
    if (first, last) != window:
        return first, last
    for side in (-1, 1):
        square = 0.0
        for ball, track in fit.problem.pair.balls:
            ahead = first - track.frame if side < 0 else track.frame - last
            beside = track.where((ahead > 0) & (ahead <= 2))
            if len(beside):
                off, _ = fit.predict_left_out(beside, ball)
                square += float(beside.whiten.distance(off).sum())
        if chdtrc(8, square) < 1e-3:
            first, last = (first - 1, last) if side < 0 else (first, last + 1)
    return first, last


def _bend(fit: LastingFit, pair: BallPair, window: tuple[int, int]) -> float:
    """Standard errors by which the paths bend in the frames left out, as by a constant force, instead of breaking."""
    before, after = fit.times(fit.x)
    _, normal, _ = compute_unit_vectors(fit.x[3], fit.x[4])
    parts = []
    for ball, track in pair.balls:
        rows = track.where((track.frame >= window[0]) & (track.frame <= window[1]))
        since = rows.time - fit.x[0]
        shape = np.clip(1 - np.where(since < 0, -since / before, since / after), 0, 1) ** 2
        off, slope = fit.predict_left_out(rows, ball)
        parts.append((rows.cov, off, slope, (1.5 - ball) * shape[:, None] * normal))
    own, off, slope, shape = (np.concatenate(part) for part in zip(*parts, strict=True))
    if not shape.any():
        return 0.0
    slope = slope.reshape(-1, len(fit.x))
    cov = slope @ fit.cov @ slope.T
    for k, block in enumerate(own):
        cov[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += block
    weight = np.linalg.solve(cov, shape.ravel())
    return float(weight @ off.ravel() / np.sqrt(weight @ shape.ravel()))


def _is_slide_end_seen(free: LastingFit, ball: int, track: BallTrack) -> bool:
    """Decide whether a ball stops to slide in view, after the contact."""
    k = free.problem.names.index(f"log_tau{ball}")
    return bool(np.exp(free.x[k]) < 0.9 * (track.start[-1] - free.x[0]) and free.cov[k, k] < 0.2**2)


def _straighten(free: LastingFit, pair: BallPair) -> Array:
    """Start (p,) of the straight motion: mean velocities over the first half of the positions after the contact."""
    problem = LastingResiduals(pair, "straight")
    whole = np.concatenate([free.free[:8], np.zeros(4), free.free[-2:]])
    for ball, track in pair.balls:
        late = track.where(track.start > free.x[0])
        whole[6 + 2 * ball : 8 + 2 * ball] = fit_velocity(late)[0]
    return np.append(whole[problem.index], free.x[-2:])


def shows_friction(tied: DerivedValues, settings: FitSettings) -> bool:
    """Test whether a tied fit of a contact determines the friction on the plate."""
    mu = QUANTITY_NAMES.index("mu_k")
    return bool(tied.std[mu] < settings.max_relative_error * tied.value[mu])


def _may_hide_slide(straight: LastingFit) -> bool:
    """Decide whether balls that seem to move straight after the contact may have slid, for hardly longer than it.

    Balls that begin to roll at once part at (5 r - 2)/7 of their closing speed. The contact hides a slide if the tied
    fit, with a friction that plates have, describes the tracks with another restitution that is possible.
    """
    pair, n = straight.problem.pair, QUANTITY_NAMES.index("r")
    index, r = LastingResiduals(pair, "tied").index, float(straight.restitution(straight.x)[0])
    frictions = (0.07, 0.12, 0.2, 0.3, *((0.45, 0.7, 1.0) if r < 3 / 7 else ()))
    for mu in frictions:
        starts = []
        for guess in (min(1.0, (7 * r + 2) / 5), min(1.0, r + 0.1)):
            whole = np.array([*straight.free[:8], guess, np.log(mu), 0.1, 0.0, 0.0, 0.0, *straight.free[-2:]])
            starts.append(np.concatenate([whole[index], np.zeros(2), straight.x[-2:]]))
        rolling = LastingFit.to(pair, "tied", starts, mu)
        if rolling.chi2 > straight.chi2 + 2 * STRAIGHT_CHI2:
            continue
        values = rolling.values
        found = values.value[QUANTITY_NAMES.index("mu_k")]
        if not 0.9 * frictions[0] < found < 1.1 * frictions[-1]:
            continue
        if abs(values.value[n] - r) > 0.01 and not find_impossible_values(values, 1.0, 3.0):
            return True
    return False


def _fit_tied(free: LastingFit) -> LastingFit:
    """Fit the tied motion beside a free one; from further frictions, if it describes the positions much worse."""
    pair, doubtful_p = free.problem.pair, 0.01
    tied = LastingFit.to(pair, "tied", _tied_starts(free))
    if not compute_p_of_rise(tied.chi2 - free.chi2, tied.dof - free.dof, pair.striker.noise_dof) < doubtful_p:
        return tied
    others = (start for factor in (0.7, 1.4) for start in _tied_starts(free, factor))
    return LastingFit.to(pair, "tied", [tied.x, *others])


def _tied_starts(free: LastingFit, factor: float = 1.0) -> list[Array]:
    """Starts (p,) of the tied fit, from what a free fit implies; factor: of its friction."""
    index = LastingResiduals(free.problem.pair, "tied").index
    at_touch = free.at_touch(free.x)
    with np.errstate(invalid="ignore", divide="ignore"):
        impulse = float(derive_from_each_ball(at_touch, free.diameter)[QUANTITY_NAMES.index("r")])
    mu = float(free.values.value[QUANTITY_NAMES.index("mu_k")])
    impact = np.clip(impulse, 0.05, 1.5), np.log(np.clip(factor * np.nan_to_num(mu), 1e-3, 1.0))
    whole = (np.array([*free.free[:8], *impact, c, 0.0, 0.0, 0.0, *free.free[-2:]]) for c in (0.1, 0.35))
    return [np.concatenate([one[index], np.zeros(2), free.x[-2:]]) for one in whole]


def _as_free(fit: LastingFit) -> CollisionFit:
    """A free fit as those of instantaneous contacts at the distance where the paths cross."""
    slope = fit.slopes(fit.to_free)
    pair = replace(fit.problem.pair, diameter=float(fit.x[-1]))
    return CollisionFit(fit.free, slope @ fit.cov @ slope.T, fit.chi2, fit.dof, pair, 0, fit.converged)


def as_collision_fits(fits: LastingFits) -> tuple[CollisionFit, CollisionFit]:
    """Turn the fits of a lasting contact into a tied and a free fit; of straight lines the launch and r alone."""
    free, tied = _as_free(fits.free), fits.tied
    if tied.problem.kind == "tied":
        parameters, cov = tied.tied
    else:
        parameters, cov = np.zeros(len(TIED)), np.zeros((len(TIED), len(TIED)))
        parameters[:8], parameters[-2:], cov[:8, :8] = free.parameters[:8], free.parameters[-2:], free.cov[:8, :8]
        parameters[8], parameters[9] = tied.restitution(tied.x)[0], np.log(1e-9)
    pair = replace(fits.pair, diameter=float(tied.x[-1]))
    return CollisionFit(parameters, cov, tied.chi2, tied.dof, pair, 0, tied.converged), free
