"""Joins the detections of successive frames into tracks, through collisions, gaps, and balls that come and go.

A ball's position is predicted from its last velocity. Two balls cannot pass through each other: where they would meet,
the prediction lets them bounce. Detections are assigned to predictions by least squared distance (Hungarian method).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from tracker.camera.camera import Camera
from tracker.camera.lens import Array
from tracker.detection.glints import Glints, describe_flags
from tracker.settings import LinkSettings

Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Tracks:
    """Balls tracked through one clip: arrays sorted by particle, then frame.

    Attributes
    ----------
    frame, particle : ndarray of int, shape (n,)
    x, y : ndarray of shape (n,)
        Centre of the ball, mean over the exposure, px; the glint where ``flags`` holds 'glint'.
    cov : ndarray of shape (n, 2, 2)
        Covariance of the position, px^2.
    flux : ndarray of shape (n,)
        Counts.
    flags : ndarray of str, shape (n,)
        Words joined by '|'.
    glint_x, glint_y : ndarray of shape (n,)
        px.
    fixed : ndarray of shape (n, 2, 2)
        The part of ``cov`` that is the same in every frame of a ball at rest, px^2.
    time : ndarray of shape (n,)
        Start of the exposures, s; NaN where it follows from the frame rate.
    """

    frame: Ints
    particle: Ints
    x: Array
    y: Array
    cov: Array
    flux: Array
    flags: NDArray[np.str_]
    glint_x: Array
    glint_y: Array
    fixed: Array = field(default_factory=lambda: np.empty(0))
    time: Array = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        if len(self.fixed) == 0:
            object.__setattr__(self, "fixed", np.zeros_like(self.cov))
        if len(self.time) == 0:
            object.__setattr__(self, "time", np.full(len(self.frame), np.nan))

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def xy(self) -> Array:
        """Positions (n, 2), px."""
        return np.stack([self.x, self.y], axis=1)


@dataclass
class _OpenTrack:
    """A track being extended, in plain floats: there are few balls and many frames."""

    rows: list[int]
    frame: int
    x: float
    y: float
    vx: float = 0.0
    vy: float = 0.0
    moving: bool = False  # whether a velocity is known
    ahead: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    bounced: bool = False
    sure: bool = False  # off a ball that, like this one, has a trusted track
    struck: tuple[int, float, float, float, float] | None = None  # frame, position, velocity after an unseen hit


def link(
    glints: Glints,
    camera: Camera,
    point: str = "glint",
    takes: Sequence[tuple[int, int]] = (),
    linker: Callable[[Glints], Ints] | None = None,
    settings: LinkSettings | None = None,
) -> Tracks:
    """Join the detections of a clip into tracks of ball centres, without those that belong to no track.

    Parameters
    ----------
    glints : Glints
        Of all frames.
    camera : Camera
        Where it knows the lamp, the positions of glints are converted to the centres of balls.
    point : {"glint", "centre"}
        What the positions are; for centres of outlines the flux is the area, px^2.
    takes : sequence of (int, int)
        First and last frames of takes. No track leads from one to the next.
    linker : callable, optional
        Another program in place of `assign`: glints -> particles.
    settings : LinkSettings, optional
    """
    settings = settings or LinkSettings()
    diameter = 2 * float(np.sqrt(np.median(glints.flux) / np.pi)) if point == "centre" and len(glints) else None
    if linker is not None:
        ids = linker(glints)
    elif len(takes) > 1:
        ids = np.full(len(glints), -1, dtype=np.int64)
        for first, last in takes:  # particles are numbered on through all takes
            rows = np.flatnonzero((glints.frame >= first) & (glints.frame <= last))
            own = assign(glints.take(rows), camera, diameter, settings)
            ids[rows] = np.where(own >= 0, own + ids.max(initial=-1) + 1, -1)
    else:
        ids = assign(glints, camera, diameter, settings)
    kept = np.flatnonzero(ids >= 0)
    order = kept[np.lexsort((glints.frame[kept], ids[kept]))]
    chosen, particle = glints.take(order), ids[order]
    seen = chosen.xy
    if point == "centre":
        centre, jacobian, words = seen, np.broadcast_to(np.eye(2), chosen.cov.shape), describe_flags(chosen.flags)
    else:
        centre, jacobian = camera.centre_of_glint(seen)
        words = describe_flags(chosen.flags, () if camera.corrects_glint else ("glint",))
    return Tracks(
        frame=chosen.frame,
        particle=particle,
        x=centre[:, 0].copy(),
        y=centre[:, 1].copy(),
        cov=jacobian @ chosen.cov @ jacobian.transpose(0, 2, 1),
        flux=chosen.flux,
        flags=words,
        glint_x=seen[:, 0].copy(),
        glint_y=seen[:, 1].copy(),
        fixed=jacobian @ chosen.fixed @ jacobian.transpose(0, 2, 1),
    )


def assign(glints: Glints, camera: Camera, diameter: float | None = None, settings: LinkSettings | None = None) -> Ints:
    """Number the particle (n,) that each detection belongs to.

    Particles count from 0 by first appearance, then by position; -1 stands for detections of no track. `diameter` is
    that of balls that are seen whole, px; without it the detections are glints.
    """
    settings = settings or LinkSettings()
    ids = np.full(len(glints), -1, dtype=np.int64)
    if len(glints) == 0:
        return ids
    balls = _follow(glints, camera, diameter or camera.diameter_px, diameter is not None, settings)
    least = settings.min_track_frames if diameter else 1
    for number, ball in enumerate(_keep_ball_tracks(balls, glints, least, settings)):
        ids[ball.rows] = number
    return ids


def estimate_velocities(frame: Ints, ids: Ints, xy: Array) -> Array:
    """Velocities (n, 2), px per frame, of detections from differences within their tracks; 0 in a track of one.

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


