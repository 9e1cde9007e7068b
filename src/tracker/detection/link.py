"""Joins the detections of successive frames into tracks of ball centres, through collisions and missing frames.

`motion_filter` predicts each ball, also off another ball that it meets; `assignment` assigns the detections by their
likelihood.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from synthcam_shared.arrays import Array, Ints
from tracker.camera.camera import Camera
from tracker.camera.frames import pick_spread
from tracker.detection.assignment import link_frame
from tracker.detection.few_balls import follow_apart
from tracker.detection.glints import Glints, RowArrays, describe_flags
from tracker.detection.motion_filter import MotionNoise, PredictedBalls
from tracker.settings import USUAL_SPEED_M_S, USUAL_STEP_PX, LinkSettings


@dataclass(frozen=True, eq=False)
class Tracks(RowArrays):
    """Balls tracked through one clip: arrays sorted by particle, then frame."""

    frame: Ints  # (n,), as all that has no other shape
    particle: Ints
    x: Array  # centre of the ball, mean over the exposure, px; the glint where `flags` holds 'glint'
    y: Array
    cov: Array  # (n, 2, 2): covariance of the position, px^2
    flux: Array  # counts
    flags: NDArray[np.str_]  # words joined by '|'
    glint_x: Array  # px
    glint_y: Array
    fixed: Array = field(default_factory=lambda: np.empty(0))
    """(n, 2, 2): the part of ``cov`` that is the same in every frame of a ball at rest, px^2."""
    time: Array = field(default_factory=lambda: np.empty(0))
    """Start of the exposures, s; NaN where it follows from the frame rate."""

    def __post_init__(self) -> None:
        if len(self.fixed) == 0:
            object.__setattr__(self, "fixed", np.zeros_like(self.cov))
        if len(self.time) == 0:
            object.__setattr__(self, "time", np.full(len(self.frame), np.nan))

    @property
    def xy(self) -> Array:
        """Positions (n, 2), px."""
        return np.stack([self.x, self.y], axis=1)


def link_into_tracks(
    glints: Glints,
    camera: Camera,
    point: str = "glint",
    takes: Sequence[tuple[int, int]] = (),
    linker: Callable[[Glints], Ints] | None = None,
    settings: LinkSettings | None = None,
) -> Tracks:
    """Join the detections of a clip into tracks of ball centres, without those that belong to no track.

    point: what the positions are, "glint" or "centre" of an outline, whose flux is the area, px^2.
    takes: first and last frames of takes; no track leads from one to the next.
    linker: another program in place of `assign_track_numbers`, which gives the particles of glints.
    """
    settings = settings or LinkSettings()
    diameter = 2 * float(np.sqrt(np.median(glints.flux) / np.pi)) if point == "centre" and len(glints) else None
    if linker is not None:
        ids = linker(glints)
    elif len(takes) > 1:
        ids = np.full(len(glints), -1, dtype=np.int64)
        for first, last in takes:  # particles are numbered on through all takes
            rows = np.flatnonzero((glints.frame >= first) & (glints.frame <= last))
            own = assign_track_numbers(glints.take(rows), camera, diameter, settings)
            ids[rows] = np.where(own >= 0, own + ids.max(initial=-1) + 1, -1)
    else:
        ids = assign_track_numbers(glints, camera, diameter, settings)
    kept = np.flatnonzero(ids >= 0)
    order = kept[np.lexsort((glints.frame[kept], ids[kept]))]
    chosen, particle = glints.take(order), ids[order]
    x, y, flags = chosen.x, chosen.y, describe_flags(chosen.flags)
    tracks = Tracks(chosen.frame, particle, x, y, chosen.cov, chosen.flux, flags, x, y, chosen.fixed)
    return tracks if point == "centre" else to_centres(tracks, camera)


def assign_track_numbers(
    glints: Glints, camera: Camera, diameter: float | None = None, settings: LinkSettings | None = None
) -> Ints:
    """Link the detections of all frames: the number of the track (n,) to which each belongs.

    Particles count from 0 by first appearance, then by position; -1 stands for detections of no track. `diameter` is
    that of balls that are seen whole, px; without it the detections are glints.
    """
    settings = settings or LinkSettings()
    ids = np.full(len(glints), -1, dtype=np.int64)
    if len(glints) == 0:
        return ids
    tracks = _follow(glints, _expect_motion(glints, camera, diameter, settings), settings.max_gap_frames)
    least = settings.min_track_frames if diameter else 1
    for number, rows in enumerate(_keep_ball_tracks(tracks, glints, camera, least, settings)):
        ids[rows] = number
    return ids


def estimate_velocities(frame: Ints, ids: Ints, xy: Array) -> Array:
    """Estimate velocities (n, 2), px per frame, of linked detections from differences in their tracks.

    Takes frame and particle of each detection (n,), and their positions (n, 2), px. Next to a collision the differences
    before and after disagree. The result is then that of the side which agrees with the step beyond it.
    """
    out = np.zeros_like(xy)
    for number in np.unique(ids[ids >= 0]):
        rows = np.flatnonzero(ids == number)
        rows = rows[np.argsort(frame[rows], kind="stable")]
        if len(rows) < 2:
            continue
        steps = np.diff(xy[rows], axis=0) / np.diff(frame[rows])[:, None]
        before, after = np.vstack([steps[:1], steps]), np.vstack([steps, steps[-1:]])
        far_before = np.vstack([steps[:1], steps[:1], steps[:-1]])[: len(rows)]
        far_after = np.vstack([steps[1:], steps[-1:], steps[-1:]])[: len(rows)]
        rough_before, rough_after, kink = (
            np.sum(difference**2, axis=1, keepdims=True)
            for difference in (before - far_before, after - far_after, before - after)
        )
        one_sided = np.where(rough_before <= rough_after, before, after)
        out[rows] = np.where(kink > 1.0, one_sided, (before + after) / 2.0)
    return out


def _follow(glints: Glints, noise: MotionNoise, max_gap_frames: int) -> list[Ints]:
    """The rows of each track, those of false detections included."""
    order = np.argsort(glints.frame, kind="stable")
    frames, starts = np.unique(glints.frame[order], return_index=True)
    parts, xy = np.split(order, starts[1:]), glints.xy
    track = np.empty(len(glints), dtype=np.int64)
    first = len(parts[0])
    track[parts[0]] = np.arange(first)
    numbers: list[int] = frames.tolist()
    live, count, k = PredictedBalls.start(np.arange(first), numbers[0], xy[parts[0]], noise), first, 1
    while k < len(numbers):
        frame = numbers[k]
        recent = frame - live.seen <= max_gap_frames + 1
        live = live if recent.all() else live.take(recent)
        live, alone = follow_apart(live, numbers, parts, xy, k, max_gap_frames + 1, noise)
        if alone:
            own = np.concatenate(alone)
            track[own[own >= 0]] = np.tile(live.number, len(alone))[own >= 0]
            k += len(alone)
            continue
        rows = parts[k]
        coming = (xy[parts[k + 1]], numbers[k + 1] - frame) if k + 1 < len(numbers) else None
        live, own = link_frame(live, xy[rows], frame - numbers[k - 1], frame, coming, noise)
        new = np.flatnonzero(own < 0)
        if len(new):
            own[new] = count + np.arange(len(new))
            live = PredictedBalls.join([live, PredictedBalls.start(own[new], frame, xy[rows[new]], noise)])
        track[rows], count, k = own, count + len(new), k + 1
    ordered = np.lexsort((glints.frame, track))
    return np.split(ordered, np.flatnonzero(np.diff(track[ordered])) + 1)


def find_reach(camera: Camera, settings: LinkSettings) -> float:
    """Find how far a ball may move in its first frame, px, if it is not larger than that itself."""
    if camera.metric:
        return (settings.max_speed_m_s or USUAL_SPEED_M_S) / camera.fps / camera.scale
    return settings.max_step_px or USUAL_STEP_PX


def _expect_motion(glints: Glints, camera: Camera, seen_whole: float | None, settings: LinkSettings) -> MotionNoise:
    """The expected motion of balls in this film; seen_whole: their diameter, px, where they are seen whole."""
    max_acceleration_m_s2 = 3.5  # of a ball that slides
    min_error_px = 0.05  # of a position, and of its prediction
    diameter = seen_whole or camera.diameter_px
    reach = find_reach(camera, settings)
    errors = np.sqrt(np.trace(glints.cov, axis1=1, axis2=2) / 2)
    error = float(np.median(errors[np.isfinite(errors)])) if np.isfinite(errors).any() else 0.0
    push = max_acceleration_m_s2 / camera.fps**2 / camera.scale if camera.metric else 0.0
    position = max(error, min_error_px)
    return MotionNoise(
        diameter=diameter,
        reach=max(reach, (2.0 if seen_whole is None else settings.max_step_diameters) * diameter),
        position=position,
        acceleration=max(push, min_error_px, measure_acceleration(glints, position)),
        tolerance=settings.speed_tolerance if seen_whole is None else 1.0,
        restitution=settings.restitution,
        false_density=1.0 / float(np.prod(camera.size)),
    )


def measure_acceleration(glints: Glints, position_error: float) -> float:
    """Measure the typical change of a velocity from frame to frame along an axis, px per frame^2; 0 where it is small.

    Shaken, driven or magnetic bodies turn between hits, and an encoder moves positions by more than their errors. The
    change is that of steps which nobody can mistake: both are to the nearest detection, and the next one is much
    farther. The part that errors of positions explain is subtracted.
    """
    least_frames, most_frames, enough_positions = 8, 40, 4000  # many bodies in few frames show as much
    least_steps, least_bodies = 30, 3
    clear_share = 0.3  # of the distance to the second nearest detection, which such a step has at most
    seen, xy, turns = np.unique(glints.frame), glints.xy, [np.empty((0, 2))]
    wanted = min(max(least_frames, enough_positions * len(seen) // max(len(glints), 1)), most_frames)
    for frame in pick_spread(seen[:-2].tolist(), wanted) if len(seen) > 2 else []:
        here, there, then = (xy[glints.frame == frame + later] for later in range(3))
        if min(len(here), len(there), len(then)) >= least_bodies:
            first, second = _find_clear_steps(here, there, clear_share), _find_clear_steps(there, then, clear_share)
            rows = np.flatnonzero((first >= 0) & (second[first] >= 0))
            middle = first[rows]
            turns.append(then[second[middle]] - 2 * there[middle] + here[rows])
    changes = np.concatenate(turns).ravel()
    if len(changes) < 2 * least_steps:
        return 0.0
    spread = 1.4826 * float(np.median(np.abs(changes)))
    return float(np.sqrt(max(spread**2 - 6 * position_error**2, 0.0)))


def _find_clear_steps(start: Array, end: Array, clear_share: float) -> Ints:
    """The detection (n,) of the next frame to which each leads beyond doubt, or -1."""
    away, to = (np.asarray(values) for values in cKDTree(end).query(start, k=2))
    back = np.asarray(cKDTree(start).query(end)[1])
    clear = (back[to[:, 0]] == np.arange(len(start))) & (away[:, 0] < clear_share * away[:, 1])
    return np.where(clear, to[:, 0], -1)


def _keep_ball_tracks(
    tracks: list[Ints], glints: Glints, camera: Camera, min_frames: int, settings: LinkSettings
) -> list[Ints]:
    """Tracks that are balls: not much fainter than the others, and not a blip of a frame or two.

    A ball may be seen that briefly where it enters or leaves the picture, and where the film begins or ends.
    """
    edge_px = 40.0  # distance from the edge within which a ball may be seen so briefly
    length = np.array([len(rows) for rows in tracks])
    flux = np.array([np.median(glints.flux[rows]) for rows in tracks])
    long = length >= settings.min_track_frames
    least = settings.min_relative_flux * flux[long if long.any() else slice(None)].max()
    typical = float(np.median(flux[(long if long.any() else True) & (flux >= least)]))
    first, last = glints.frame.min() + settings.min_track_frames, glints.frame.max() - settings.min_track_frames
    inside = np.minimum(glints.xy, np.array(camera.size) - 1 - glints.xy).min(axis=1)
    near = (glints.frame < first) | (glints.frame > last) | (inside < edge_px)
    brief = np.array([near[rows].any() for rows in tracks]) & (0.4 * typical < flux) & (flux < 2.5 * typical)
    whole = long | brief
    kept = [tracks[k] for k in np.flatnonzero((flux >= least) & whole & (length >= min_frames))]
    return sorted(kept, key=lambda rows: (glints.frame[rows[0]], glints.x[rows[0]], glints.y[rows[0]]))


def to_centres(tracks: Tracks, camera: Camera) -> Tracks:
    """Convert tracks of linked glints to tracks of ball centres, where the camera allows; else flag them 'glint'."""
    seen = tracks.xy
    centre, jacobian = camera.centre_of_glint(seen)
    flags = tracks.flags
    if not camera.corrects_glint:
        words = {own: "|".join(filter(None, ["glint", *own.split("|")])) for own in set(flags.tolist())}
        flags = np.array([words[own] for own in flags.tolist()], dtype=np.str_)
    return replace(
        tracks,
        x=centre[:, 0].copy(),
        y=centre[:, 1].copy(),
        cov=jacobian @ tracks.cov @ jacobian.transpose(0, 2, 1),
        fixed=jacobian @ tracks.fixed @ jacobian.transpose(0, 2, 1),
        flags=flags,
        glint_x=seen[:, 0].copy(),
        glint_y=seen[:, 1].copy(),
    )
