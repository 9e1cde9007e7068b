"""A first guess of each collision's launch, from the tracker's estimates or from how the balls leave the contact."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtrc

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import pad_spins
from discrepancy.data.notes import SearchNote, SearchNoteKind
from discrepancy.data.track_checks import find_clock_start, measure_unevenness, move_to_even_times
from discrepancy.policy import current_policy
from synthcam_shared.arrays import Array, Ints
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.measurement.collision.adequacy import HIDDEN_SLIDE, MEASURED, MISFIT, TOGETHER, TOO_FEW, Flag


@dataclass(frozen=True)
class HitGuess:
    """A first guess of a contact. Times count from frame 0."""

    names: tuple[int, int]  # the particle numbers of the struck ball and of the striker
    t_c: float  # time of contact, s
    v0: float  # the striker's speed, m/s
    b: float  # the impact parameter over the diameter
    slide_ends: Array  # (2,) when the struck ball and the striker stop sliding, s
    launch: Array | None = None  # (9,) as in `discrepancy.data.launch`, where it follows from the outgoing balls


def build_collision(tracks: Tracks, row: Mapping[Any, Any], camera: Camera) -> MeasuredCollision | SearchNote:
    """Build a measured collision, with a first guess of its launch, from a row of the tracker's estimates.

    A misfit of the tracker's model is used: the search asks what that model lacks. The outgoing balls give
    the first guess if the tracker measured no collision or saw too little of the approach. A note says why a clip
    cannot be used. The row needs the number of the clip, "clip".
    """
    policy, clip = current_policy(), int(row["clip"])
    if why := _describe_lasting_contact(row):
        return SearchNote(SearchNoteKind.CONTACT_LASTS, clip, values={"why": why})
    measured, start = row["status"] in MEASURED, find_clock_start(tracks, camera)
    hit = _hit_from_estimates(row, start) if measured else guess_hit_from_outgoing(tracks, camera)
    if hit is None:
        if measured:
            return SearchNote(SearchNoteKind.NO_ESTIMATE, clip)
        return SearchNote(SearchNoteKind.NOT_MEASURED, clip, values={"status": row["status"]})
    early = tracks.frame / camera.fps + camera.exposure <= hit.t_c
    seen_before = min((early & (tracks.particle == name)).sum() for name in hit.names)
    if hit.launch is None and seen_before < policy.min_frames_before_contact:
        hit = guess_hit_from_outgoing(tracks, camera, hit.t_c)
        if hit is None:
            return SearchNote(SearchNoteKind.TOO_FEW_FRAMES, clip, values={"least": policy.min_frames_before_contact})
    tracks = replace(tracks, time=tracks.time - start)
    if (moved := measure_unevenness(tracks, camera)) > policy.max_uneven_frames:
        balls = [np.flatnonzero(tracks.particle == name) for name in hit.names]
        tracks = move_to_even_times(tracks, balls, hit.t_c, hit.slide_ends, camera)
    pair = [tracks.particle == name for name in hit.names]
    early = tracks.frame / camera.fps + camera.exposure <= hit.t_c
    rows = np.concatenate([np.flatnonzero(ball) for ball in pair])
    frame, early = tracks.frame[rows], early[rows]
    ball = np.repeat([0, 1], [pair[0].sum(), pair[1].sum()])
    xy, slope = camera.unproject(tracks.xy[rows])
    spread, steady = tracks.cov[rows], tracks.fixed[rows]
    if not np.all(np.linalg.eigvalsh(np.nan_to_num(spread - steady))[:, 0] > 0):  # NaN too
        # The tracks claim no valid error. Any size will do: the search estimates the noise in these units.
        unclaimed_px = 0.01
        spread, steady = np.tile(unclaimed_px**2 * np.eye(2), (len(rows), 1, 1)), np.zeros_like(spread)
    resting = early & (ball == 0)
    covariance, fixed = (slope @ c @ np.swapaxes(slope, 1, 2) for c in (spread, steady))
    covariance[resting] -= fixed[resting]
    launch = hit.launch
    if launch is None:
        coming = early & (ball == 1)
        launch = _guess_launch(hit, row, frame[coming], xy[coming], xy[resting].mean(axis=0), camera)
    return MeasuredCollision(
        clip=clip,
        striker=str(row["striker"]),
        camera=camera,
        frame=frame,
        ball=ball,
        xy=xy,
        covariance=covariance,
        launch=launch,
        slide_ends=hit.slide_ends,
        offset=float(np.sqrt(np.trace(fixed[resting], axis1=1, axis2=2).mean() / 2)) if resting.any() else 0.0,
        max_shift_frames=moved if moved > policy.max_uneven_frames else 0.0,
    )


def _describe_lasting_contact(row: Mapping[Any, Any]) -> str:
    """Say how a contact takes time; "" if it is an impact, or may be one of smaller balls."""
    if row["status"] == TOGETHER:
        return "the balls stay together"
    if row["status"] in (HIDDEN_SLIDE, TOO_FEW):
        return str(row["status"])
    if Flag.LASTS in str(row.get("flags", "")).split("|"):
        return f"the contact lasts {1e3 * float(row['contact_duration_s']):.3g} ms"
    return ""


def _hit_from_estimates(row: Mapping[Any, Any], start: float) -> HitGuess | None:
    """The contact by the tracker's estimates, with times from `start`, s; None where an estimate is missing."""
    names, is_rejected = ("t_c", "v0", "b", "tau1", "tau2"), row["status"] == MISFIT
    tied, free = (np.array([float(row.get(f"{n}{fit}", np.nan)) for n in names]) for fit in ("", "_free"))
    guess = np.where(is_rejected & np.isfinite(free), free, tied)  # the free fit where it alone describes the tracks
    if not np.all(np.isfinite(guess)):
        return None
    t_c = guess[0] - start
    return HitGuess((row["particle1"], row["particle2"]), t_c, guess[1], guess[2], t_c + guess[3:])