def _follow(
    glints: Glints, camera: Camera, diameter: float, seen_whole: bool, settings: LinkSettings
) -> list[_OpenTrack]:
    """All tracks, those of false detections included."""
    reach = settings.max_speed_m_s / camera.fps / camera.scale if camera.metric else settings.max_step_px
    reach = max(reach, (settings.max_step_diameters if seen_whole else 2.0) * diameter)
    tolerance = 1.0 if seen_whole else settings.speed_tolerance
    kept_for = settings.max_gap_frames + 1
    order = np.argsort(glints.frame, kind="stable")
    frames, starts = np.unique(glints.frame[order], return_index=True)
    x, y = glints.x.tolist(), glints.y.tolist()
    done: list[_OpenTrack] = []
    live: list[_OpenTrack] = []
    for k, rows in zip(frames.tolist(), np.split(order, starts[1:]), strict=True):
        done += [b for b in live if k - b.frame > kept_for]
        live = [b for b in live if k - b.frame <= kept_for]
        _predict(live, k, diameter, settings)
        found = rows.tolist()
        gates = [_gate(b, k, reach, 0.6 * diameter, tolerance) ** 2 for b in live]
        pairs = _match(live, found, x, y, gates)
        for ball, row in pairs:
            _extend(ball, row, k, x[row], y[row])
        taken, seen = {row for _, row in pairs}, {id(ball) for ball, _ in pairs}
        for ball in live:
            if ball.bounced and ball.sure and id(ball) not in seen and ball.struck is None:
                ball.struck = (k, *ball.ahead)
        live += [_OpenTrack([row], k, x[row], y[row]) for row in found if row not in taken]
    return done + live


def _predict(live: list[_OpenTrack], frame: int, diameter: float, settings: LinkSettings) -> None:
    """Predict position and velocity of each ball, with the bounces of pairs that meet before."""
    for ball in live:
        since, x, y, vx, vy = ball.struck or (ball.frame, ball.x, ball.y, ball.vx, ball.vy)
        ball.ahead = (x + vx * (frame - since), y + vy * (frame - since), vx, vy)
        ball.bounced = ball.struck is not None
    free = [ball for ball in live if ball.struck is None]
    for i, one in enumerate(free):
        for two in free[i + 1 :]:
            _bounce(one, two, frame, diameter, settings)


