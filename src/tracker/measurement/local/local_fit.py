"""The local fit: stretches of free motion that meet at a contact, without any law of the impact.

It starts from fits of single stretches and chooses the motions that describe the positions. It averages over durations
of slides that the positions do not show. Fits are `FitInSteps`: they yield the descents that they need.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp, ndtr

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.measurement.collision.collision_model import GRAVITY
from tracker.measurement.local.descents import Descent, FitInSteps
from tracker.measurement.local.lasting_errors import measure_variances
from tracker.measurement.local.local_problem import KnownEnd, LocalPriors, LocalProblem, LocalSolution
from tracker.measurement.local.stretches import (
    REST,
    ROLL,
    SLIDE,
    SLIDE_AND_ROLL,
    SLIDE_AND_STOP,
    MotionKind,
    Overrun,
    Stretch,
    average_cube_of_roll,
    average_curve,
)

BEFORE = ((ROLL, SLIDE_AND_ROLL, SLIDE),) * 2  # motions of ball 1 and ball 2, which strikes, before the contact
BEFORE_OF_CROWD = (ROLL,), (ROLL, SLIDE_AND_ROLL, SLIDE)  # the slower ball slides only after a contact that is seen
LEAST_WEIGHT = 0.01  # of those, over the weight of the best
MAX_COST = 16.0  # beyond that of the best duration of a slide
MAX_RESIDUAL_CLAIMED = 2.0  # rms of the residuals of a window, over claimed errors
MAX_RESIDUAL_SCATTER = 3.0  # over errors by the scatter from frame to frame
MAX_EVIDENCE_LOST = 7.0  # logarithm of evidence under the best, with which motions still count
MAX_OPEN_ERROR = 1.0  # of the logarithm of a duration above the stretch that a slip shows
OPEN_SIGMAS = 1.5  # with which the prior of all durations above the stretch is nearly even
ROUGH_GAIN = 0.01  # of the cost, with which a descent ends whose solution is solved again


@dataclass(frozen=True)
class StretchFit:
    """A fit of one stretch alone: its parameters, with the place at the contact."""

    values: Array
    chi2: float  # by the claimed errors, with those that last, of the positions that are not beside the contact
    dof: float  # degrees of freedom of chi2


@lru_cache(maxsize=64)  # the window of a stretch is chosen by fits that the fit of all stretches starts from
def fit_single_stretch(stretch: Stretch, contact: float, motion: MotionKind, fall: float) -> StretchFit:
    """Fit one stretch of a local fit alone, over a few durations of the slide, and again about the best of them.

    fall: how fast the loss of a roll is likely to fall with time, over the loss, 1/s.
    """
    span = float(np.abs(stretch.time - contact).max())
    shortest, longest, turns = span / 40, 1.5 * span, 4 if motion.ends else 1
    if motion.stops:  # at least one position shows the slide; a fast body stops long after, at a time that shows well
        shortest, longest = max(shortest, 1.5 * float(np.abs(stretch.time - contact).min())), 50 * span
        turns = 8
    taus, best = np.geomspace(shortest, longest, 12), 0
    for turn in range(turns):
        if turn:
            taus = np.geomspace(taus[max(best - 1, 0)], taus[min(best + 1, len(taus) - 1)], 7)
        costs, fits, left = _fit_each(stretch, contact, motion, taus, fall)
        # the first of the least costs: slides that outlast a stretch all cost the same, but for rounding
        best = int(np.argmax(costs <= costs.min() * (1 + 1e-9)))
    out, plain = np.zeros(motion.size), fits.shape[1] - 2 * motion.rolls
    out[: 2 * plain] = fits[best, :plain].ravel()
    if motion.stops:
        out[4:6] = -out[2:4] / taus[best]
    if motion.ends:
        out[6] = np.log(taus[best])
    if motion.rolls:
        out[-1] = 0.05
    out.flags.writeable = False  # later calls get it again
    counted = ~stretch.near
    chi2 = float((stretch.far.whiten(left[best][counted]) ** 2).sum()) if counted.any() else 0.0
    return StretchFit(out, chi2, max(2 * int(counted.sum()) - motion.size, 1))


def _fit_each(
    stretch: Stretch, contact: float, motion: MotionKind, taus: Array, fall: float
) -> tuple[Array, Array, Array]:
    """Fit a stretch with each duration (m,) of its slide: costs (m,), values (m, k, 2) and residuals (m, n, 2), m.

    The duration of a dry slide ends with its stop.
    """
    since = stretch.time - contact
    weight = 1 / stretch.std
    ahead = np.abs(since)
    whole = average_curve(ahead, stretch.reach)
    far = Overrun.of(ahead - taus[:, None], stretch.reach).late_curve if motion.ends else np.zeros((1, len(since)))
    curve = far if motion.ends and not stretch.after else whole - far
    columns = [np.ones_like(curve)]
    if motion.stops:
        _, late, late_curve = Overrun.of(since - taus[:, None], stretch.reach)
        columns = [np.ones_like(late), since - (whole - late_curve) / taus[:, None]]
    elif motion.moves:
        columns.append(np.broadcast_to(since, curve.shape))
    widths = [0.0] * len(columns)
    if motion.pushed and not motion.stops:
        columns.append(curve)
        widths.append(2.0)  # m/s^2
    if motion.rolls:
        columns.append(whole - curve if motion.pushed else whole + 0 * far)
        columns.append(average_cube_of_roll(motion, stretch.after, ahead, taus[:, None], stretch.reach) + 0 * far)
        widths += [0.1, 0.1 * fall]  # m/s^2, m/s^3
    basis = np.stack(columns, -1) * weight[:, None]
    square = np.swapaxes(basis, 1, 2) @ basis
    for k, width in enumerate(widths):
        if width > 0:
            square[:, k, k] += 1 / width**2 + 1e-9 * square[:, k, k]
    seen = stretch.position * weight[:, None]
    fits = np.linalg.solve(square, np.swapaxes(basis, 1, 2) @ seen)
    left = seen - basis @ fits
    known = sum((fits[:, k] ** 2).sum(axis=1) / width**2 for k, width in enumerate(widths) if width > 0)
    return np.asarray((left**2).sum(axis=(1, 2)) + known), np.asarray(fits), left / weight[:, None]


def choose_window(
    stretch: Stretch,
    contact: float,
    motions: Sequence[MotionKind],
    fall: float,
    max_residual: float = MAX_RESIDUAL_CLAIMED,
) -> Stretch:
    """Shorten a stretch to the longest window that the local fit describes within `max_residual` errors, rms.

    fall: how fast the loss of a roll is likely to fall with time, over the loss, 1/s.
    Any force that the motions lack raises the residuals of a window that shows it. The rule does not look at the error
    of the velocity, because the smallest of several uncertain errors is too small. If no window is so good, the
    errors are larger than claimed, as in encoded films. The best of the windows then shows how large they are.

    Errors by the scatter from frame to frame miss what lasts, and are smaller where the body rests. If the limit is
    too small for such errors, the rule chooses windows by chance: those with small residuals.
    """
    ahead, tried = np.abs(stretch.time - contact), list[tuple[Stretch, float]]()
    limit = max_residual**2
    for share in (1.0, 0.63, 0.4, 0.25, 0.16, 0.1):
        keep = ahead <= share * float(ahead.max(initial=0.0)) * 1.0001
        if int(keep.sum()) < min(5, len(stretch)):
            break
        window = stretch.where(keep)
        misfits = list[float]()
        for motion in motions:
            if 2 * len(window) > motion.size:
                fit = fit_single_stretch(window, contact, motion, fall)
                misfits.append(fit.chi2 / fit.dof)
                if misfits[-1] <= limit:
                    return window
        tried.append((window, min(misfits, default=np.inf)))
    best = min((misfit for _, misfit in tried), default=np.inf)
    return next((window for window, misfit in tried if misfit <= limit * best), stretch)


def guess_contact(stretches: Sequence[Stretch], contact: float) -> float:
    """Guess the contact for the local fit: where straight lines before and after it meet best in time."""
    top = bottom = 0.0
    for ball in (1, 2):
        lines = {s.after: fit_line(s, contact) for s in stretches if s.ball == ball}
        if len(lines) < 2:
            continue
        shift, turn = lines[True][0] - lines[False][0], lines[True][1] - lines[False][1]
        top, bottom = top - float(turn @ shift), bottom + float(turn @ turn)
    return contact + (top / bottom if bottom > 0 else 0.0)


def fit_line(stretch: Stretch, contact: float) -> tuple[Array, Array]:
    """Fit a straight line to the six positions next to a contact: the place there, and the velocity."""
    rows = slice(0, 6) if stretch.after else slice(-6, None)
    t, x = stretch.time[rows] - contact, stretch.position[rows]
    if len(t) < 2 or np.ptp(t) == 0:
        return x.mean(axis=0), np.zeros(2)
    v = (t - t.mean()) @ x / float(((t - t.mean()) ** 2).sum())
    return x.mean(axis=0) - v * t.mean(), v


def list_motions(
    stretches: Sequence[Stretch],
    rests: bool,
    support: str,
    before: Sequence[Sequence[MotionKind]] = BEFORE,
) -> Iterator[tuple[MotionKind, ...]]:
    """List the motions that the stretches of a local fit may have, all on the same support.

    support: "cloth", "air", or "sliding", a dry plate on which bodies slide until they rest.
    before: motions that ball 1 and ball 2 may have on cloth before the contact, the simplest first.
    """
    choices: list[tuple[MotionKind, ...]] = []
    for s in stretches:
        if s.ball == 1 and not s.after and rests:
            choices.append((REST,))
        elif support != "cloth":
            choices.append((SLIDE_AND_STOP if support == "sliding" else SLIDE,))
        elif s.after:
            choices.append((SLIDE_AND_ROLL,))
        else:
            choices.append(tuple(before[s.ball - 1]))
    yield from product(*choices)


def fit_motions(
    stretches: Sequence[Stretch],
    contact: float,
    rests: bool,
    supports: Sequence[str],
    priors: LocalPriors,
    before: Sequence[Sequence[MotionKind]] = BEFORE,
    *,
    known: bool = True,
    slides_seen: bool = False,
) -> FitInSteps[list[LocalSolution]]:
    """Fit the motions that the stretches may have, on each of the supports, until one describes the positions.

    The simplest motions come first; those that describe the positions are returned alone. A body that slides on cloth
    all along moves as on a dry plate, so both are tried. Motions on air are the most general. If none describes the
    positions, all are returned. The first has the smallest cost with its price.

    known: errors are claimed. Otherwise they come from the scatter, which a kink may have raised. Then a roll up to the
    contact does not suffice, and the motion that leaves least shows how large the errors are.
    slides_seen: earlier contacts show which bodies slide up to this one. Otherwise a roll suffices only if the
    positions exclude a slide.
    """
    found, no_slides = list[LocalSolution](), False
    for support in supports:
        if support == "air" and any(one.is_good for one in found):
            break
        no_slides = no_slides or (len(found) > 0 and _are_no_slides(stretches, found))
        if no_slides:
            continue
        for motions in list_motions(stretches, rests, support, before):
            problem = LocalProblem(tuple(stretches), motions, priors, support != "cloth")
            start = _start_from_single_fits(problem, contact)[None]
            [[first]] = yield [Descent([problem], start, [1.0] * len(stretches), least_gain=ROUGH_GAIN)]
            found.append((yield from _try_other_starts(first)))
            slid = any(motion.pushed for motion, s in zip(motions, stretches, strict=True) if not s.after)
            if found[-1].is_good and (known or slid) and _suffices(found[-1], before, slides_seen):
                break
    found = [one for one in found if one.is_good] or found
    noise = max(min(s.chi2 / s.dof for s in found), 1.0 if known else 1e-12)  # of positions, not of what is known
    return sorted(found, key=lambda s: (s.cost - s.cost_of_known) * (1 / noise - 1) + s.cost_with_price)


def _start_from_single_fits(problem: LocalProblem, contact: float) -> Array:
    """Start all parameters (n,) from fits of the single stretches, and from what is known of their slides."""
    priors, x = problem.priors, np.zeros(problem.size)
    x[0], x[5], x[6], x[7] = contact, np.log(priors.friction), priors.loss, priors.fall
    positions: dict[int, list[Array]] = {1: [], 2: []}
    for k, (s, motion) in enumerate(zip(problem.stretches, problem.motions, strict=True)):
        own = fit_single_stretch(s, contact, motion, priors.fall).values.copy()
        if problem.slides_first(k):
            own[2:4] += own[4:6] * min(float(np.exp(own[6])), problem.spans[k])
        if problem.rubs(k):
            own[4:6] = 0.0, np.arctan2(own[5], own[4])
        if priors.slips is not None and k in problem.slips:
            lasts = priors.slips.find_duration(s.ball, priors.friction)
            own[5], own[6] = np.arctan2(*-priors.slips.slips[s.ball - 1, ::-1]), np.log(lasts)
        if (end := problem.find_end(k)) is not None:
            own[:4] = fit_single_stretch(s, contact, ROLL, priors.fall).values[:4]
            own[5], own[6] = end.towards, np.log(max(end.rolls, 0.1 * problem.spans[k]))
        x[problem.start[k] : problem.start[k + 1]] = own
        positions[s.ball].append(own[:2])
    for ball, own_positions in positions.items():
        x[2 * ball - 1 : 2 * ball + 1] = np.mean(own_positions, axis=0)
    for k in range(len(problem.stretches)):
        x[problem.start[k] : problem.start[k] + 2] -= x[problem.place(k)]
    return x


def _suffices(solution: LocalSolution, before: Sequence[Sequence[MotionKind]], slides_seen: bool) -> bool:
    """Decide whether the rolls of a solution up to the contact describe the positions; slides and sole motions do.

    Among many positions of other stretches, a few that show a slide hardly raise the chi^2 of all. So those of each
    ball that rolls count alone: their chi^2 must be usual, and no slide may describe them better by `least_gain`.
    Claimed errors may be too large, so that any chi^2 seems usual. The gain is in units of the chi^2 that is left. A
    few positions hardly tell a slide from a roll. Both then count by their evidence, unless `slides_seen`.
    """
    least_gain = 6.0  # of chi^2; a slide has two parameters more than a roll
    problem = solution.problem
    for k, (stretch, rows) in enumerate(zip(problem.stretches, problem.list_rows(), strict=True)):
        if stretch.after or problem.motions[k] != ROLL or len(before[stretch.ball - 1]) == 1:
            continue
        counted = problem.counted[rows]
        left, free = (values[rows][counted] for values in (solution.residual, solution.freedom))
        dof = max(float(free.sum()), 1.0)
        roll, *slides = (
            fit_single_stretch(stretch, float(solution.x[0]), motion, problem.priors.fall)
            for motion in (ROLL, SLIDE, SLIDE_AND_ROLL)
        )
        best = min(slides, key=lambda one: one.chi2)
        usual = float((left**2).sum()) < dof + 3 * float(np.sqrt(2 * dof))
        if not usual or roll.chi2 - best.chi2 > least_gain * min(best.chi2 / best.dof, 1.0):
            return False
        if not slides_seen and not _excludes_slide(stretch, float(solution.x[0]), problem.priors):
            return False
    return True


def _excludes_slide(stretch: Stretch, contact: float, priors: LocalPriors) -> bool:
    """Decide whether a stretch shows, by three errors, that no friction of the plate pushes its body all along.

    The friction is the usual one, or less by at most two of its errors.
    """
    least = GRAVITY * priors.friction * float(np.exp(-2 * priors.friction_factor))
    since = stretch.time - contact
    columns = [stretch.whiten(np.column_stack([c, c])) for c in (np.ones_like(since), since, since**2 / 2)]
    _, root = np.linalg.qr(np.column_stack(columns))
    error = float(np.sqrt(2.0)) / max(abs(float(root[2, 2])), 1e-300)  # of one axis; both are in the columns
    return float(np.hypot(*fit_single_stretch(stretch, contact, SLIDE, priors.fall).values[4:6])) + 3 * error < least


def _are_no_slides(stretches: Sequence[Stretch], found: Sequence[LocalSolution]) -> bool:
    """Prove that slides to rest, or on air, count for nothing beside what is found, sooner than their fits would.

    If a solution is good, only other good ones count. Their chi^2 is less than n + 3 sqrt(2 n) with n coordinates,
    because they have fewer degrees of freedom. If none is good, the bound has to be far above the best cost with any
    price. It also has to be a hundred times chi^2 in one stretch, because errors are then taken as large as residuals.
    """
    bounds = {k: bound_chi2_of_slide(s) for k, s in enumerate(stretches) if s.after}
    sizes = [2 * int((~s.near).sum()) for s in stretches]
    n, least = sum(sizes), sum(bounds.values())
    if any(one.is_good for one in found):
        return least > n + 3 * float(np.sqrt(2 * n))
    best = min(found, key=lambda one: one.cost)
    squares = np.split((best.residual * best.problem.counted) ** 2, 2 * np.cumsum([len(s) for s in stretches])[:-1])
    far_off = any(bound > 100 * max(float(squares[k].sum()), sizes[k]) for k, bound in bounds.items())
    return far_off and least > 10 * (best.cost + n * float(np.log(max(n, 2))))


def bound_chi2_of_slide(stretch: Stretch) -> float:
    """A lower bound on chi^2 of a slide to rest, or on air, after a contact: of positions that are not beside it.

    The body stops either after the middle of these positions, or before it. If after, or never, those up to the middle
    lie on a parabola. Their whitened errors depend on no later positions. If before, those from the middle on are at
    rest, and all before may be anywhere. Both are linear problems, with all the freedom that the motion has or more.
    The smaller of their least chi^2 is therefore a bound.
    """
    n, first = len(stretch), int(stretch.near.sum())
    middle = (first + n) // 2
    if stretch.near[first:].any() or middle - first < 4:
        return 0.0
    span = max(float(np.ptp(stretch.time)), 1e-12)
    since = (stretch.time - stretch.time[-1]) / span
    curve = average_curve(since, None if stretch.reach is None else stretch.reach / span)
    white = stretch.whiten(np.eye(2 * n).reshape(2 * n, n, 2)).T  # the matrix that whitens
    seen = stretch.whiten(stretch.position - stretch.position[-1])
    parabola = np.kron(np.column_stack([np.ones(n), since, curve]), np.eye(2))
    rests = np.kron((np.arange(n) >= middle)[:, None], np.eye(2))
    least = np.inf
    for rows, path, anywhere in (
        (slice(2 * first, 2 * middle), parabola, 0),
        (slice(2 * first, None), rests, 2 * middle),
    ):
        basis = np.linalg.qr(np.column_stack([white[rows, :anywhere], white[rows] @ path]))[0]
        left = seen[rows] - basis @ (basis.T @ seen[rows])
        least = min(least, float(left @ left))
    return least


def _try_other_starts(solution: LocalSolution) -> FitInSteps[LocalSolution]:
    """Solve again from other durations of the roll before the contact, if the solution is a poor one; the best of all.

    A long roll with a large loss looks like a slide, so that there may be several minima.
    """
    problem, starts = solution.problem, list[Array]()
    for k, motion in enumerate(problem.motions):
        if motion.ends and not problem.stretches[k].after and not solution.is_good:
            for share in (0.2, 0.5, 0.8):
                x = solution.x.copy()
                x[problem.start[k] + 6], x[problem.start[k + 1] - 1] = np.log(share * problem.spans[k]), x[6]
                starts.append(x)
    if not starts:
        return solution
    [tries] = yield [
        Descent([problem] * len(starts), np.array(starts), solution.sizes, steps=15, least_gain=ROUGH_GAIN)
    ]
    return min([solution, *tries], key=lambda one: one.cost)


def weigh_by_residuals(found: Sequence[LocalSolution], known: bool) -> FitInSteps[list[LocalSolution]]:
    """Solve local fits again with errors as large and as lasting as the residuals of each stretch; best first.

    known: errors are claimed, and are never smaller than that. A body at rest takes the mean of all stretches, because
    recorders round or drop its positions. If these count as one, it is that of a single position.
    """
    solution = found[0]
    if known and solution.is_good:
        return sorted(found, key=lambda s: -s.log_evidence)
    problem = solution.problem
    ends = 2 * np.cumsum([len(s) for s in problem.stretches])[:-1]
    lefts, frees, counts = (np.split(v, ends) for v in (solution.residual, solution.freedom, problem.counted))
    moving = [k for k, motion in enumerate(problem.motions) if motion.moves]
    from_contact = [slice(None, None, 1 if s.after else -1) for s in problem.stretches]
    fars, orders = [problem.stretches[k].far for k in moving], [from_contact[k] for k in moving]
    free = [max(float(frees[k][counts[k]].sum()), 0.5) for k in moving]
    own, usual, single = measure_variances(
        [lefts[k][counts[k]].reshape(-1, 2)[from_contact[k]] for k in moving],
        free,
        # coefficients of the path along an axis that the positions determine
        [max(round((float(counts[k].sum()) - f) / 2), 2) for k, f in zip(moving, free, strict=True)],
        [far.count[own] for far, own in zip(fars, orders, strict=True)],
        [_count_frames(far.time[own], far.count[own], solution.x[0]) for far, own in zip(fars, orders, strict=True)],
    )
    found_squares, least = dict(zip(moving, own, strict=True)), 1.0 if known else 1e-12
    at_rest = single if problem.dry else usual
    sizes = [size * float(np.sqrt(max(found_squares.get(k, at_rest), least))) for k, size in enumerate(solution.sizes)]
    likely = [one for one in found if one is solution or not _stays_unlikely(one, solution, sizes)]
    again = yield [Descent([one.problem], one.x[None], sizes, least_gain=ROUGH_GAIN) for one in likely]
    unlikely = [one for one in found if not any(one is other for other in likely)]
    return sorted((*(one for [one] in again), *unlikely), key=lambda s: -s.log_evidence)


def _stays_unlikely(one: LocalSolution, best: LocalSolution, sizes: Sequence[float]) -> bool:
    """Decide whether a solution has no weight beside another whatever its descent with errors of these sizes finds.

    Larger errors lower a cost by at most the square of their growth. They widen the errors of each parameter by at most
    their growth.
    """
    shrinks = [(old / new) ** 2 for old, new in zip(one.sizes, sizes, strict=True)]
    least, most = 0.9 * min(1.0, *shrinks) * one.cost, max(1.0, *shrinks) * best.cost  # descents are rough
    volumes = [each.log_evidence + each.cost / 2 for each in (one, best)]
    widens = one.problem.size * float(np.log(max(1.0, *shrinks) / min(1.0, *shrinks))) / 2
    return volumes[0] - volumes[1] + widens - (least - most) / 2 < -MAX_EVIDENCE_LOST


def _count_frames(time: Array, count: Ints, contact: float) -> float:
    """Count the frames from a contact to the first frame of positions that are means of so many, from the contact on.

    More than 10 count as 10: a stretch so far from the contact hardly shows the velocity there.
    """
    if len(time) < 2:
        return 1.0
    middle = np.cumsum(count) - (count - 1) / 2
    frame_s = float(np.median(np.diff(np.abs(time - contact)) / np.diff(middle)))
    return float(np.clip(abs(float(time[0]) - contact) / frame_s - (count[0] - 1) / 2, 0.25, 10.0))


def shows_end(solution: LocalSolution, k: int) -> bool:
    """Decide whether a local fit shows when the slide of a stretch ends.

    The part next to the contact holds four positions. If the slide filled the stretch, one end of it would be off
    by ten of its errors. The duration is known to a fifth.
    """
    problem, stretch, at = solution.problem, solution.problem.stretches[k], solution.problem.start[k]
    tau = float(np.exp(solution.x[at + 6]))
    since = np.abs(stretch.time - solution.x[0])
    rolls_s = float(since.max()) - tau if stretch.after else min(tau, float(since.max()))
    off = float(np.hypot(*problem.values(solution.x, k)[4:6])) * max(rolls_s, 0.0) ** 2 / 2
    error = float(np.median(stretch.std)) * solution.sizes[k]
    held = int((~stretch.near & (since < tau)).sum())
    return held >= 4 and off > 10.0 * error and bool(solution.cov[at + 6, at + 6] < 0.2**2)


def mix_solutions(
    found: Sequence[LocalSolution], *, durations: int = 6
) -> FitInSteps[list[tuple[float, LocalSolution]]]:
    """Weigh the solutions of local fits by their evidence: motions of the stretches and durations of their slides.

    A fit of the duration of a slide has no error to rely on where the positions do not show its end. While the slide
    outlasts the stretch, nothing depends on it; as soon as it ends earlier, all does. So such a slide gets each
    duration in turn, with its evidence times its prior. Before a contact that is the duration of rolling. The distance
    by which a body may be elsewhere after the contact gets each of `shifts` in turn, over the prior one.
    """
    shifts = [0.1, 0.3, 1.0]
    best = max(one.log_evidence for one in found)
    mixture = list[tuple[float, LocalSolution]]()
    for one in found:
        if one.log_evidence < best - MAX_EVIDENCE_LOST:  # its slides may fit better with another duration
            continue
        usual = one.problem.priors.shift_share
        priors = [replace(one.problem.priors, shift_share=share * usual) for share in shifts]
        problems = [replace(one.problem, priors=each) for each in priors]
        [shifted] = yield [Descent(problems, np.tile(one.x, (len(problems), 1)), one.sizes, steps=8)]
        parts = _drop_unlikely([(0.0, each) for each in shifted])
        shifts = [each.problem.priors.shift_share / usual for _, each in parts]  # the next motions have the same
        for k, motion in enumerate(one.problem.motions):
            if motion.ends and not shows_end(one, k):
                may_slide_on = not any(other.problem.motions[k] == SLIDE for other in found)
                parts = _drop_unlikely((yield from _vary_each_slide(parts, k, durations, may_slide_on)))
        mixture += parts
    mixture = _drop_unlikely(mixture, len(mixture))  # the parts of one solution could displace all of another
    weights = np.exp([_log_weight(part) - _log_weight(mixture[0]) for part in mixture])
    return [(float(w), one) for w, (_, one) in zip(weights / weights.sum(), mixture, strict=True)]


def _log_weight(part: tuple[float, LocalSolution]) -> float:
    """Logarithm of the prior of a solution and of its evidence."""
    return part[0] + part[1].log_evidence


def _drop_unlikely(
    parts: list[tuple[float, LocalSolution]], most: int = 16, most_of_others: int = 2
) -> list[tuple[float, LocalSolution]]:
    """Sort solutions by their weights, and keep the `most` likely ones that have LEAST_WEIGHT of the largest or more.

    Those with the same motion before the contact show almost the same velocity there. Of each such group whose weight
    is LEAST_WEIGHT of the largest at least `most_of_others` stay, and those that stay take the weight of the group.
    """
    parts = sorted(parts, key=lambda part: -_log_weight(part))
    weights, groups = np.array([_log_weight(part) for part in parts]), dict[object, list[int]]()
    for i, (_, one) in enumerate(parts):
        groups.setdefault(_name_motion_before(one), []).append(i)
    kept = set(np.flatnonzero(weights[:most] >= weights[0] + np.log(LEAST_WEIGHT)).tolist())
    totals = {name: float(logsumexp(weights[group])) for name, group in groups.items()}
    for name, group in groups.items():
        if totals[name] >= max(totals.values()) + np.log(LEAST_WEIGHT):
            kept.update(group[:most_of_others])
    out = list[tuple[float, LocalSolution]]()
    for name, group in groups.items():
        stay = [i for i in group if i in kept]
        lost = totals[name] - float(logsumexp(weights[stay])) if stay else 0.0
        out += [(parts[i][0] + lost, parts[i][1]) for i in stay]
    return sorted(out, key=lambda part: -_log_weight(part))


def _name_motion_before(solution: LocalSolution) -> object:
    """Name the motions before the contact, with the durations of their slides that are assumed one by one."""
    problem = solution.problem
    early = [k for k, stretch in enumerate(problem.stretches) if not stretch.after]
    return tuple((problem.motions[k], problem.slides.get(k)) for k in early)


def _vary_each_slide(
    parts: Sequence[tuple[float, LocalSolution]], k: int, durations: int, may_slide_on: bool
) -> FitInSteps[list[tuple[float, LocalSolution]]]:
    """Solve each solution of the same motions, the likeliest first, with each duration of one slide.

    The others get only durations that are likely in the first, by LEAST_WEIGHT and a margin of the logarithm.
    may_slide_on: whether a slide up to the contact counts as a duration, because no other solution has that motion.
    """
    cells = _list_durations(parts[0][1], k, durations, may_slide_on)
    if not cells:  # no cost of the stretch is finite
        return list(parts)
    out = yield from _solve_with_durations(parts[:1], k, cells)
    least = max(map(_log_weight, out)) + np.log(LEAST_WEIGHT) - 3.0
    likely = [c for c, one in zip(cells, out, strict=True) if _log_weight(one) >= least]
    return out + ((yield from _solve_with_durations(parts[1:], k, likely)) if len(parts) > 1 else [])


class SlideDuration(NamedTuple):
    """A duration that a slide may have, s, with the error of its logarithm and the logarithm of its prior."""

    lasts: float
    error: float
    log_prior: float


def _solve_with_durations(
    parts: Sequence[tuple[float, LocalSolution]], k: int, cells: Sequence[SlideDuration]
) -> FitInSteps[list[tuple[float, LocalSolution]]]:
    """Solve each solution with each duration of one slide.

    A descent starts from the duration of the solution, or from the end of the cell that is nearest to it. From the
    middle of a wide cell it may start so far off that it ends in vain. Before a contact it starts with the same slide,
    so velocity and position at the contact change with the duration of the roll.
    """
    problems, starts, logs = list[LocalProblem](), list[Array](), list[float]()
    for log, one in parts:
        for cell in cells:
            problems.append(replace(one.problem, slides={**one.problem.slides, k: (cell.lasts, cell.error)}))
            starts.append(one.x.copy())
            at, reach = one.problem.start[k] + 6, np.sqrt(3) * cell.error
            starts[-1][at] = np.clip(one.x[at], np.log(cell.lasts) - reach, np.log(cell.lasts) + reach)
            if not one.problem.stretches[k].after:
                old, new = np.exp(one.x[at]), np.exp(starts[-1][at])
                pull, own = one.problem.values(one.x, k)[4:6], starts[-1][at - 6 : at - 2]
                own += np.concatenate([pull * (old**2 - new**2) / 2, pull * (old - new)])
            logs.append(log + cell.log_prior)
    [found] = yield [
        Descent(problems, np.array(starts), parts[0][1].sizes, steps=8, hopeless=1.5 * MAX_COST, least_gain=3e-3)
    ]
    return list(zip(logs, found, strict=True))


def _find_share_of_slides(solution: LocalSolution, k: int, last: float) -> float:
    """Find the probability that a striker that slid within `last` seconds before the contact still slides there.

    A hit comes at any time. So slides that the hit interrupts are to those that ended in the window as the mean
    duration of a slide is to the window. A slip u ends after 2 u/(7 mu g). We take slips from 0, of a ball that rolls,
    to the speed v, of a ball without spin, as equally likely. The mean duration is then v/(7 mu g).
    """
    x, at = solution.x, solution.problem.start[k]
    lasts = float(np.hypot(*x[at + 2 : at + 4]) / (7 * np.exp(x[5]) * GRAVITY))
    return lasts / (lasts + last)


def _list_durations(solution: LocalSolution, k: int, durations: int, may_slide_on: bool) -> list[SlideDuration]:
    """List durations of one slide: two below the first position, cells, and one or two above the stretch.

    The cells divide only the durations with which the stretch alone fits hardly worse than with the best. Wider cells
    could change the velocity by many errors from one to the next. The prior of their logarithms is even where the slip
    is known, because that tells which of them are likely. Then there is one more above the stretch, which has no upper
    end. Its normal density begins `OPEN_SIGMAS` below its middle, where the cell before it ends: cells inside the
    stretch would count twice if much of it lay there.

    Before a contact the durations are those of the roll. Unless the end of the slide is known, their prior is uniform
    over the stretch, because a hit comes at any time after the slide. may_slide_on: the slide may also last up to the
    contact, which is the first cell, with the probability of `_find_share_of_slides`.
    """
    priors, stretch = solution.problem.priors, solution.problem.stretches[k]
    since = np.abs(stretch.time - solution.x[0])
    first = max(float(since.min()), 1e-5)
    last = max(float(since.max()), 1.01 * first)

    def fits(lasts: Array) -> Flags:
        motion, size = solution.problem.motions[k], solution.sizes[k]
        contact, tried = float(solution.x[0]), np.append(lasts, least)
        costs = _fit_each(stretch, contact, motion, tried, priors.fall)[0] / size**2
        return np.asarray(costs[: len(lasts)] < costs.min() + MAX_COST)

    least = np.linspace(first, 1.5 * last, 5 * durations)
    inside = np.append(least[least < last], last)
    seen = np.flatnonzero(fits(inside))
    low, high = first, last
    if len(seen):
        low, high = inside[max(seen[0] - 1, 0)], inside[min(seen[-1] + 1, len(inside) - 1)]
    ends = np.concatenate([[1e-3 * first, first / 3, first], np.linspace(low, high, durations + 1), [last, 2 * last]])
    end, slips = solution.problem.find_end(k), priors.slips if k in solution.problem.slips else None
    if slips is not None:
        ends = np.append(ends, 8 * last)
        below = np.log(ends)
    elif stretch.after:
        below = ndtr((np.log(np.append(ends[:-1], np.inf)) - np.log(priors.slide_s)) / priors.slide_factor)
        below[0] = 0.0
    else:
        ends = np.append(1e-5 * first, ends)  # the first cell is a slide up to the contact
        share = _find_share_of_slides(solution, k, last) if may_slide_on else 0.0
        ended = np.minimum(ends[1:] / last, 1.0)
        below = np.append(
            0.0, share + (1 - share) * ended if end is None else ndtr((ends[1:] - end.rolls) / end.rolls_std)
        )
    middles, widths = (ends[1:] + ends[:-1]) / 2, np.diff(ends) / np.sqrt(12)
    if end is not None:  # perhaps narrower than a cell
        middles, widths = _narrow_cells(ends, middles, widths, end)
    log_priors = np.log(np.maximum(np.diff(below), 1e-12))
    if slips is not None:  # the last one has no upper end: friction and slip depend on how long the slide lasts
        middles[-1] = max(4 * last, slips.find_duration(stretch.ball, float(np.exp(solution.x[5]))))
        error = min(float(np.log(middles[-1] / (2 * last))) / OPEN_SIGMAS, MAX_OPEN_ERROR)
        widths[-1], log_priors[-1] = error * middles[-1], np.log(np.sqrt(2 * np.pi) * error)
    enough = np.any(fits(np.concatenate([ends[:-1], middles, ends[1:]])).reshape(3, -1), axis=0)
    cells = zip(middles.tolist(), (widths / middles).tolist(), log_priors.tolist(), strict=True)
    return [SlideDuration(*cell) for cell, known in zip(cells, enough & (widths > 0), strict=True) if known]


def _narrow_cells(ends: Array, middles: Array, widths: Array, end: KnownEnd) -> tuple[Array, Array]:
    """Means and standard deviations of a normal duration in each cell; those given, where it all but never lies.

    ends: of the cells. The first cell is a slide up to the contact, and stays.
    """
    least_share = 1e-6  # of the probability
    at = (ends - end.rolls) / end.rolls_std
    share, density = np.diff(ndtr(at)), np.exp(-(at**2) / 2) / np.sqrt(2 * np.pi)
    known = share > least_share
    known[0] = False
    share = np.where(known, share, 1.0)
    shift = -np.diff(density) / share
    mean = end.rolls + end.rolls_std * shift
    variance = end.rolls_std**2 * (1 - np.diff(at * density) / share - shift**2)
    narrow = np.sqrt(np.maximum(variance, (0.01 * mean) ** 2))
    return np.where(known, mean, middles), np.where(known, narrow, widths)