def _guess_launch(
    hit: HitGuess, row: Mapping[Any, Any], frame: Ints, coming: Array, resting: Array, camera: Camera
) -> Array:
    """The launch (9,) of a striker at positions `coming` (n, 2), m, in frames (n,), on a target at `resting`."""
    velocity = np.polyfit(frame - frame.mean(), coming, 1)[0]
    heading = float(np.arctan2(velocity[1], velocity[0]))
    d, b = np.array([np.cos(heading), np.sin(heading)]), hit.b
    n = np.sqrt(max(1 - b * b, 0.0)) * d - b * np.array([-d[1], d[0]])
    times, acceleration = frame / camera.fps, np.zeros(2)  # of few positions the acceleration is not known
    if len(times) >= current_policy().min_frames_before_contact + 2:
        acceleration = 2 * np.polyfit(times - times.mean(), coming, 2)[0]
    spins = guess_spin(row, heading, hit.v0, acceleration)
    return np.array([*(resting - camera.radius * n), hit.t_c, hit.v0, heading, b, *spins])


def guess_spin(row: Mapping[Any, Any], heading: float, v0: float, pull: Array) -> Array:
    """A first guess of the striker's spin: the last three numbers of a launch, zero where the striker rolls.

    The tracker's spin is taken where its fit holds, or fails only because the claimed errors are too small. In other
    clips the deceleration decides. A striker that slows down as a sliding ball does is taken to slide, with a slip
    of a fifth of its speed. Any other is taken to roll. pull (2,): its acceleration before the contact, m/s^2.
    """
    ahead = np.array([np.cos(heading), np.sin(heading)])
    axes = np.stack([ahead, [-ahead[1], ahead[0]]])
    slip, side = np.array([row.get("u2ix", 0.0), row.get("u2iy", 0.0)], dtype=float), float(row.get("side2i", 0.0))
    size = float(np.hypot(*pull))
    doubted = row["status"] == MISFIT and not _explains_by_errors(row)
    if doubted and size < current_policy().sliding_deceleration_m_s2:
        slip, side = np.zeros(2), 0.0
    elif doubted and not np.any(np.nan_to_num(slip)):
        slip, side = -0.2 * v0 * pull / size, 0.2 * v0
    return np.asarray(np.nan_to_num([*(axes @ slip), side]))


