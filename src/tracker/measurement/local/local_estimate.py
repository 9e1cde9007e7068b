"""The local estimate of one collision: velocities just before and after, and the quantities that follow from them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import NamedTuple

import numpy as np

from synthcam_shared.arrays import Array
from tracker.camera.camera import Camera
from tracker.camera.camera_json import BODIES
from tracker.measurement.camera_errors import CameraError, WarpError, camera_errors
from tracker.measurement.collision.adequacy import compute_p_value
from tracker.measurement.collision.collision_model import AFTER, FREE, GRAVITY
from tracker.measurement.collision.contacts import Contact, guess_launch
from tracker.measurement.collision.derived import QUANTITY_NAMES, derive_from_each_ball, dot, make_ball_average
from tracker.measurement.collision.staying_together import fit_slope
from tracker.measurement.local.descents import (
    FitInSteps,
    find_covariances_of_known,
    follow_displacements,
    run_alone,
)
from tracker.measurement.local.local_fit import (
    BEFORE,
    MAX_RESIDUAL_CLAIMED,
    MAX_RESIDUAL_SCATTER,
    choose_window,
    fit_line,
    fit_motions,
    guess_contact,
    mix_solutions,
    shows_end,
    weigh_by_residuals,
)
from tracker.measurement.local.local_problem import KnownEnd, KnownSlips, LocalPriors, LocalSolution
from tracker.measurement.local.push_fit import PushDuration, measure_push
from tracker.measurement.local.stretches import (
    ROLL,
    SLIDE,
    SLIDE_AND_ROLL,
    SLIDE_AND_STOP,
    MotionKind,
    Stretch,
    cut_stretch,
    find_rows,
)
from tracker.measurement.positions import measure_separation

MIN_POSITIONS = 3  # of each stretch
SIDES = ((1, False), (2, False), (1, True), (2, True))  # ball, whether after the contact
VELOCITIES = ("v1ix", "v1iy", "v2ix", "v2iy", "v1ox", "v1oy", "v2ox", "v2oy")  # m/s, just before and after
BALANCE = ("balance_n", "balance_t")  # m/s, momentum after less before over the mean mass, along n and t
SIMPLE_AFTER = {  # motions of a body after a contact by its support, by which the windows of stretches are chosen
    "": (SLIDE, SLIDE_AND_ROLL, SLIDE_AND_STOP),
    "cloth": (SLIDE, SLIDE_AND_ROLL),
    "air": (SLIDE,),
    "sliding": (SLIDE_AND_STOP,),
}
WHEN_BOTH_ROLL = ("v1f", "v2f", "energy_fraction", "momentum_fraction", "final_angle")  # the balls, after their slides
UNSEEN_ON_AIR = ("mu_k", "C", "w1n", "w1t", "w2n", "w2t", "tau1", "tau2")  # where bodies glide
LOCAL_NAMES = (*QUANTITY_NAMES, *VELOCITIES, "impact_energy", *BALANCE, "mass_ratio")


@dataclass(frozen=True)
class LocalEstimate:
    """Values in the order of LOCAL_NAMES, with their covariance.

    response: (n, 9), derivatives of each value. They are by the velocities of SIDES along n and t, and by the logarithm
    of the mass ratio, ball 1 over ball 2.
    chi2, dof, adequate: of the positions by the errors before the residuals widen them, and the p-value. Without
    claimed errors these are those of the scatter from frame to frame.
    shared: by key of the camera file that has an error, its value, and the effect (n,) of one standard error.
    cov_of_known: of a contact of a crowd, the part of the covariance that errors of what is known of the motions make,
    not those of positions.
    push: how long bodies that glide push each other; None where the positions do not show it.
    """

    value: Array
    cov: Array
    response: Array
    normal_speed: float  # of approach, m/s
    chi2: float
    dof: float
    adequate: float
    glides: bool
    unseen: frozenset[str]
    errors_known: bool  # whether the tracks claim errors of positions that their scatter does not contradict
    shared: dict[str, tuple[float, Array]] = field(default_factory=dict)
    cov_of_known: Array | None = None
    push: PushDuration | None = None

    @property
    def std(self) -> Array:
        """Standard errors in the order of LOCAL_NAMES."""
        return np.sqrt(np.maximum(np.diag(self.cov), 0.0))


def estimate_locally(contact: Contact, camera: Camera, masses: tuple[float, float]) -> LocalEstimate | str:
    """Estimate one collision as `estimate_in_steps` does, by itself."""
    return run_alone(estimate_in_steps(contact, camera, masses))


def estimate_in_steps(
    contact: Contact,
    camera: Camera,
    masses: tuple[float, float],
    slips: KnownSlips | None = None,
    ends: tuple[KnownEnd | None, KnownEnd | None] = (None, None),
    before: Sequence[Sequence[MotionKind]] = BEFORE,
    *,
    of_crowd: bool = False,
) -> FitInSteps[LocalEstimate | str]:
    """Estimate one collision from free motion near the contact, or give the reason why that is impossible.

    masses: of ball 1 and ball 2, in any unit.
    slips: of ball 1 and ball 2 after the contact, if they are known.
    ends: of the slides of ball 1 and ball 2 before the contact, if other contacts show them.
    before: motions that ball 1 and ball 2 may have on a plate before the contact.
    of_crowd: find `cov_of_known`, because many contacts show how large that part is.
    """
    instant = _guess_instant(contact, camera)
    if _stay_together(contact, instant):
        return "the bodies stay together after the hit"
    settings = contact.pair.settings
    known = LocalPriors(
        contact.pair.diameter,
        friction=settings.local_friction,
        friction_factor=settings.local_friction_factor,
        loss=settings.local_rolling_loss_m_s2,
        slips=slips,
        ends=ends,
    )
    fit = yield from _fit_stretches(contact, camera, instant, known, before, of_crowd)
    if isinstance(fit, str):
        return fit
    if not camera.support and any(one.problem.dry for _, one in fit.mixture):
        dry = yield from _fit_stretches(contact, replace(camera, support="sliding"), instant, known, before, of_crowd)
        fit = fit if isinstance(dry, str) else _put_dry_fit(fit, dry)
    estimate = _read_values(fit.claimed, fit.mixture, contact, camera, masses, of_crowd=of_crowd)
    glide = all(one.problem.glide and not one.problem.dry for _, one in fit.mixture)
    return replace(estimate, push=_measure_push(estimate, contact, camera)) if glide and not of_crowd else estimate


class LocalFit(NamedTuple):
    """The best solution with the claimed errors, and all with their weights, by errors as large as residuals."""

    claimed: LocalSolution
    mixture: list[tuple[float, LocalSolution]]  # the likeliest first


def _fit_stretches(
    contact: Contact,
    camera: Camera,
    instant: float,
    known: LocalPriors,
    before: Sequence[Sequence[MotionKind]],
    of_crowd: bool,
) -> FitInSteps[LocalFit | str]:
    """Fit all stretches of a contact at about this instant, s, or give the reason why that is impossible."""
    rests = not contact.pair.target_moves
    supports = (camera.support,) if camera.support else ("cloth", "sliding", "air")
    lasts, dry = contact.end > contact.start, camera.support == "sliding"
    simple_after = SIMPLE_AFTER[camera.support]
    simple_before = (ROLL, *simple_after) if "cloth" in supports else simple_after
    claimed = bool(np.isinf(contact.pair.striker.noise_dof))
    max_residual = MAX_RESIDUAL_CLAIMED if claimed else MAX_RESIDUAL_SCATTER
    for turn in range(3):
        whole = _cut_stretches(contact, camera, instant)
        if min(map(len, whole)) < MIN_POSITIONS:
            return "too few positions near the contact"
        priors = _guess_fall_of_loss(known, whole)
        stretches = [
            (s.as_one if dry else s)
            if rests and (s.ball, s.after) == (1, False)
            else choose_window(s, instant, simple_after if s.after else simple_before, priors.fall, max_residual)
            for s in whole
        ]
        priors = _allow_for_duration(priors, stretches, contact, camera)
        if rests and known.slips is None:
            priors = replace(priors, slips=_expect_slips(stretches, instant))
        found = yield from fit_motions(
            stretches, instant, rests, supports, priors, before, known=claimed, slides_seen=of_crowd
        )
        late, instant = float(found[0].x[0]) - instant, float(found[0].x[0])
        if turn == 2 or lasts or abs(late) > 3 / camera.fps or _has_stretches(contact, camera, instant, late, whole):
            break
    weighed = yield from weigh_by_residuals(found, claimed)
    return LocalFit(found[0], (yield from mix_solutions(weighed)))


def _put_dry_fit(fit: LocalFit, dry: LocalFit) -> LocalFit:
    """Put a fit of bodies that slide until they stop in place of such solutions, with the weight that these have.

    The positions that all motions may have show this weight. The other fit also has those at rest, and longer windows.
    """
    others = [part for part in fit.mixture if not part[1].problem.dry]
    weight = 1 - sum(share for share, _ in others)
    mixture = sorted((*others, *((weight * share, one) for share, one in dry.mixture)), key=lambda part: -part[0])
    return LocalFit(dry.claimed if mixture[0][1].problem.dry else fit.claimed, mixture)


def _stay_together(contact: Contact, instant: float) -> bool:
    """Decide whether bodies stay together after the hit, as those with tape do: no free motion shows r then.

    Tape gives way at first. So the later two thirds of the positions count. There the bodies part by less than
    `least_r` of the speed of approach, within two errors. Their distance never changes by a tenth of a diameter.
    """
    least_positions, least_r = 10, 0.05
    (_, one), (_, other) = contact.pair.balls
    _, distance, mine, _ = measure_separation(one, other)
    since = one.time[mine] - instant
    window = np.abs(since) < contact.pair.settings.local_window_s
    before, after = window & (since < 0), window & (since > 0)
    if after.sum() < least_positions or before.sum() < MIN_POSITIONS:
        return False
    late = after & (since > since[after].max() / 3)
    (approach, _), (parting, error) = (fit_slope(since[rows], distance[rows], 0.0) for rows in (before, late))
    steady = np.ptp(distance[after]) < 0.1 * contact.pair.diameter
    return bool(steady and abs(parting) + 2 * error < least_r * abs(approach))


def _guess_fall_of_loss(priors: LocalPriors, stretches: Sequence[Stretch]) -> LocalPriors:
    """Guess how fast the loss of rolling balls falls.

    A part of the loss L is proportional to the speed v. If it is the share q of the loss, the loss falls at the rate
    q L/v. All shares from 0 to 1 are equally likely, and the error of L is as large as L. So the rate has the mean
    0.5 L/v and the standard deviation 0.65 L/v. v is the mean speed in the stretches, but at least that with which a
    ball rolls through the longest of them.
    """
    spans, ways = (np.array(part) for part in zip(*((np.ptp(s.time), _find_way(s)) for s in stretches), strict=True))
    speed = max(float(np.mean(ways / spans)), priors.loss * float(spans.max()))
    return replace(priors, fall=0.5 * priors.loss / speed, fall_error=0.65 * priors.loss / speed)


def _expect_slips(stretches: Sequence[Stretch], instant: float) -> KnownSlips:
    """What is known of the slips just after a ball has hit one at rest.

    The struck ball has no spin but what the surfaces give it. That of the striker may be any, because it may have slid.
    """
    share, share_error = 0.2, 0.2  # of the speed of approach, by which the surface of a striker that rolls drags it
    least = 0.05  # of the speed of the struck ball, any other error
    velocity = {(s.ball, s.after): fit_line(s, instant)[1] for s in stretches}
    struck, approach = velocity[1, True], float(np.hypot(*velocity[2, False]))
    speed = max(float(np.hypot(*struck)), 1e-9)
    return KnownSlips(
        slips=np.array([struck, velocity[2, True] - velocity[2, False]]),
        left=np.zeros((2, 2)),
        left_std=(0.0, approach),
        normal=struck / speed,
        share=share,
        drag_std=share_error * approach,
        std=least * speed,
    )


def _find_way(stretch: Stretch) -> float:
    """The distance of the last position from the first, m."""
    return float(np.hypot(*stretch.position[-1] - stretch.position[0]))


def _allow_for_duration(
    priors: LocalPriors, stretches: Sequence[Stretch], contact: Contact, camera: Camera
) -> LocalPriors:
    """Widen the errors of the positions at the contact by the way that bodies move while it lasts."""
    lasts_s = (contact.end - contact.start) / camera.fps
    if not lasts_s > 0:
        return priors
    way = lasts_s * max(_find_way(s) / float(np.ptp(s.time)) for s in stretches)
    share = way / contact.pair.diameter
    return replace(priors, distance_share=priors.distance_share + share, shift_share=priors.shift_share + share)


def _guess_instant(contact: Contact, camera: Camera) -> float:
    """Guess the instant of the contact, s: where the approach brings the bodies to one diameter."""
    frame_s = 1 / camera.fps
    seen = [float(t) for _, track in contact.pair.balls for t in track.time[track.frame == contact.frame]]
    instant = float(np.mean(seen)) if seen else contact.frame * frame_s + camera.exposure / 2
    if contact.end > contact.start:
        return instant + ((contact.start + contact.end) / 2 - contact.frame) * frame_s
    launch = guess_launch(contact.pair, contact.frame)
    if launch is not None and abs(launch[0] - instant) < 2 * frame_s:
        return float(launch[0])
    stretches = _cut_stretches(contact, camera, instant)
    guess = guess_contact(stretches, instant) if all(map(len, stretches)) else instant
    return guess if abs(guess - instant) < 1.5 * frame_s else instant


def _cut_stretches(contact: Contact, camera: Camera, instant: float) -> list[Stretch]:
    """The four stretches in the order of SIDES, without the frames of a contact that lasts."""
    tracks, window_s, span = dict(contact.pair.balls), contact.pair.settings.local_window_s, _span(contact, camera)
    first_and_last, frame_s, stops = (
        (instant - span / 2, instant + span / 2),
        1 / camera.fps,
        camera.support in ("", "sliding"),
    )
    return [
        cut_stretch(tracks[ball], ball, after, window_s, first_and_last, frame_s, stops=stops) for ball, after in SIDES
    ]


def _has_stretches(contact: Contact, camera: Camera, instant: float, late: float, cut: Sequence[Stretch]) -> bool:
    """Decide whether a contact at `instant` has stretches as long as those that were cut for one `late` s earlier."""
    tracks, window_s, span = dict(contact.pair.balls), contact.pair.settings.local_window_s, _span(contact, camera)
    for ball, after in SIDES:
        now, before = (
            find_rows(tracks[ball], after, window_s, (middle - span / 2, middle + span / 2), 1 / camera.fps)
            for middle in (instant, instant - late)
        )
        if not all(map(np.array_equal, now, before)):
            again = _cut_stretches(contact, camera, instant)
            return all(len(a) == len(b) for a, b in zip(cut, again, strict=True))
    return True


def _span(contact: Contact, camera: Camera) -> float:
    """The time of the frames of a contact that lasts, s; 0 of one that does not."""
    return (contact.end - contact.start + 1) / camera.fps if contact.end > contact.start else 0.0


def _read_values(
    claimed: LocalSolution,
    solutions: Sequence[tuple[float, LocalSolution]],
    contact: Contact,
    camera: Camera,
    masses: tuple[float, float],
    *,
    of_crowd: bool,
) -> LocalEstimate:
    """The estimate as a mean over the motions that the positions allow.

    claimed: the best solution with the claimed errors. solutions: with their weights, by errors as large as residuals.
    """
    noise_dof, weights = contact.pair.striker.noise_dof, np.array([weight for weight, _ in solutions])
    read = _read_solutions([each for _, each in solutions], camera, masses)
    values, every_cov, slopes, *others = zip(*read, strict=True)
    each, covs, responses, effects = (np.stack(part) for part in (values, every_cov, *others))
    value = weights @ each
    off = np.nan_to_num(each - value) * np.sqrt(weights)[:, None]
    cov_of_known = None
    if of_crowd:
        of_known = find_covariances_of_known([one for _, one in solutions])
        parts = [slope @ part @ slope.T for slope, part in zip(slopes, of_known, strict=True)]
        cov_of_known = np.tensordot(weights, np.stack(parts), 1) + off.T @ off
    v0, b = (value[LOCAL_NAMES.index(name)] for name in ("v0", "b"))
    shared = zip(_list_errors(camera), np.tensordot(weights, effects, 1), strict=True)
    return LocalEstimate(
        value=value,
        cov=np.tensordot(weights, covs, 1) + off.T @ off,
        response=np.tensordot(weights, responses, 1),
        normal_speed=float(v0 * np.sqrt(max(1 - b**2, 0.0))),
        chi2=claimed.chi2,
        dof=claimed.dof,
        adequate=compute_p_value(claimed.chi2, claimed.dof, noise_dof),
        glides=solutions[0][1].problem.glide,
        unseen=frozenset(name for _, one in solutions for name in _list_unseen(one, camera)),
        errors_known=bool(np.isinf(noise_dof)),
        shared={error.key: (error.value, effect) for error, effect in shared},
        cov_of_known=cov_of_known,
    )


def _measure_push(estimate: LocalEstimate, contact: Contact, camera: Camera) -> PushDuration | None:
    """How long bodies that glide push each other, with the error of the frame rate."""
    instant, r = (float(estimate.value[LOCAL_NAMES.index(name)]) for name in ("t_c", "r"))
    push = measure_push([track for _, track in contact.pair.balls], instant, r, 1 / camera.fps)
    return (
        None if push is None else push._replace(std=float(np.hypot(push.std, push.value * camera.fps_std / camera.fps)))
    )


def _read_solutions(
    solutions: Sequence[LocalSolution], camera: Camera, masses: tuple[float, float]
) -> list[tuple[Array, Array, Array, Array, Array]]:
    """Values of solutions of one hit, covariances, derivatives by the parameters, responses, and effects of the camera.

    The effects (k, n) are those of errors of the camera file.
    """
    mass_step = 1e-4  # of the logarithm of the mass ratio, for derivatives
    out = dict[int, tuple[Array, Array, Array, Array, Array]]()
    numbers = sorted(range(len(solutions)), key=lambda i: solutions[i].problem.motions)
    for _, same in groupby(numbers, key=lambda i: solutions[i].problem.motions):
        own = list(same)  # quantities are computed at once: most of the time is that of numpy's calls
        steps = [0.01 * np.sqrt(np.maximum(np.diag(solutions[i].cov), 0.0)) + 1e-9 for i in own]
        x = np.array([solutions[i].x for i in own])
        away = np.stack([[x[j] + np.diag(step), x[j] - np.diag(step)] for j, step in enumerate(steps)])
        middle = _quantities(solutions[own[0]], x, masses)
        heavier = _quantities(solutions[own[0]], x, (masses[0] * np.exp(mass_step), masses[1]))
        beside = _quantities(solutions[own[0]], away.reshape(-1, x.shape[1]), masses)
        for j, (high, low) in enumerate(beside.reshape(*away.shape[:3], -1)):
            with np.errstate(invalid="ignore"):
                slope = ((high - low) / (2 * steps[j][:, None])).T
            by_mass = (heavier[j] - middle[j]) / mass_step
            out[own[j]] = _propagate_errors(solutions[own[j]], camera, middle[j], slope, by_mass)
    return [out[i] for i in range(len(solutions))]


def _propagate_errors(
    solution: LocalSolution, camera: Camera, value: Array, slope: Array, by_mass: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Values of one solution with what follows from its errors, as of `_read_solutions`.

    slope: derivatives of the quantities by the parameters. by_mass: by the logarithm of the mass ratio.
    """
    problem, x = solution.problem, solution.x
    normal = x[1:3] - x[3:5]
    normal = normal / np.hypot(*normal)
    shifts = np.zeros((len(x), 8))
    for i, (ball, after) in enumerate(SIDES):
        k = problem.find_stretch(ball, after)
        if problem.motions[k].moves:
            own = slice(problem.start[k] + 2, problem.start[k] + 4)
            shifts[own, 2 * i], shifts[own, 2 * i + 1] = normal, (-normal[1], normal[0])
    unknown = ~(np.isfinite(value) & np.isfinite(slope).all(axis=1))
    slope[unknown] = 0.0
    merge = make_ball_average(slope @ solution.cov @ slope.T)
    by_mass = merge @ np.where(unknown, 0.0, by_mass)
    slope, value = merge @ slope, merge @ np.where(unknown, 0.0, value)
    value[merge[:, unknown].any(axis=1)] = np.nan
    effects = np.array([slope @ shift for shift in _camera_shifts(solution, camera)]).reshape(-1, len(slope))
    cov = slope @ solution.cov @ slope.T + effects.T @ effects
    return value, cov, slope, np.column_stack([slope @ shifts, by_mass]), effects


