"""Fits one model to all clips by Gauss-Newton: shared parameters, and the launch of each clip.

The launches are eliminated from the normal equations clip by clip, so the cost grows linearly with the number of clips.
This is variable projection (Golub & Pereyra, Inverse Problems 19 (2003) R1). Derivatives are reused for as long as
chi^2 falls as they predict.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import lsq_linear

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import is_possible_launch, limit_spins
from discrepancy.fitting.jacobian import coupling_effects, linearise
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.parameters import replace_within_limits
from discrepancy.fitting.predict import predict_tracks
from discrepancy.noise.model import Noise
from discrepancy.policy import current_policy
from synthcam.model import Model, without_mutual_push
from synthcam_shared.arrays import Array, Flags

STEP_ERRORS = (ValueError, ArithmeticError)  # a step fails: no motion, a singular matrix, an overflow
MAX_DAMPING = 1e6
STALLED_SHARE = 0.01  # of chi^2 of poor clips, where launches are fitted only to follow a step; as `least_share`


def fit_model(
    clips: Sequence[MeasuredCollision], model: Model, names: Sequence[str], noise: Noise, launches: Array | None = None
) -> ModelFit:
    """Fit shared parameters and every launch by Gauss-Newton, with Marquardt's damping when a step fails.

    model: its values are the start of the fit.
    names: the shared parameters; with none only the launches are fitted.
    launches: start of the launches, (clips, p); by default the clips' own first guesses.
    Raises ValueError where the model has no motion for one of the first launches.
    """
    whitened = WhitenedClips.of(clips, noise)
    places = np.array([c.launch for c in clips] if launches is None else launches, dtype=float)
    return minimise_chi2(whitened, linearise(whitened, model, tuple(names), places))


def minimise_chi2(
    whitened: WhitenedClips, fit: ModelFit, rough: bool = False, useful_chi2: float = np.inf, least_share: float = 0.0
) -> ModelFit:
    """Minimise chi^2 of all clips by Gauss-Newton steps from a fit.

    A whole step is tried first. If it fails for bodies on air, their launches are fitted again after it
    (`_fit_launches_after`). Then follow 30 and 10 % of the step, since along a bent valley a shorter step still
    descends. If all fail, a few clips may be at fault: their launches are damped (`_find_failing_clips`), else all
    parameters. New derivatives are taken when chi^2 falls by 20 % more or less than the old ones predict.

    rough: stop about 0.1 above the least chi^2, with derivatives of a point nearby, which is enough to rank models.
    Else the tolerance is 1e-3, with derivatives at the minimum.

    useful_chi2: a fit with a larger chi^2 is of no use. The descent ends where a third of the way down to it is more
    than the last step gained and than the next one promises. A step that failed does not count.

    least_share: clips above `SearchPolicy.poor_chi2_per_point` count as fitted if a step gains
    less than this share of their chi^2. They stay poor whatever the rest of the descent gains.
    """
    damping, tolerance, last, gained = 0.0, 0.1 if rough else 1e-3, False, np.inf
    held = np.zeros(len(fit.residuals))  # damping of single launches
    for _ in range(40):
        try:
            values, own = _step(fit, damping, held)
        except STEP_ERRORS:
            break
        predicted = fit.chi2 - _predict_chi2(fit, values, own)
        if 3 * max(gained, predicted) < fit.chi2 - useful_chi2:
            break
        if last or predicted < tolerance:
            if fit.is_linearised_here or rough or (here := _relinearise(whitened, fit)) is None:
                break
            fit, last = here, False
            continue
        for share in (1.0, 0.3, 0.1) if fit.is_linearised_here else (1.0,):
            moved = _apply_step(whitened, fit, _interpolate(fit, values, share), share * own)
            gained = fit.chi2 - moved.chi2 if moved else -np.inf
            if not gained > 0 and share == 1 and moved and (after := _fit_launches_after(whitened, fit, moved)):
                gained, moved = fit.chi2 - after.chi2, after
            if gained > 0 or (few := _find_failing_clips(fit, moved, held)).any():
                break
        if moved is None or not gained > 0:
            gained = np.inf  # a step that failed says nothing of how far the fit can descend
            if fit.is_linearised_here and few.any():
                held[few] = np.maximum(10 * held[few], 1e-3)
            elif fit.is_linearised_here:
                damping = max(10 * damping, 1e-3)
                if damping > MAX_DAMPING:
                    break
            elif (here := _relinearise(whitened, fit)) is None:
                break
            else:
                fit = here
            continue
        damping, held = float(_reduce_damping(damping)), np.asarray(_reduce_damping(held))
        last = gained < tolerance and share == 1
        if last and fit.is_linearised_here:
            return moved if rough else _relinearise(whitened, moved) or moved
        stalled, fit = least_share > 0 and _has_stalled(fit, moved, tolerance, least_share), moved
        if stalled:
            return fit if rough else _relinearise(whitened, fit) or fit
        if not last and abs(gained - predicted) > 0.2 * predicted:
            if (here := _relinearise(whitened, fit)) is None:
                break
            fit = here
    return fit


def _fit_launches_after(whitened: WhitenedClips, fit: ModelFit, moved: ModelFit) -> ModelFit | None:
    """Fit the launches again after a step of the shared parameters; None if chi^2 is still not less than before.

    A strong distortion moves the start of a path by more than its derivatives predict. The difference may be many
    errors of a position, so no step of all parameters descends far in such a valley. With launches that follow, it is
    straight (variable projection, Golub & Pereyra). Only free stretches of bodies that never slide are fitted in this
    way: their launches have no local minima.
    """
    if not (len(fit.launches) and fit.names and fit.is_linearised_here):
        return None
    if fit.model.sliding_friction or not all(clip.is_stretch for clip in whitened.clips):
        return None
    try:
        start = linearise(whitened, moved.model, (), moved.launches)
        after = minimise_chi2(whitened, start, rough=True, useful_chi2=fit.chi2, least_share=STALLED_SHARE)
        return linearise(whitened, after.model, fit.names, after.launches) if after.chi2 < fit.chi2 else None
    except STEP_ERRORS:
        return None


def _has_stalled(fit: ModelFit, moved: ModelFit, tolerance: float, least_share: float) -> bool:
    """Tell if a step gained less than this share of chi^2 in each poor clip, and than the tolerance in each other."""
    before, after = (np.array([r @ r for r in each.residuals]) for each in (fit, moved))
    poor = after > current_policy().poor_chi2_per_point * np.array([len(r) for r in moved.residuals])
    return bool(poor.any() and np.all(before - after < np.where(poor, least_share * after, tolerance)))


def _reduce_damping(damping: Array | float) -> Array | np.float64:
    """The damping after a step that lowered chi^2."""
    return np.where(np.greater(damping, 1e-4), np.divide(damping, 10), 0.0)


def _find_failing_clips(fit: ModelFit, moved: ModelFit | None, held: Array) -> Flags:
    """At most a fifth of the clips, which alone made a step fail: only their launches are then damped."""
    none = np.zeros(len(fit.residuals), dtype=bool)
    if moved is None or not fit.is_linearised_here:
        return none
    rise = np.array([(a**2).sum() - (b**2).sum() for a, b in zip(moved.residuals, fit.residuals, strict=True)])
    few = (rise > 0.1 * rise.max()) & (rise > 0)
    if few.mean() > 0.2 or rise[~few].sum() > 0 or held[few].max() > MAX_DAMPING:
        return none
    return np.asarray(few)


def _relinearise(whitened: WhitenedClips, fit: ModelFit) -> ModelFit | None:
    """The fit with derivatives at its own values; None where the model has no motion near there."""
    try:
        return linearise(whitened, fit.model, fit.names, fit.launches)
    except STEP_ERRORS:
        return None


def _interpolate(fit: ModelFit, values: Mapping[str, float], share: float) -> dict[str, float]:
    """Values between the fit's and new ones, by this share."""
    return {n: (1 - share) * fit.model.value(n) + share * v for n, v in values.items()} if share < 1 else dict(values)