def _bounce(one: _OpenTrack, two: _OpenTrack, frame: int, diameter: float, settings: LinkSettings) -> None:
    """Let two balls bounce along their line of centres, if they meet before ``frame``."""
    span = frame - max(one.frame, two.frame)
    ax, ay = one.x + one.vx * (frame - span - one.frame), one.y + one.vy * (frame - span - one.frame)
    bx, by = two.x + two.vx * (frame - span - two.frame), two.y + two.vy * (frame - span - two.frame)
    dx, dy, ux, uy = bx - ax, by - ay, two.vx - one.vx, two.vy - one.vy
    closing, gap = dx * ux + dy * uy, dx * dx + dy * dy - diameter**2
    speed = ux * ux + uy * uy
    root = closing * closing - speed * gap
    if closing >= 0.0 or root <= 0.0 or speed == 0.0:
        return
    wait = max(0.0, (-closing - math.sqrt(root)) / speed)
    if wait >= span:
        return
    nx, ny = dx + ux * wait, dy + uy * wait
    length = math.hypot(nx, ny) or 1.0
    nx, ny = nx / length, ny / length
    push = 0.5 * (1.0 + settings.restitution) * (ux * nx + uy * ny)
    left = span - wait
    x, y, vx, vy = one.ahead
    one.ahead = (x + push * nx * left, y + push * ny * left, vx + push * nx, vy + push * ny)
    x, y, vx, vy = two.ahead
    two.ahead = (x - push * nx * left, y - push * ny * left, vx - push * nx, vy - push * ny)
    one.bounced = two.bounced = True
    one.sure = two.sure = min(len(one.rows), len(two.rows)) >= settings.min_track_frames


def _match(
    live: list[_OpenTrack], found: list[int], x: list[float], y: list[float], gates: list[float]
) -> list[tuple[_OpenTrack, int]]:
    """Pairs of ball and detection of least summed squared distance, none further apart than its gate, px^2."""
    if not live or not found:
        return []
    cost = [[(b.ahead[0] - x[r]) ** 2 + (b.ahead[1] - y[r]) ** 2 for r in found] for b in live]
    if len(live) == len(found) == 1:
        chosen = [(0, 0)]
    else:
        capped = [[min(c, g) for c in line] for line, g in zip(cost, gates, strict=True)]
        rows, columns = linear_sum_assignment(np.array(capped))
        chosen = list(zip(rows.tolist(), columns.tolist(), strict=True))
    return [(live[i], found[j]) for i, j in chosen if cost[i][j] < gates[i]]


def _gate(ball: _OpenTrack, frame: int, reach: float, least: float, tolerance: float) -> float:
    """How far a detection may be from a ball's predicted position, px."""
    span = frame - ball.frame
    if not ball.moving:
        return reach * span
    speed = math.hypot(ball.vx, ball.vy)
    return (least + (1.0 if ball.bounced else tolerance) * speed) * span


def _extend(ball: _OpenTrack, row: int, frame: int, x: float, y: float) -> None:
    """Append a detection to a track."""
    span = frame - ball.frame
    if ball.bounced:  # a difference across the bounce is not a velocity
        ball.vx, ball.vy = ball.ahead[2:]
    else:
        ball.vx, ball.vy = (x - ball.x) / span, (y - ball.y) / span
    ball.moving, ball.struck = True, None
    ball.rows.append(row)
    ball.frame, ball.x, ball.y = frame, x, y


def _keep_ball_tracks(
    balls: list[_OpenTrack], glints: Glints, min_frames: int, settings: LinkSettings
) -> list[_OpenTrack]:
    """Tracks that are balls: not much fainter than the others, and not a blip of a frame or two."""
    long = [b for b in balls if len(b.rows) >= settings.min_track_frames] or balls
    fluxes = {id(b): float(np.median(glints.flux[b.rows])) for b in balls}
    brightest = max(fluxes[id(b)] for b in long)
    typical = float(np.median([fluxes[id(b)] for b in long if fluxes[id(b)] >= settings.min_relative_flux * brightest]))
    kept = []
    for ball in balls:
        flux = fluxes[id(ball)]
        whole = len(ball.rows) >= settings.min_track_frames or 0.4 * typical < flux < 2.5 * typical
        if flux >= settings.min_relative_flux * brightest and whole and len(ball.rows) >= min_frames:
            kept.append(ball)
    return sorted(kept, key=lambda b: (glints.frame[b.rows[0]], glints.x[b.rows[0]], glints.y[b.rows[0]]))