def _list_errors(camera: Camera) -> list[CameraError]:
    """The errors of the camera file that change velocities."""
    return [error for error in camera_errors(camera) if error.key != "ball_diameter"]


def _camera_shifts(solution: LocalSolution, camera: Camera) -> Iterator[Array]:
    """Iterate over the changes (n,) of the parameters by one error of the camera file."""
    x = solution.x
    scale, rate = np.zeros(len(x)), np.zeros(len(x))
    for k, motion in enumerate(solution.problem.motions):
        at = solution.problem.start[k]
        if motion.moves:
            scale[at + 2 : at + 4] = rate[at + 2 : at + 4] = x[at + 2 : at + 4]
        if motion.pushed and solution.problem.glide:
            scale[at + 4 : at + 6], rate[at + 4 : at + 6] = x[at + 4 : at + 6], 2 * x[at + 4 : at + 6]
        if motion.ends:
            rate[at + 6] = -1.0
    scale[5], rate[5], rate[0] = 1.0, 2.0, -x[0]
    errors = _list_errors(camera)
    warps = [error for error in errors if isinstance(error, WarpError)]
    moved = [np.stack([error.shift(s.position) for error in warps]) for s in solution.problem.stretches if warps]
    follows = iter(follow_displacements(solution, moved) if warps else ())
    for error in errors:
        if isinstance(error, WarpError):
            yield next(follows)
        else:
            yield error.share * (rate if error.key == "fps" else scale)


