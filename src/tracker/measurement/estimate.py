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
from tracker.measurement.camera_errors import add_camera_errors, effects_to_json, measure_contact_distance
from tracker.measurement.collision.adequacy import (
    LEVEL,
    MEASURED,
    MISFIT,
    Flag,
    flag_contact_distance,
    p_free,
)
from tracker.measurement.collision.collision_fit import CollisionFits, fit_collision
from tracker.measurement.collision.collision_model import FREE, SPIN, TARGET, TIED, tied_to_free
from tracker.measurement.collision.contacts import ContactCandidate, EarlierHit, find_contacts, prepare_contact
from tracker.measurement.collision.derived import QUANTITY_NAMES, DerivedValues
from tracker.measurement.energy_momentum import BEFORE, motion_table
from tracker.measurement.estimate_row import covariances, empty_row
from tracker.measurement.joint_fit import fit_all
from tracker.measurement.lone_ball import PARAMETERS, add_camera_errors_to_lone_ball, fit_lone_ball
from tracker.measurement.noise.position_noise import ScatterRatio, measure_scatter
from tracker.measurement.positions import BallTrack, to_ball_tracks

if TYPE_CHECKING:
    from tracker.camera.camera import Camera
    from tracker.detection.link import Tracks

__all__ = ["fit_all", "fit_collision", "measure", "motion_table", "select_claims"]

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
# Diameters, and frames' worth of approach beyond, within which balls that change track are thought to have met.
FAR_CONTACT, FAR_STEPS = 1.5, 2.0


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # a fit of what is no collision may lead anywhere
def measure(tracks: Tracks, camera: Camera) -> list[dict[str, Any]]:
    """One row per collision of a clip, in the columns of estimates.parquet without `clip`; never empty.

    SI units. status: "ok", "misfit" where the data reject the tied fit (then NAME has no error), "no_collision"
    (then v0, drag and decel of the ball that rolls), or the reason why nothing can be measured.
    """
    if not camera.metric:
        return [empty_row(camera, "no scale: lengths need a camera file, which tracker calibrate makes")]
    balls = to_ball_tracks(tracks, camera)
    if not any(len(track) >= 2 for track in balls):
        return [empty_row(camera, "too few detections")]
    size = measure_scatter(balls) if balls[0].has_errors else None
    if size is None or abs(size.sigmas) < UNLIKE:
        return _measure_balls(balls, camera)
    resized = [track.scale_errors(size) for track in balls]
    if size.ratio > 1:
        rows = _measure_balls(resized, camera)
        return _measure_between(rows, balls, size, camera) if p_free(rows, size) > 1 - LEVEL else rows
    rows = _measure_balls(balls, camera)
    slow = any(row["noise"] == "scatter" for row in rows)  # errors that last scatter little from frame to frame
    return rows if slow or not p_free(rows, size, size.ratio) > CONFIRMED else _measure_balls(resized, camera)


def _measure_between(
    wide: list[dict[str, Any]], balls: list[BallTrack], size: ScatterRatio, camera: Camera
) -> list[dict[str, Any]]:
    """The rows where free fits leave less than the scatter (by which `wide` went): it held kinks, or is uneven.

    What is claimed holds if the free fits bear it; else errors are as large as these leave.
    """
    rows = _measure_balls(balls, camera)
    if p_free(rows, replace(size, dof=np.inf)) >= LEVEL:
        return rows
    square, dof = np.sum([(row["chi2_free"], row["dof_free"]) for row in wide if row["dof_free"] > 0], axis=0)
    left = ScatterRatio(size.ratio * float(square / dof), float(dof))
    return _measure_balls([track.scale_errors(left) for track in balls], camera)


def _measure_balls(balls: list[BallTrack], camera: Camera) -> list[dict[str, Any]]:
    """The rows of a clip, its errors given."""
    noise = _noise_columns(balls[0], camera)
    if len(balls) > 1 and not camera.knows_diameter:
        return [empty_row(camera, NO_DIAMETER) | noise]
    met = find_contacts(balls, camera.ball_diameter) if len(balls) > 1 else []
    if met:
        return _measure_collisions(met, noise, camera)
    near = find_contacts(balls, FAR_CONTACT * camera.ball_diameter, FAR_STEPS) if len(balls) > 1 else []
    rows = _measure_collisions(
        near, noise, camera
    )  # a filter that smooths tracks parts the balls, or the scale is wrong
    if any(row["status"] in MEASURED for row in rows):
        return rows
    return [
        empty_row(camera, "no_collision")
        | noise
        | _lone_ball(balls, camera)
        | ({"flags": str(Flag.NO_TOUCH)} if near else {})
    ]


