"""From the tracks of one clip to its physics: r, mu_k, C, slide times, energy, momentum, with standard errors.

Three readings stand beside each other: NAME from the tied fit (one physical model of impact, sliding and rolling),
NAME_free from the free fit (any velocities and slide times after the hit), NAME_paper from the paper's finite
differences. Where the first two disagree, the model is wrong. What a clip does not show is NaN.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tracker.measurement import painter_behringer
from tracker.measurement.camera_errors import carry, shared_block, touching
from tracker.measurement.collision.adequacy import LEVEL, MEASURED, MISFIT, NO_TOUCH, distant, p_free, questioned
from tracker.measurement.collision.collision_fit import Reading, interpret
from tracker.measurement.collision.collision_model import FREE, SPIN, TARGET, TIED, release
from tracker.measurement.collision.contacts import Meeting, Past, encounter, meetings
from tracker.measurement.collision.derived import NAMES, Values
from tracker.measurement.energy_momentum import BEFORE, motion_table
from tracker.measurement.estimate_row import covariances, unmeasured
from tracker.measurement.joint_fit import fit_all
from tracker.measurement.noise.position_noise import Size, scatter
from tracker.measurement.positions import Course, courses
from tracker.measurement.rolling_ball import PARAMETERS, carry_alone, roll_alone

if TYPE_CHECKING:
    from tracker.camera.camera import Camera
    from tracker.detection.link import Tracks

__all__ = ["claims", "fit_all", "interpret", "measure", "motion_table"]

Floats = NDArray[np.float64]

LINEAR_UP_TO = 0.2  # a relative error above this, and first-order errors no longer describe the estimate
# quantities whose size may be zero have limits of their own, in their own units
LIMITS = {"b": 0.05, "t_c": np.inf, "s": 0.1, "r": 0.05, "C": 0.05, "final_angle": 0.1}
LIMITS |= {"energy_fraction": 0.05, "momentum_fraction": 0.05, "drag": 2.0, "decel": 0.2}
FREE_LIMITS = LIMITS | {"r": 0.02}
NEEDS = {  # what falls with a slide end that the clip does not show, by ball
    1: ("tau1", "v1f", "w1n", "w1t"),
    2: ("tau2", "v2f", "w2n", "w2t"),
}
NEEDS_START = ("r", "s", "mu_k", "C")  # what falls with a slide too short to show the velocity just after the hit
BY_LAWS = ("C", "w1n", "w1t", "w2n", "w2t")  # what the free fit infers of spins by laws that a misfit puts in doubt
AT_THE_HIT = ("t_c", "v0", "b", "r", "s")  # what differences show whatever the balls do afterwards
NEEDS_BOTH = ("energy_fraction", "momentum_fraction", "final_angle")
UNLIKELY = 10.0  # standard deviations of chi^2 beyond which a lone ball was not rolling freely
NO_DIAMETER = "no ball_diameter in the camera file: a collision is measured by where balls of that diameter touch"
UNLIKE = 5.0  # standard errors by which the tracks' own scatter differs from what a table claims
CONFIRMED = 1e-3  # p-value from which on whole fits confirm that errors are smaller than claimed
# Diameters, and frames' worth of approach beyond, within which balls that change course are thought to have met.
FAR_CONTACT, FAR_STEPS = 1.5, 2.0


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # a fit of what is no collision may lead anywhere
def measure(tracks: Tracks, camera: Camera) -> list[dict[str, Any]]:
    """One row per collision of a clip, in the columns of estimates.parquet without `clip`; never empty.

    SI units. status: "ok", "misfit" where the data reject the tied fit (then NAME has no error), "no_collision"
    (then v0, drag and decel of the ball that rolls), or the reason why nothing can be measured.
    """
    if not camera.metric:
        return [unmeasured(camera, "no scale: lengths need a camera file, which tracker calibrate makes")]
    balls = courses(tracks, camera)
    if not any(len(course) >= 2 for course in balls):
        return [unmeasured(camera, "too few detections")]
    size = scatter(balls) if balls[0].weighed else None
    if size is None or abs(size.sigmas) < UNLIKE:
        return _rows(balls, camera)
    resized = [course.resized(size) for course in balls]
    if size.ratio > 1:
        rows = _rows(resized, camera)
        return _between(rows, balls, size, camera) if p_free(rows, size) > 1 - LEVEL else rows
    rows = _rows(balls, camera)
    slow = any(row["noise"] == "scatter" for row in rows)  # errors that last scatter little from frame to frame
    return rows if slow or not p_free(rows, size, size.ratio) > CONFIRMED else _rows(resized, camera)


def _between(wide: list[dict[str, Any]], balls: list[Course], size: Size, camera: Camera) -> list[dict[str, Any]]:
    """The rows where free fits leave less than the scatter (by which `wide` went): it held kinks, or is uneven.

    What is claimed holds if the free fits bear it; else errors are as large as these leave.
    """
    rows = _rows(balls, camera)
    if p_free(rows, replace(size, dof=np.inf)) >= LEVEL:
        return rows
    square, dof = np.sum([(row["chi2_free"], row["dof_free"]) for row in wide if row["dof_free"] > 0], axis=0)
    left = Size(size.ratio * float(square / dof), float(dof))
    return _rows([course.resized(left) for course in balls], camera)


def _rows(balls: list[Course], camera: Camera) -> list[dict[str, Any]]:
    """The rows of a clip, its errors given."""
    noise = _noise(balls[0], camera)
    if len(balls) > 1 and not camera.knows_diameter:
        return [unmeasured(camera, NO_DIAMETER) | noise]
    met = meetings(balls, camera.ball_diameter) if len(balls) > 1 else []
    if met:
        return _collisions(met, noise, camera)
    near = meetings(balls, FAR_CONTACT * camera.ball_diameter, FAR_STEPS) if len(balls) > 1 else []
    rows = _collisions(near, noise, camera)  # a filter that smooths tracks parts the balls, or the scale is wrong
    if any(row["status"] in MEASURED for row in rows):
        return rows
    return [unmeasured(camera, "no_collision") | noise | _alone(balls, camera) | ({"flags": NO_TOUCH} if near else {})]


def _collisions(met: list[Meeting], noise: dict[str, Any], camera: Camera) -> list[dict[str, Any]]:
    """A row for each contact, in order of time."""
    rows, pasts = [], dict[int, Past]()
    for i, meeting in enumerate(met):
        try:
            row, left = _collision(meeting, pasts, camera, i)
        except (ArithmeticError, ValueError, IndexError) as error:  # one collision never costs the others
            particles = [course.particle for course in (meeting.one, meeting.other)]
            row = unmeasured(camera, failure(error), i) | dict(zip(("particle1", "particle2"), particles, strict=True))
            left = {particle: Past(np.inf) for particle in particles}
        rows.append(noise | row if row["noise"] == "scatter" else row | noise)
        pasts |= left
    return rows


def failure(error: Exception) -> str:
    """A status that says that the arithmetic failed, and how."""
    return f"the fit failed: {(str(error).splitlines() or [type(error).__name__])[0][:80]}"


def _noise(course: Course, camera: Camera) -> dict[str, Any]:
    """The columns of noise where the errors come from the tracks' own scatter; empty where the table's are kept."""
    if np.isinf(course.known):
        return {}
    size = float(np.sqrt(np.trace(course.cov[0]) / 2) / camera.scale)
    ratio = course.stretch if course.weighed else np.nan
    return {"noise": "scatter", "noise_px": size, "noise_ratio": ratio, "noise_rho": course.rho}


def _collision(
    meeting: Meeting, pasts: dict[int, Past], camera: Camera, index: int
) -> tuple[dict[str, Any], dict[int, Past]]:
    """The row of one collision, and by particle what it leaves of its balls for the next."""
    met = encounter(meeting, camera.ball_diameter, pasts)
    row = unmeasured(camera, met.reason or "ok", index)
    row |= {f"particle{i}": course.particle for i, course in met.pair.balls}
    frames = np.concatenate([course.frame for _, course in met.pair.balls])
    row |= {"frame_first": int(frames.min()), "frame_last": int(frames.max())}
    unknown = {course.particle: Past(np.inf) for _, course in met.pair.balls}
    if met.reason:
        return row, unknown
    read = interpret(met)
    if isinstance(read, str):
        return row | {"status": read}, unknown
    read = _carried(read, camera)
    row |= _values(read, camera) | _noise(read.meeting.pair.striker, camera)
    row |= _judged(read, distant(*touching(read.free, camera)))
    row |= painter_behringer.columns(met, camera)
    if row["status"] == MISFIT:
        row |= {f"{name}_paper_std": np.nan for name in NAMES if name not in AT_THE_HIT}
    return (row, unknown) if row["status"] == MISFIT else (row, _left(read, pasts))


def _carried(read: Reading, camera: Camera) -> Reading:
    """The same with the errors of the camera file in both fits."""
    tied, of_tied = carry(read.tied, read.of_tied, True, camera)
    free, of_free = carry(read.free, read.of_free, False, camera)
    return replace(read, tied=tied, free=free, of_tied=of_tied, of_free=of_free)


def _values(read: Reading, camera: Camera) -> dict[str, Any]:
    """What both fits say, with errors where the data accept the fit."""
    tied, free = claims(read)
    common = shared_block(camera, {"tied": tied.shared, "free": free.shared})
    row: dict[str, Any] = {"cov": covariances({"tied": tied.cov, "free": free.cov}, NAMES, common)}
    for suffix, values in (("", tied), ("_free", free)):
        for i, name in enumerate(NAMES):
            row[f"{name}{suffix}"], row[f"{name}{suffix}_std"] = values.value[i], values.std[i]
    at = [TIED.index(name) for name in ("heading", "x", "y", *SPIN, *TARGET)]
    row |= dict(zip(("heading", "x1", "y1", *BEFORE), read.tied.parameters[at].tolist(), strict=True))
    for column, name in zip(BEFORE, SPIN, strict=False):
        known = name in read.meeting.pair.spun and read.accepted[0]
        row[f"{column}_std"] = float(np.sqrt(read.tied.cov[TIED.index(name), TIED.index(name)])) if known else np.nan
    for suffix, fit in (("", read.tied), ("_free", read.free)):
        row |= {f"chi2{suffix}": fit.chi2, f"dof{suffix}": fit.dof, f"dropped{suffix}": fit.dropped}
    return row


def _judged(read: Reading, flag: str) -> dict[str, Any]:
    """Whether the data accept the fits, and what of the tied one is impossible, after a flag that is known."""
    stretch = float(np.sqrt(max(1.0, read.tied.chi2 / read.tied.dof)))
    return {
        "status": "ok" if read.accepted[0] else MISFIT, "adequate": read.adequate, "adequate_free": read.adequate_free,
        "agree": read.agree, "flags": "|".join(filter(None, [*read.flags, flag, questioned(read.of_tied, stretch)])),
    }  # fmt: skip


def _left(read: Reading, pasts: dict[int, Past]) -> dict[int, Past]:
    """What the hit leaves of both balls: until when they slide, by the later of both fits, and their new spin."""
    pair, tied = read.meeting.pair, read.tied.parameters
    ends = [FREE.index(name) for name in ("log_tau1", "log_tau2")]
    both = (np.asarray(release(tied, pair.spin), dtype=np.float64), read.free.parameters)
    late = np.max([free[0] + np.exp(free[ends]) for free in both], axis=0)
    beta, v0, c = (tied[TIED.index(name)] for name in ("beta", "v0", "C"))
    side = tied[TIED.index("side")]
    turn = -c * (v0 * np.sin(beta) + pair.spin + side)  # R dw = (5/2) n x J/m, the same for both
    particles, own = [course.particle for _, course in pair.balls], (0.0, side)
    return {
        p: Past(float(end), pasts.get(p, Past()).spin + float(turn + spin))
        for p, end, spin in zip(particles, late, own, strict=True)
    }


def claims(read: Reading) -> tuple[Values, Values]:
    """What each fit claims: NaN where the clip does not show it, no errors where the data reject the fit."""
    # without an end in view, slide time and final velocity trade freely: no minimum, and none is needed
    if all(read.slides_seen) and not read.free.converged:
        free_nan = set(NAMES)
    else:
        free_nan = {name for ball, seen in enumerate(read.slides_seen, 1) if not seen for name in NEEDS[ball]}
        if not all(read.slides_seen):
            free_nan |= {*NEEDS_BOTH, "mu_k", "C"}
        for ball, name in ((1, "log_tau1"), (2, "log_tau2")):
            k = FREE.index(name)
            if read.slides_seen[ball - 1] and read.free.cov[k, k] > LINEAR_UP_TO**2:  # too short to show how it began
                free_nan |= {*NEEDS_START, f"w{ball}n", f"w{ball}t"}
        if not _bent(read.of_free.value, read.of_free.std):
            free_nan |= {"s"}
        if read.meeting.pair.spun:
            free_nan |= {"C"}  # how the striker spins before the hit is not in the free fit
    tied, free = _claimed(read.of_tied, LIMITS, set()), _claimed(read.of_free, FREE_LIMITS, free_nan)
    if not read.accepted[0]:
        tied, free = tied.without_errors(NAMES), free.without_errors(BY_LAWS)
    return tied, free if read.accepted[1] else free.without_errors(NAMES)


def _bent(value: Floats, std: Floats) -> bool:
    """Whether the hit is oblique enough for a tangential restitution, a ratio by b, to have a meaning."""
    b = NAMES.index("b")
    return bool(abs(value[b]) > 10 * std[b])


def _claimed(values: Values, limits: dict[str, float], unseen: set[str]) -> Values:
    value, lost = values.value.copy(), []
    for i, name in enumerate(NAMES):
        std = values.std[i]
        limit = limits.get(name, LINEAR_UP_TO * abs(value[i]) if not name.startswith("w") else np.inf)
        folded = name == "final_angle" and value[i] < 3 * std  # an angle cannot be negative: near zero it is biased
        if name in unseen or not np.isfinite(value[i]) or not std <= limit or folded:
            value[i] = np.nan
            lost.append(name)
    return replace(values, value=value).without_errors(lost)


def _alone(balls: list[Course], camera: Camera) -> dict[str, Any]:
    """What a rolling ball shows without a collision: its speed when first seen, drag and decel."""
    fits = [f for f in map(roll_alone, balls) if f is not None]
    if not fits:
        return {}
    best, common = carry_alone(max(fits, key=lambda f: f.speed), camera)
    if best.chi2 > best.dof + UNLIKELY * np.sqrt(2 * best.dof):
        return {"status": "no collision in view, and no ball rolls freely", "chi2": best.chi2, "dof": best.dof}
    out: dict[str, Any] = {"particle2": best.particle, "chi2": best.chi2, "dof": best.dof}
    for name, value, std in best.table():
        within = std <= LIMITS.get(name, np.inf)
        out[name], out[f"{name}_std"] = (value, std) if within else (np.nan, np.nan)
    out["cov"] = covariances({"rolling": best.cov[-3:, -3:]}, PARAMETERS[-3:], common)
    return out
