"""Joins the detections of successive frames into tracks of ball centres, through collisions and missing frames.

`motion_filter` predicts each ball, also off another ball that it meets; `assignment` assigns the detections by their
likelihood.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.camera.camera import Camera
from tracker.detection.following.assignment import link_frame
from tracker.detection.following.few_balls import follow_apart
from tracker.detection.following.motion_filter import UNBOUNDED, MotionNoise, PredictedBalls
from tracker.detection.following.shown_motion import measure_motion
from tracker.detection.following.unseen_turns import find_unseen_turns
from tracker.detection.glints import Glints, PositionFlag, RowArrays, describe_flags
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


@dataclass(frozen=True, eq=False)
class Links:
    """The tracks of n detections."""

    ids: Ints  # (n,) number of the track of each, or -1
    doubtful: Flags  # (n,) from this one on its track may be that of another ball

    @classmethod
    def none(cls, count: int) -> Links:
        """Detections that belong to no track."""
        return cls(np.full(count, -1, dtype=np.int64), np.zeros(count, dtype=bool))


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
    links = Links.none(len(glints))
    if linker is not None:
        links = replace(links, ids=linker(glints))
    elif len(takes) > 1:
        for first, last in takes:  # particles are numbered on through all takes
            rows = np.flatnonzero((glints.frame >= first) & (glints.frame <= last))
            own = link_detections(glints.take(rows), camera, diameter, settings)
            links.doubtful[rows] = own.doubtful
            links.ids[rows] = np.where(own.ids >= 0, own.ids + links.ids.max(initial=-1) + 1, -1)
    else:
        links = link_detections(glints, camera, diameter, settings)
    kept = np.flatnonzero(links.ids >= 0)
    order = kept[np.lexsort((glints.frame[kept], links.ids[kept]))]
    chosen, particle = glints.take(order), links.ids[order]
    x, y = chosen.x, chosen.y
    flags = describe_flags(chosen.flags | np.where(links.doubtful[order], PositionFlag.EXCHANGE, 0))
    tracks = Tracks(chosen.frame, particle, x, y, chosen.cov, chosen.flux, flags, x, y, chosen.fixed)
    return tracks if point == "centre" else to_centres(tracks, camera)


def assign_track_numbers(
    glints: Glints, camera: Camera, diameter: float | None = None, settings: LinkSettings | None = None
) -> Ints:
    """Link the detections of all frames: the number of the track (n,) to which each belongs, as `link_detections`."""
    return link_detections(glints, camera, diameter, settings).ids


def link_detections(
    glints: Glints, camera: Camera, diameter: float | None = None, settings: LinkSettings | None = None
) -> Links:
    """Link the detections of all frames.

    Particles count from 0 by first appearance, then by position; -1 stands for detections of no track. `diameter` is
    that of balls that are seen whole, px; without it the detections are glints.
    """
    settings = settings or LinkSettings()
    links = Links.none(len(glints))
    if len(glints) == 0:
        return links
    noise = _expect_motion(glints, camera, diameter, settings)
    followed = _follow(glints, noise, settings.max_gap_frames)
    least = settings.min_track_frames if diameter else 1
    for number, rows in enumerate(_keep_ball_tracks(followed.tracks, glints, camera, least, settings)):
        links.ids[rows] = number
    for frame, *pair in followed.doubts.tolist():
        later = [followed.tracks[number][glints.frame[followed.tracks[number]] >= frame] for number in pair]
        if all(len(rows) and links.ids[rows[0]] >= 0 for rows in later):
            links.doubtful[[rows[0] for rows in later]] = True
    links.doubtful[find_unseen_turns(glints.frame, links.ids, glints.xy, camera.size, noise.diameter)] = True
    return links


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


@dataclass(frozen=True, eq=False)
class _FollowedBalls:
    """Tracks before false ones are dropped."""

    tracks: list[Ints]  # the rows of each, by frame
    doubts: Ints  # (d, 3): a frame, and two tracks that may have exchanged their balls there


def _follow(glints: Glints, noise: MotionNoise, max_gap_frames: int) -> _FollowedBalls:
    """Follow all that is detected, false detections included."""
    order = np.argsort(glints.frame, kind="stable")
    frames, starts = np.unique(glints.frame[order], return_index=True)
    parts, xy = np.split(order, starts[1:]), glints.xy
    track, doubts = np.empty(len(glints), dtype=np.int64), [np.empty((0, 3), dtype=np.int64)]
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
        linked = link_frame(live, xy[rows], frame - numbers[k - 1], frame, coming, noise)
        live, own = linked.balls, linked.track
        doubts.append(np.insert(linked.doubts, 0, frame, axis=1))
        new = np.flatnonzero(own < 0)
        if len(new):
            own[new] = count + np.arange(len(new))
            live = PredictedBalls.join([live, PredictedBalls.start(own[new], frame, xy[rows[new]], noise)])
        track[rows], count, k = own, count + len(new), k + 1
    ordered = np.lexsort((glints.frame, track))
    tracks = np.split(ordered, np.flatnonzero(np.diff(track[ordered])) + 1)
    return _FollowedBalls(tracks, np.concatenate(doubts))


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
    shown = measure_motion(glints, max(error, min_error_px))
    bounds = *glints.xy.min(axis=0).tolist(), *glints.xy.max(axis=0).tolist()
    return MotionNoise(
        diameter=diameter,
        reach=max(reach, (2.0 if seen_whole is None else settings.max_step_diameters) * diameter),
        position=shown.position_error,
        acceleration=max(push, min_error_px, shown.acceleration),
        fall=shown.fall,
        usual_step=shown.step,
        usual_share=shown.usual_share,
        bounds=bounds if seen_whole else UNBOUNDED,  # false glints are too many for that
        hidden_hits=seen_whole is not None,
        tolerance=settings.speed_tolerance if seen_whole is None else 1.0,
        restitution=settings.restitution,
        false_density=1.0 / float(np.prod(camera.size)),
    )


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