def _explains_by_errors(row: Mapping[Any, Any]) -> bool:
    """True if the tied fit agrees with the free one once errors are scaled to the free fit's residuals (F test)."""
    tied, dof, free, dof_free = (float(row.get(name, np.nan)) for name in ("chi2", "dof", "chi2_free", "dof_free"))
    if not (dof > dof_free > 0 and free > 0):
        return False
    return bool(chdtrc(dof - dof_free, max(tied - free, 0.0) * dof_free / free) > current_policy().spin_p_value)


def guess_hit_from_outgoing(tracks: Tracks, camera: Camera, since: float = -math.inf) -> HitGuess | None:
    """Guess the contact and the launch from the paths of two balls that leave a contact, one of which rested before.

    Both paths are traced back to the time at which the balls touch. By conservation of momentum the striker's velocity
    is the sum of both velocities there. The ball that leaves nearer to the line of centres is the target. Only frames
    after the time `since`, s, are used. None where the balls do not part as from a contact.
    """
    unsure = 2  # first frames of a ball that may precede the contact, or contain it
    step = 0.1 / camera.fps  # s; the first search for the time of contact
    xy, _ = camera.unproject(tracks.xy)
    paths, later = {}, tracks.frame / camera.fps > since
    for name in np.unique(tracks.particle).tolist():
        rows = np.flatnonzero((tracks.particle == name) & later)[unsure:]
        many = len(rows) >= current_policy().min_frames_after_hit
        if many and np.hypot(*(xy[rows[-1]] - xy[rows[0]])) > camera.radius:
            paths[int(name)] = fit_slide(tracks.frame[rows] / camera.fps + camera.exposure / 2, xy[rows])
    if len(paths) != 2:
        return None
    names, ((first, one, _), (second, two, _)) = [*paths], paths.values()
    late, reach = max(first, second), current_policy().max_unseen_frames_after_hit / camera.fps
    if abs(first - second) > reach:
        return None

    def gap(t: float) -> float:
        return float(np.hypot(*(_at(one, t - first) - _at(two, t - second)))) - 2 * camera.radius

    before = np.arange(late, late - reach, -step)
    touching = next((k for k, t in enumerate(before.tolist()) if gap(t) < 0), 0)
    if not touching:
        return None
    t_c = float(brentq(gap, before[touching], before[touching - 1]))
    at = np.array([_at(one, t_c - first), _at(two, t_c - second)])
    moved = np.array([_velocity(one, t_c - first), _velocity(two, t_c - second)])
    line = (at[1] - at[0]) / np.hypot(*(at[1] - at[0]))
    across = np.abs(moved @ [-line[1], line[0]]) / np.hypot(*moved.T)
    struck = int(across[1] < across[0])
    normal = line if struck else -line
    both = moved.sum(axis=0)
    v0 = float(np.hypot(*both))
    ahead = both / v0
    order = names[struck], names[1 - struck]
    heading, b = float(np.arctan2(ahead[1], ahead[0])), float(-normal @ [-ahead[1], ahead[0]])
    ends = np.array([paths[name][2] for name in order])
    launch = pad_spins(np.array([[*at.mean(axis=0), t_c, v0, heading, b]]))[0]
    return HitGuess(order, t_c, v0, b, ends, launch)


def fit_slide(times: Array, xy: Array) -> tuple[float, Array, float]:
    """Fit the slide of a ball that leaves a contact: first time, parabola (3, 2), highest power first, and end.

    Rolling follows on another parabola with the same velocity at the joint.
    """
    since, best = times - times[0], (np.inf, np.zeros((4, 2)), 0.0)
    for end in since[2:-3]:
        shapes = np.stack([np.ones_like(since), since, since**2, np.maximum(since - end, 0) ** 2], axis=-1)
        parts = np.linalg.lstsq(shapes, xy, rcond=None)[0]
        best = min(best, (float(((xy - shapes @ parts) ** 2).sum()), parts, float(end)), key=lambda fit: fit[0])
    return float(times[0]), best[1][2::-1], float(times[0] + best[2])


def _at(path: Array, t: float) -> Array:
    return np.asarray(path[0] * t * t + path[1] * t + path[2])


def _velocity(path: Array, t: float) -> Array:
    return np.asarray(2 * path[0] * t + path[1])