def take_one_step(whitened: WhitenedClips, fit: ModelFit, model: Model) -> ModelFit | None:
    """Take a step of all parameters from another model if that lowers chi^2; None where that model has no motion."""
    there = _apply_step(whitened, dataclasses.replace(fit, model=model), {}, np.zeros_like(fit.launches))
    if there is None:
        return None
    try:
        further = _apply_step(whitened, there, *_step(there, 0.0))
    except STEP_ERRORS:
        return there
    return further if further and further.chi2 < there.chi2 else there


def choose_most_likely(
    whitened: WhitenedClips, fit: ModelFit, tries: Sequence[Mapping[str, float]]
) -> Mapping[str, float] | None:
    """Choose the values of parameters that fit best after a step of all others; None without a motion for any."""
    names, plain = tuple(tries[0]), without_mutual_push(fit.model)
    pushing = coupling_effects(fit.model, plain) & {n.partition(".")[0] for n in names}
    model = fit.model if pushing else plain  # which is faster

    def predict(values: Mapping[str, float]) -> list[Array] | None:
        try:
            return predict_tracks(model.replace(values), fit.launches, whitened.clips)
        except STEP_ERRORS:
            return None

    if (here := predict({})) is None:
        return None
    kept, best, least = fit.drop(fit.model, names), None, np.inf
    for values in tries:
        if (places := predict(values)) is None:
            continue
        off = whitened.whiten([a - b for a, b in zip(here, places, strict=True)])
        look = dataclasses.replace(kept, residuals=tuple(r + o for r, o in zip(fit.residuals, off, strict=True)))
        if (chi2 := _predict_chi2(look, *_step(look, 0.0))) < least:
            best, least = values, chi2
    return best