def _measure_collisions(met: list[ContactCandidate], noise: dict[str, Any], camera: Camera) -> list[dict[str, Any]]:
    """A row for each contact, in order of time."""
    rows, pasts = [], dict[int, EarlierHit]()
    for i, candidate in enumerate(met):
        try:
            row, left = _measure_collision(candidate, pasts, camera, i)
        except (ArithmeticError, ValueError, IndexError) as error:  # one collision never costs the others
            particles = [track.particle for track in (candidate.one, candidate.other)]
            row = empty_row(camera, failure_status(error), i) | dict(
                zip(("particle1", "particle2"), particles, strict=True)
            )
            left = {particle: EarlierHit(np.inf) for particle in particles}
        rows.append(noise | row if row["noise"] == "scatter" else row | noise)
        pasts |= left
    return rows


def failure_status(error: Exception) -> str:
    """A status that says that the arithmetic failed, and how."""
    return f"the fit failed: {(str(error).splitlines() or [type(error).__name__])[0][:80]}"


def _noise_columns(track: BallTrack, camera: Camera) -> dict[str, Any]:
    """The columns of noise where the errors come from the tracks' own scatter; empty where the table's are kept."""
    if np.isinf(track.noise_dof):
        return {}
    size = float(np.sqrt(np.trace(track.cov[0]) / 2) / camera.scale)
    ratio = track.error_scale if track.has_errors else np.nan
    return {"noise": "scatter", "noise_px": size, "noise_ratio": ratio, "noise_rho": track.rho}


def _measure_collision(
    candidate: ContactCandidate, pasts: dict[int, EarlierHit], camera: Camera, index: int
) -> tuple[dict[str, Any], dict[int, EarlierHit]]:
    """The row of one collision, and by particle what it leaves of its balls for the next."""
    contact = prepare_contact(candidate, camera.ball_diameter, pasts)
    row = empty_row(camera, contact.reason or "ok", index)
    row |= {f"particle{i}": track.particle for i, track in contact.pair.balls}
    frames = np.concatenate([track.frame for _, track in contact.pair.balls])
    row |= {"frame_first": int(frames.min()), "frame_last": int(frames.max())}
    unknown = {track.particle: EarlierHit(np.inf) for _, track in contact.pair.balls}
    if contact.reason:
        return row, unknown
    read = fit_collision(contact)
    if isinstance(read, str):
        return row | {"status": read}, unknown
    read = _with_camera_errors(read, camera)
    row |= _value_columns(read, camera) | _noise_columns(read.contact.pair.striker, camera)
    row |= _judge(read, flag_contact_distance(*measure_contact_distance(read.free, camera)))
    row |= painter_behringer.paper_columns(contact, camera)
    if row["status"] == MISFIT:
        row |= {f"{name}_paper_std": np.nan for name in QUANTITY_NAMES if name not in AT_THE_HIT}
    return (row, unknown) if row["status"] == MISFIT else (row, _earlier_hits(read, pasts))


def _with_camera_errors(read: CollisionFits, camera: Camera) -> CollisionFits:
    """The same with the errors of the camera file in both fits."""
    tied, tied_values = add_camera_errors(read.tied, read.tied_values, True, camera)
    free, free_values = add_camera_errors(read.free, read.free_values, False, camera)
    return replace(read, tied=tied, free=free, tied_values=tied_values, free_values=free_values)


def _value_columns(read: CollisionFits, camera: Camera) -> dict[str, Any]:
    """What both fits say, with errors where the data accept the fit."""
    tied, free = select_claims(read)
    common = effects_to_json(camera, {"tied": tied.shared, "free": free.shared})
    row: dict[str, Any] = {"cov": covariances({"tied": tied.cov, "free": free.cov}, QUANTITY_NAMES, common)}
    for suffix, values in (("", tied), ("_free", free)):
        for i, name in enumerate(QUANTITY_NAMES):
            row[f"{name}{suffix}"], row[f"{name}{suffix}_std"] = values.value[i], values.std[i]
    at = [TIED.index(name) for name in ("heading", "x", "y", *SPIN, *TARGET)]
    row |= dict(zip(("heading", "x1", "y1", *BEFORE), read.tied.parameters[at].tolist(), strict=True))
    for column, name in zip(BEFORE, SPIN, strict=False):
        known = name in read.contact.pair.fitted_spin and not read.is_misfit
        row[f"{column}_std"] = float(np.sqrt(read.tied.cov[TIED.index(name), TIED.index(name)])) if known else np.nan
    for suffix, fit in (("", read.tied), ("_free", read.free)):
        row |= {f"chi2{suffix}": fit.chi2, f"dof{suffix}": fit.dof, f"dropped{suffix}": fit.dropped}
    return row


def _judge(read: CollisionFits, flags: list[Flag]) -> dict[str, Any]:
    """Status, p-values and flags of a collision; `flags` are those known of its contact."""
    return {
        "status": MISFIT if read.is_misfit else "ok",
        "adequate": read.p_tied,
        "adequate_free": read.p_free,
        "agree": read.p_agree,
        "flags": "|".join([*read.flags, *flags, *read.impossible_values]),
    }


