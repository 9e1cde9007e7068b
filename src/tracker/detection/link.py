"""Joins glints of successive frames into tracks, through collisions, gaps, and balls that come and go.

A ball is expected where its last velocity takes it, and, since two balls cannot pass through each other, where a
bounce takes it if they would meet on the way. Glints go to expectations by least squared distance (Hungarian).
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

Ints = NDArray[np.int64]

MAX_GAP = 5  # frames a ball may stay unseen
SHORT = 3  # tracks of fewer frames need the brightness of a ball
FAINT = 0.25  # of the brightest track's flux: balls are alike and under one lamp
LOOSE = 0.35  # of the speed, by which a glint may be off where it is expected; of outlines, of which few are false, all
WIDE = 5.0  # diameters, that a ball seen by its outline may move in a frame
BOUNCE = 0.9  # normal restitution assumed in an expectation
FASTEST = 1.0  # m/s, for a ball seen once
DEFAULT_REACH = 30.0  # px, the same where no camera file ties pixels to metres; or twice the diameter


@dataclass(frozen=True, eq=False)
class Tracks:
    """Balls followed through one clip; flat arrays (n,) sorted by (particle, frame).

    ``x``, ``y`` px: ball centre, mean over the exposure, or the glint where ``flags`` says 'glint'; ``cov``
    (n, 2, 2) px^2, and ``fixed`` the part of it that a ball at rest has in every frame alike; ``flux`` counts;
    ``flags`` words joined by '|'; ``glint_x``, ``glint_y`` px; ``time`` s, of the exposures' start, NaN where the frame
    rate gives it.
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
        """(n, 2) px."""
        return np.stack([self.x, self.y], axis=1)


@dataclass
class _OpenTrack:
    """A track being extended: plain floats, for there are few balls and many frames."""

    rows: list[int]
    frame: int
    x: float
    y: float
    vx: float = 0.0
    vy: float = 0.0
    moving: bool = False  # whether a velocity is known
    ahead: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    bounced: bool = False
    sure: bool = False  # off a ball that, like this one, was followed before
    struck: tuple[int, float, float, float, float] | None = None  # frame, place, velocity after a hit not seen since


def link(
    glints: Glints,
    camera: Camera,
    point: str = "glint",
    takes: Sequence[tuple[int, int]] = (),
    by: Callable[[Glints], Ints] | None = None,
) -> Tracks:
    """Join the glints of a clip into tracks of ball centres.

    Parameters
    ----------
    glints : Glints
        Of all frames.
    camera : Camera
        Where it knows the lamp, glints are taken to the centres of balls.
    point : str
        "glint"; or "centre" where centres of outlines were found, whose flux is the area, px^2.
    takes : sequence of (int, int)
        First and last frames of takes: no track goes from one to the next.
    by : callable, optional
        Another program, in place of `assign`: glints -> particles.

    Returns
    -------
    Tracks
        By particle, then frame; glints that belong to no track are left out.
    """
    diameter = 2 * float(np.sqrt(np.median(glints.flux) / np.pi)) if point == "centre" and len(glints) else None
    if by is not None:
        ids = by(glints)
    else:
        ids = _by_take(glints, camera, diameter, takes) if len(takes) > 1 else assign(glints, camera, diameter)
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


def _by_take(glints: Glints, camera: Camera, diameter: float | None, takes: Sequence[tuple[int, int]]) -> Ints:
    """`assign` in each take, first to last frame, apart: particles go on counting."""
    ids = np.full(len(glints), -1, dtype=np.int64)
    for first, last in takes:
        rows = np.flatnonzero((glints.frame >= first) & (glints.frame <= last))
        own = assign(glints.take(rows), camera, diameter)
        ids[rows] = np.where(own >= 0, own + ids.max(initial=-1) + 1, -1)
    return ids


def assign(glints: Glints, camera: Camera, diameter: float | None = None) -> Ints:
    """Number the particle that each glint belongs to.

    Parameters
    ----------
    glints : Glints
    camera : Camera
    diameter : float, optional
        Of the balls as seen, px; default: the camera's.

    Returns
    -------
    (n,) int array
        From 0 by first appearance, then position; -1 for glints of no track.
    """
    ids = np.full(len(glints), -1, dtype=np.int64)
    if len(glints) == 0:
        return ids
    balls = _follow(glints, camera, diameter or camera.diameter_px, seen_whole=diameter is not None)
    for number, ball in enumerate(_keep_ball_tracks(balls, glints, SHORT if diameter else 1)):
        ids[ball.rows] = number
    return ids