def _list_unseen(solution: LocalSolution, camera: Camera) -> list[str]:
    """Quantities that the stretches do not show.

    Bodies that seem to glide may be balls that slide all along, and roll after the last position. Only the camera file
    can exclude that.
    """
    problem, out = solution.problem, ["drag", "decel"]
    if problem.glide:
        never_rolls = camera.glides or camera.body != BODIES["ball"]
        return [*out, *UNSEEN_ON_AIR, *(() if never_rolls else WHEN_BOTH_ROLL)]
    for k, (stretch, motion) in enumerate(zip(problem.stretches, problem.motions, strict=True)):
        if stretch.after and motion.ends:
            ball = stretch.ball
            if not shows_end(solution, k):
                out += [f"tau{ball}", f"v{ball}f", f"w{ball}n", f"w{ball}t", "C", *WHEN_BOTH_ROLL[2:]]
        elif not stretch.after and motion.pushed:
            out += ["C", "w1n", "w1t", "w2n", "w2t"]
    return out


def _velocity(solution: LocalSolution, x: Array, ball: int, after: bool) -> Array:
    """Velocities (m, 2) at the contact, of parameters (m, n)."""
    problem = solution.problem
    k = problem.find_stretch(ball, after)
    at = problem.start[k]
    if not problem.motions[k].moves:
        return np.zeros((len(x), 2))
    if not problem.slides_first(k):
        return x[:, at + 2 : at + 4]
    tau, pull = _slide(solution, x, k)
    return np.asarray(x[:, at + 2 : at + 4] - np.minimum(tau, problem.spans[k])[:, None] * pull)