def _apply_step(whitened: WhitenedClips, fit: ModelFit, values: Mapping[str, float], own: Array) -> ModelFit | None:
    """The fit after a step, with unchanged derivatives; None where the model has no motion there."""
    launches = limit_spins(fit.launches + own)
    if not is_possible_launch(launches):
        return None
    try:
        model = replace_within_limits(fit.model, values)
        residuals = whitened.whitened_residuals(model, launches)
    except STEP_ERRORS:
        return None
    return dataclasses.replace(fit, model=model, launches=launches, residuals=residuals)


def _predict_chi2(fit: ModelFit, values: Mapping[str, float], own: Array) -> float:
    """chi^2 after a step, to first order."""
    shared = np.array([values[n] - fit.model.value(n) for n in fit.names])
    parts = zip(fit.residuals, fit.slopes, fit.launch_slopes, own, strict=True)
    return float(sum(((r - s @ shared - a @ o) ** 2).sum() for r, s, a, o in parts))


def _step(fit: ModelFit, damping: float, held: Array | float = 0.0) -> tuple[dict[str, float], Array]:
    """The Gauss-Newton step within the limits: new values of the shared parameters, changes of the launches."""
    shared, own = solve_step(fit, damping, *fit.step_bounds(), held)
    return dict(zip(fit.names, (fit.values() + shared).tolist(), strict=True)), own


def solve_step(
    fit: ModelFit, damping: float, least: Array, most: Array, held: Array | float = 0.0
) -> tuple[Array, Array]:
    """Solve for the Gauss-Newton step: changes of the shared parameters, (S,), and of the launches, (clips, p).

    The launches are eliminated clip by clip.
    damping: Marquardt's, as a share of each diagonal element; held: further damping of each clip's launch.
    least, most: bounds (S,) of the shared parameters' changes.
    """
    size = len(fit.names)
    matrix, right, blocks = np.zeros((size, size)), np.zeros(size), []
    every = damping + np.broadcast_to(held, len(fit.residuals))
    for r, s, a, damped in zip(fit.residuals, fit.slopes, fit.launch_slopes, every, strict=True):
        own = a.T @ a
        size_of_own = np.diag(own)
        own[np.diag_indices(len(own))] = np.where(size_of_own > 0, size_of_own * (1 + damped), 1.0)
        coupling, pull = a.T @ s, a.T @ r
        both = np.column_stack([coupling, pull])
        try:
            solved = np.linalg.solve(own, both)
        except np.linalg.LinAlgError:  # the track does not determine all of a launch: the solution of least norm
            solved = np.linalg.lstsq(own, both, rcond=None)[0]
        blocks.append(solved)
        matrix += s.T @ s - coupling.T @ solved[:, :-1]
        right += s.T @ r - coupling.T @ solved[:, -1]
    matrix[np.diag_indices(size)] *= 1 + damping
    shared = _minimise_quadratic(matrix, right, least, most) if size else np.zeros(0)
    own_steps = np.array([b[:, -1] - b[:, :-1] @ shared for b in blocks])
    return shared, own_steps


def _minimise_quadratic(matrix: Array, right: Array, least: Array, most: Array) -> Array:
    """The x within bounds that minimises x' matrix x / 2 - right' x, with zero along directions without curvature."""
    scale = np.sqrt(np.diag(matrix).clip(0))
    scale = np.where(scale > 0, scale, 1)
    values, axes = np.linalg.eigh(matrix / np.outer(scale, scale))
    seen = values > 1e-13 * values[-1]
    root = np.sqrt(values[seen])[:, None] * axes[:, seen].T
    target = (axes[:, seen].T @ (right / scale)) / np.sqrt(values[seen])
    x = np.linalg.lstsq(root, target, rcond=None)[0]
    if np.any((x < least * scale) | (x > most * scale)):
        narrow = 1e-12 * scale  # lsq_linear requires an interval
        x = lsq_linear(root, target, (least * scale - narrow, most * scale + narrow), method="bvls").x
    return np.asarray(np.clip(x / scale, least, most))