def estimate_velocities(frame: Ints, ids: Ints, xy: Array) -> Array:
    """Velocities of glints by differences within their tracks.

    Next to a collision the two sides disagree: then the side is taken that agrees with the step beyond it.

    Parameters
    ----------
    frame, ids : (n,) int array
        Frame and particle of each glint.
    xy : (n, 2) array
        px.

    Returns
    -------
    (n, 2) array
        px a frame; 0 for a glint alone.
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
        rough_before = np.sum((before - far_before) ** 2, axis=1, keepdims=True)
        rough_after = np.sum((after - far_after) ** 2, axis=1, keepdims=True)
        kink = np.sum((before - after) ** 2, axis=1, keepdims=True) > 1.0
        one_sided = np.where(rough_before <= rough_after, before, after)
        out[rows] = np.where(kink, one_sided, (before + after) / 2.0)
    return out


def _follow(glints: Glints, camera: Camera, diameter: float, seen_whole: bool) -> list[_OpenTrack]:
    reach = FASTEST / camera.fps / camera.scale if camera.metric else DEFAULT_REACH
    reach = max(reach, (WIDE if seen_whole else 2.0) * diameter)
    loose = 1.0 if seen_whole else LOOSE
    order = np.argsort(glints.frame, kind="stable")
    frames, starts = np.unique(glints.frame[order], return_index=True)
    x, y = glints.x.tolist(), glints.y.tolist()
    done: list[_OpenTrack] = []
    live: list[_OpenTrack] = []
    for k, rows in zip(frames.tolist(), np.split(order, starts[1:]), strict=True):
        done += [b for b in live if k - b.frame > MAX_GAP + 1]
        live = [b for b in live if k - b.frame <= MAX_GAP + 1]
        _expect(live, k, diameter)
        found = rows.tolist()
        pairs = _match(live, found, x, y, k, (reach, 0.6 * diameter, loose))
        for ball, row in pairs:
            _extend(ball, row, k, x[row], y[row])
        taken, seen = {row for _, row in pairs}, {id(ball) for ball, _ in pairs}
        for ball in live:
            if ball.bounced and ball.sure and id(ball) not in seen and ball.struck is None:
                ball.struck = (k, *ball.ahead)
        live += [_OpenTrack([row], k, x[row], y[row]) for row in found if row not in taken]
    return done + live


def _expect(live: list[_OpenTrack], frame: int, diameter: float) -> None:
    """Sets where each ball is expected and with what velocity, pairs bouncing off each other on the way."""
    for ball in live:
        since, x, y, vx, vy = ball.struck or (ball.frame, ball.x, ball.y, ball.vx, ball.vy)
        ball.ahead = (x + vx * (frame - since), y + vy * (frame - since), vx, vy)
        ball.bounced = ball.struck is not None
    free = [ball for ball in live if ball.struck is None]
    for i, one in enumerate(free):
        for two in free[i + 1 :]:
            _bounce(one, two, frame, diameter)


def _bounce(one: _OpenTrack, two: _OpenTrack, frame: int, diameter: float) -> None:
    """Elastic-like exchange along the line of centres, if the two meet before ``frame``."""
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
    push = 0.5 * (1.0 + BOUNCE) * (ux * nx + uy * ny)
    left = span - wait
    x, y, vx, vy = one.ahead
    one.ahead = (x + push * nx * left, y + push * ny * left, vx + push * nx, vy + push * ny)
    x, y, vx, vy = two.ahead
    two.ahead = (x - push * nx * left, y - push * ny * left, vx - push * nx, vy - push * ny)
    one.bounced = two.bounced = True
    one.sure = two.sure = min(len(one.rows), len(two.rows)) >= SHORT


def _match(
    live: list[_OpenTrack],
    found: list[int],
    x: list[float],
    y: list[float],
    frame: int,
    gate: tuple[float, float, float],
) -> list[tuple[_OpenTrack, int]]:
    """Pairs of ball and glint of least summed squared distance, none further than its gate."""
    if not live or not found:
        return []
    cost = [[(b.ahead[0] - x[r]) ** 2 + (b.ahead[1] - y[r]) ** 2 for r in found] for b in live]
    gates = [_gate(b, frame, *gate) ** 2 for b in live]
    if len(live) == len(found) == 1:
        chosen = [(0, 0)]
    else:
        capped = [[min(c, g) for c in line] for line, g in zip(cost, gates, strict=True)]
        rows, columns = linear_sum_assignment(np.array(capped))
        chosen = list(zip(rows.tolist(), columns.tolist(), strict=True))
    return [(live[i], found[j]) for i, j in chosen if cost[i][j] < gates[i]]


def _gate(ball: _OpenTrack, frame: int, reach: float, least: float, loose: float) -> float:
    span = frame - ball.frame
    if not ball.moving:
        return reach * span
    speed = math.hypot(ball.vx, ball.vy)
    return (least + (1.0 if ball.bounced else loose) * speed) * span


def _extend(ball: _OpenTrack, row: int, frame: int, x: float, y: float) -> None:
    span = frame - ball.frame
    if ball.bounced:  # a difference across the bounce is neither velocity
        ball.vx, ball.vy = ball.ahead[2:]
    else:
        ball.vx, ball.vy = (x - ball.x) / span, (y - ball.y) / span
    ball.moving, ball.struck = True, None
    ball.rows.append(row)
    ball.frame, ball.x, ball.y = frame, x, y


def _keep_ball_tracks(balls: list[_OpenTrack], glints: Glints, fewest: int) -> list[_OpenTrack]:
    """Tracks that are balls: not faint beside the others, and not a blip of a frame or two."""
    long = [b for b in balls if len(b.rows) >= SHORT] or balls
    fluxes = {id(b): float(np.median(glints.flux[b.rows])) for b in balls}
    brightest = max(fluxes[id(b)] for b in long)
    typical = float(np.median([fluxes[id(b)] for b in long if fluxes[id(b)] >= FAINT * brightest]))
    kept = []
    for ball in balls:
        flux = fluxes[id(ball)]
        whole = len(ball.rows) >= SHORT or 0.4 * typical < flux < 2.5 * typical
        if flux >= FAINT * brightest and whole and len(ball.rows) >= fewest:
            kept.append(ball)
    first = [(int(glints.frame[b.rows[0]]), glints.x[b.rows[0]], glints.y[b.rows[0]]) for b in kept]
    return [kept[i] for i in sorted(range(len(kept)), key=first.__getitem__)]