def _slide(solution: LocalSolution, x: Array, k: int) -> tuple[Array, Array]:
    """Duration (m,) of the slide with which a stretch begins, and the acceleration (m, 2) by it."""
    at = solution.problem.start[k]
    tau, size, angle = np.exp(x[:, at + 6]), np.exp(x[:, 5] + x[:, at + 4]) * GRAVITY, x[:, at + 5]
    return tau, size[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def _quantities(solution: LocalSolution, x: Array, masses: tuple[float, float]) -> Array:
    """Quantities (m, 34) of parameters (m, n): those of each ball (`make_ball_average`) and the rest of LOCAL_NAMES."""
    problem, (m1, m2) = solution.problem, np.array(masses) / np.mean(masses)
    v1i, v2i, v1o, v2o = velocities = [_velocity(solution, x, ball, after) for ball, after in SIDES]
    normal = x[:, 1:3] - x[:, 3:5]
    normal = normal / np.hypot(normal[:, 0], normal[:, 1])[:, None]
    tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
    launch = v2i - v1i
    v0 = np.hypot(launch[:, 0], launch[:, 1])
    free = np.zeros((len(x), len(FREE)))
    sine = (normal[:, 0] * launch[:, 1] - normal[:, 1] * launch[:, 0]) / v0
    heading = np.arctan2(launch[:, 1], launch[:, 0])
    free[:, 0], free[:, 1:3], free[:, 3] = x[:, 0], x[:, 1:3], heading
    free[:, 4], free[:, 5], free[:, -2:] = np.arcsin(np.clip(sine, -1, 1)), v0, v1i
    for ball, v in ((1, v1o), (2, v2o)):
        k, to = problem.find_stretch(ball, after=True), AFTER[ball]
        tau, pull = _slide(solution, x, k) if problem.slides_first(k) else (np.ones(len(x)), np.zeros((len(x), 2)))
        free[:, to : to + 2], free[:, to + 2 : to + 4], free[:, to + 4] = v, v + tau[:, None] * pull, np.log(tau)
    each = derive_from_each_ball(free, problem.priors.diameter, 0.0, (float(m1), float(m2)))
    kicks = (v1o - v1i, v2o - v2i)
    balance = m1 * kicks[0] + m2 * kicks[1]
    energy = (m1 * dot(v1o, v1o) + m2 * dot(v2o, v2o)) / (m1 * dot(v1i, v1i) + m2 * dot(v2i, v2i))
    ratio = -dot(kicks[1], normal) / dot(kicks[0], normal)
    further = [energy, dot(balance, normal), dot(balance, tangent), ratio]
    return np.column_stack([each, *velocities, *further])