def _earlier_hits(read: CollisionFits, pasts: dict[int, EarlierHit]) -> dict[int, EarlierHit]:
    """What the hit leaves of both balls: until when they slide, by the later of both fits, and their new spin."""
    pair, tied = read.contact.pair, read.tied.parameters
    ends = [FREE.index(name) for name in ("log_tau1", "log_tau2")]
    both = (np.asarray(tied_to_free(tied, pair.spin), dtype=np.float64), read.free.parameters)
    late = np.max([free[0] + np.exp(free[ends]) for free in both], axis=0)
    beta, v0, c = (tied[TIED.index(name)] for name in ("beta", "v0", "C"))
    side = tied[TIED.index("side")]
    turn = -c * (v0 * np.sin(beta) + pair.spin + side)  # R dw = (5/2) n x J/m, the same for both
    particles, own = [track.particle for _, track in pair.balls], (0.0, side)
    return {
        p: EarlierHit(float(end), pasts.get(p, EarlierHit()).spin + float(turn + spin))
        for p, end, spin in zip(particles, late, own, strict=True)
    }


def select_claims(read: CollisionFits) -> tuple[DerivedValues, DerivedValues]:
    """What each fit claims: NaN where the clip does not show it, no errors where the data reject the fit."""
    # without an end in view, slide time and final velocity trade freely: no minimum, and none is needed
    if all(read.slide_ends_seen) and not read.free.converged:
        free_nan = set(QUANTITY_NAMES)
    else:
        free_nan = {name for ball, seen in enumerate(read.slide_ends_seen, 1) if not seen for name in NEEDS[ball]}
        if not all(read.slide_ends_seen):
            free_nan |= {*NEEDS_BOTH, "mu_k", "C"}
        for ball, name in ((1, "log_tau1"), (2, "log_tau2")):
            k = FREE.index(name)
            if (
                read.slide_ends_seen[ball - 1] and read.free.cov[k, k] > LINEAR_UP_TO**2
            ):  # too short to show how it began
                free_nan |= {*NEEDS_START, f"w{ball}n", f"w{ball}t"}
        if not _is_oblique(read.free_values.value, read.free_values.std):
            free_nan |= {"s"}
        if read.contact.pair.fitted_spin:
            free_nan |= {"C"}  # how the striker spins before the hit is not in the free fit
    tied, free = (
        _within_limits(read.tied_values, LIMITS, set()),
        _within_limits(read.free_values, FREE_LIMITS, free_nan),
    )
    if read.is_misfit:
        tied, free = tied.without_errors(QUANTITY_NAMES), free.without_errors(BY_LAWS)
    return tied, free if read.is_free_accepted else free.without_errors(QUANTITY_NAMES)


def _is_oblique(value: Floats, std: Floats) -> bool:
    """Whether the hit is oblique enough for a tangential restitution, a ratio by b, to have a meaning."""
    b = QUANTITY_NAMES.index("b")
    return bool(abs(value[b]) > 10 * std[b])


def _within_limits(values: DerivedValues, limits: dict[str, float], unseen: set[str]) -> DerivedValues:
    value, lost = values.value.copy(), []
    for i, name in enumerate(QUANTITY_NAMES):
        std = values.std[i]
        limit = limits.get(name, LINEAR_UP_TO * abs(value[i]) if not name.startswith("w") else np.inf)
        folded = name == "final_angle" and value[i] < 3 * std  # an angle cannot be negative: near zero it is biased
        if name in unseen or not np.isfinite(value[i]) or not std <= limit or folded:
            value[i] = np.nan
            lost.append(name)
    return replace(values, value=value).without_errors(lost)


def _lone_ball(balls: list[BallTrack], camera: Camera) -> dict[str, Any]:
    """What a rolling ball shows without a collision: its speed when first seen, drag and decel."""
    fits = [f for f in map(fit_lone_ball, balls) if f is not None]
    if not fits:
        return {}
    best, common = add_camera_errors_to_lone_ball(max(fits, key=lambda f: f.speed), camera)
    if best.chi2 > best.dof + UNLIKELY * np.sqrt(2 * best.dof):
        return {"status": "no collision in view, and no ball rolls freely", "chi2": best.chi2, "dof": best.dof}
    out: dict[str, Any] = {"particle2": best.particle, "chi2": best.chi2, "dof": best.dof}
    for name, value, std in best.table():
        within = std <= LIMITS.get(name, np.inf)
        out[name], out[f"{name}_std"] = (value, std) if within else (np.nan, np.nan)
    out["cov"] = covariances({"rolling": best.cov[-3:, -3:]}, PARAMETERS[-3:], common)
    return out
