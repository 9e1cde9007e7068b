"""Contacts that last: rubber, springs and tape need several frames to throw two balls back, or never do.

The fits leave out the frames in contact (`contact_frames`). The others follow motions that cross within one diameter
(`lasting_motion`), from which the duration and the restitution follow (`lasting_fit`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from synthcam_shared.arrays import Array
from tracker.measurement.collision.adequacy import TOO_FEW, compute_p_of_rise, compute_p_value, find_impossible_values
from tracker.measurement.collision.collision_model import FREE, TIED, compute_unit_vectors
from tracker.measurement.collision.contact_frames import (
    MAX_WINDOWS,
    MIN_FRAMES,
    STRAIGHT_CHI2,
    find_frames_in_contact,
    find_frames_within,
    guess_free_motions,
    guess_straight_motion,
    leave_out_frames,
)
from tracker.measurement.collision.contacts import ContactCandidate, EarlierHit, prepare_contact
from tracker.measurement.collision.derived import QUANTITY_NAMES, DerivedValues, derive_from_each_ball
from tracker.measurement.collision.lasting_fit import LastingFit, as_free_fit
from tracker.measurement.collision.lasting_motion import LastingResiduals
from tracker.measurement.collision.least_squares import ROUGH_TOLERANCE, BallPair, CollisionFit
from tracker.measurement.collision.noise_correlation import with_correlated_noise
from tracker.measurement.positions import BallTrack
from tracker.settings import FitSettings

MIN_SIGNIFICANCE = 4.0  # standard errors by which the lines cross at less than one diameter
_TAU = [FREE.index("log_tau1"), FREE.index("log_tau2")]


@dataclass(frozen=True)
class LastingContact:
    """A contact that lasts, measured from the frames outside it."""

    first: int  # frame that is left out
    last: int
    duration: float  # s, if the diameter is right
    duration_std: float
    is_certain: bool  # whether the frames in contact show a bend; if not, the diameter may be wrong instead


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
    window = find_frames_within(candidate, diameter)
    contact = prepare_contact(replace(candidate, frame=window[0]), diameter, earlier, settings)
    if contact.reason:
        return TOO_FEW
    pair, level = contact.pair, settings.rejection_level
    if window[0] == window[1] and _is_hopeless(pair, window[0], level):
        return None
    found = find_frames_in_contact(pair, window)
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
    correlated = with_correlated_noise(replace(outside, diameter=float(fit.x[-1])), as_free_fit(fit))
    return fit if correlated is None else LastingFit.to(replace(correlated, diameter=diameter), kind, [fit.x])


def _fit_impact(fit: LastingFit, pair: BallPair, level: float) -> LastingFits | None:
    """Fit straight lines, which may describe an impact whose slides no fit shows; None if they do not."""
    outside = fit.problem.pair
    straight = LastingFit.to(outside, "straight", [guess_straight_motion(fit, pair)])
    p = compute_p_value(straight.chi2, straight.dof, outside.striker.noise_dof)
    if p < 1e-3 or _momentum_p(straight) < level:
        return None
    return LastingFits(None, outside, straight, straight, (False, False), _may_hide_slide(straight))


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
    outside = leave_out_frames(pair, frame - MAX_WINDOWS, frame + MAX_WINDOWS)
    starts = guess_free_motions(pair, frame, frame)
    if outside is None or not starts:
        return False
    fit = LastingFit.to(outside, "free", starts, tolerance=ROUGH_TOLERANCE)
    dof = fit.dof + 2 * (len(pair) - len(outside))
    if not compute_p_value(fit.chi2, dof, pair.striker.noise_dof) < level:
        return False
    return with_correlated_noise(replace(outside, diameter=float(fit.x[-1])), as_free_fit(fit)) is None


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


def as_collision_fits(fits: LastingFits) -> tuple[CollisionFit, CollisionFit]:
    """Turn the fits of a lasting contact into a tied and a free fit; of straight lines the launch and r alone."""
    free, tied = as_free_fit(fits.free), fits.tied
    if tied.problem.kind == "tied":
        parameters, cov = tied.tied
    else:
        parameters, cov = np.zeros(len(TIED)), np.zeros((len(TIED), len(TIED)))
        parameters[:8], parameters[-2:], cov[:8, :8] = free.parameters[:8], free.parameters[-2:], free.cov[:8, :8]
        parameters[8], parameters[9] = tied.restitution(tied.x)[0], np.log(1e-9)
    pair = replace(fits.pair, diameter=float(tied.x[-1]))
    return CollisionFit(parameters, cov, tied.chi2, tied.dof, pair, 0, tied.converged), free
