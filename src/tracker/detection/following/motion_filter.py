"""Predicts where balls are in the next frame, on their way, off each other and off walls, and weighs what is found.

Each ball has a position and a velocity with a covariance (a Kalman filter that is the same along both axes). The next
position is one of several:

- on its way, at its velocity;
- off another ball, where the two would meet: the velocities along their line of centres are exchanged;
- anywhere that it can reach, after a hit by something unseen such as a wall.

The likelihood of a detection is the sum over these. It is compared with that of a false detection and a missed ball.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import inf

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import ndtr

from synthcam_shared.arrays import Array, Ints
from tracker.detection.glints import RowArrays

MAX_BALLS_FOR_ALL_PAIRS = 48  # balls, up to which all pairs are looked at
UNBOUNDED = (-inf, -inf, inf, inf)
MAX_SIGMA_OF_OWN = 3.0  # standard errors along an axis, within which a detection is surely the ball's own


@dataclass(frozen=True)
class MotionNoise:
    """How far balls depart from their predictions, in px and frames."""

    diameter: float  # of a ball, px
    reach: float  # most that a ball moves in its first frame, px
    position: float  # error of a detection, px
    acceleration: float  # px per frame^2, of a ball that slides
    tolerance: float  # how far off a prediction a ball may be, as a share of the distance moved in a frame
    restitution: float
    false_density: float  # false detections and balls that appear, per px^2 and frame
    fall: tuple[float, float] = (0.0, 0.0)  # acceleration that all balls have, px per frame^2
    usual_step: float = 0.0  # px per frame: size along an axis of the first step of the share `usual_share` of balls
    usual_share: float = 0.0
    bounds: tuple[float, float, float, float] = UNBOUNDED
    """Left, top, right and bottom of what balls ever reach, px: there may be walls."""
    bend: float = 0.03  # change of a velocity in a frame, as a share of it
    hit: float = 0.15  # error of the velocity after a hit, over that of the approach
    distance: float = 0.04  # error of the distance at which balls meet, diameters
    unseen_hits: float = 0.01  # probability in a frame of a hit by something unseen
    hidden_hits: bool = False  # whether a ball that is not seen may be hit meanwhile, not only as it is seen again
    wall: float = 0.6  # probability that a ball whose path leads beyond the bounds meets a wall there
    least_free: float = 1e-3  # probability that balls whose paths overlap do not meet
    log_seen: float = 3.0  # logarithm of the odds that a ball is seen
    log_new: float = -1.0  # of the odds that a detection without a past is a ball


@dataclass(frozen=True, eq=False)
class PredictedBalls(RowArrays):
    """The state of n balls in a frame: px and px per frame; the covariance is the same along both axes."""

    number: Ints  # (n,) of the track
    seen: Ints  # (n,) frame of the last detection
    count: Ints  # (n,) detections
    last: Array  # (n, 2) position of the last detection
    xy: Array  # (n, 2)
    v: Array  # (n, 2)
    cov: Array  # (n, 3): of the position, of both, of the velocity

    @classmethod
    def start(cls, number: Ints, frame: int, xy: Array, noise: MotionNoise) -> PredictedBalls:
        """Balls that are seen for the first time."""
        n = len(number)
        cov = np.tile([noise.position**2, 0.0, (noise.reach / 2) ** 2], (n, 1))
        ones = np.ones(n, dtype=np.int64)
        return cls(number, frame * ones, ones, xy, xy, np.zeros((n, 2)), cov)

    def advance(self, frames: int, noise: MotionNoise) -> PredictedBalls:
        """The balls some frames later, if nothing hits them."""
        t, (xx, xv, vv), cov = float(frames), self.cov.T, np.empty_like(self.cov)
        push = noise.acceleration**2 + noise.bend**2 * (self.v**2).sum(axis=1)
        cov[:, 0] = xx + 2 * t * xv + t * t * vv + push * t**4 / 4
        cov[:, 1] = xv + t * vv + push * t**3 / 2
        cov[:, 2] = vv + push * t * t
        fall = np.array(noise.fall) * t
        xy, v = self.xy + t * self.v + fall * (t / 2), self.v + fall
        return PredictedBalls(self.number, self.seen, self.count, self.last, xy, v, cov)


@dataclass(frozen=True, eq=False)
class PredictedHits(RowArrays):
    """Hits that may happen before a frame, of two balls or of one and a wall: a row for each ball, after the hit."""

    ball: Ints  # (h,) index
    chance: Array  # (h,)
    xy: Array  # (h, 2)
    v: Array  # (h, 2)
    cov: Array  # (h, 3)


def predict_hits(
    before: PredictedBalls, after: PredictedBalls, pairs: tuple[Ints, Ints], frames: int, noise: MotionNoise
) -> PredictedHits:
    """Predict the hits of balls, from their states in the last frame and in the next, if they meet nothing."""
    return PredictedHits.join([_predict_pair_hits(before, after, pairs, frames, noise), _predict_bounces(after, noise)])


def _predict_bounces(after: PredictedBalls, noise: MotionNoise) -> PredictedHits:
    """Predict that balls bounce off a wall at the bounds of what balls ever reach, along each axis."""
    restitution, spread_share = 0.8, 0.25  # of walls; error of the way and of the velocity back, over these
    bounds, rows = np.array(noise.bounds).reshape(2, 2), list[PredictedHits]()
    for axis, side in ((0, 0), (0, 1), (1, 0), (1, 1)):
        outward = 2.0 * side - 1.0
        beyond, speed = outward * (after.xy[:, axis] - bounds[side, axis]), outward * after.v[:, axis]
        ball = np.flatnonzero((after.count > 1) & (speed > 0) & (beyond > 0))
        xy, v = after.xy[ball], after.v[ball]
        xy[:, axis] = bounds[side, axis] - outward * restitution * beyond[ball]
        v[:, axis] = -outward * restitution * speed[ball]
        far = spread_share * (beyond[ball] + speed[ball]) + noise.distance * noise.diameter
        change = spread_share * speed[ball]
        wider = np.column_stack([far**2, 0 * far, change**2])
        rows.append(PredictedHits(ball, np.full(len(ball), noise.wall), xy, v, after.cov[ball] + wider))
    return PredictedHits.join(rows)


def _predict_pair_hits(
    before: PredictedBalls, after: PredictedBalls, pairs: tuple[Ints, Ints], frames: int, noise: MotionNoise
) -> PredictedHits:
    """Predict the hits of pairs of balls."""
    i, j = pairs
    apart, speed = before.xy[j] - before.xy[i], before.v[j] - before.v[i]
    closing, square = (apart * speed).sum(axis=1), (speed**2).sum(axis=1)
    near = (closing < 0) & (square > 1e-12)
    i, j, apart, speed, closing, square = (values[near] for values in (i, j, apart, speed, closing, square))
    nearest = np.minimum(-closing / square, frames)
    least = np.hypot(*(apart + nearest[:, None] * speed).T)
    spread = np.sqrt((noise.distance * noise.diameter) ** 2 + after.cov[i, 0] + after.cov[j, 0])
    chance = ndtr((noise.diameter - least) / spread)
    root = closing**2 - square * ((apart**2).sum(axis=1) - noise.diameter**2)
    wait = np.clip((-closing - np.sqrt(np.maximum(root, 0.0))) / square, 0.0, frames)
    normal = apart + wait[:, None] * speed
    normal /= np.maximum(np.hypot(*normal.T), 1e-9)[:, None]
    push = 0.5 * (1 + noise.restitution) * ((speed * normal).sum(axis=1))[:, None] * normal
    left = frames - wait
    error = noise.hit**2 * square
    wider = np.column_stack([error * left**2, error * left, error])
    sides = ((i, push), (j, -push))
    return PredictedHits(
        ball=np.concatenate([i, j]),
        chance=np.tile(chance, 2),
        xy=np.concatenate([after.xy[k] + kick * left[:, None] for k, kick in sides]),
        v=np.concatenate([after.v[k] + kick for k, kick in sides]),
        cov=np.concatenate([after.cov[k] + wider for k, _ in sides]),
    )


def find_near_balls(balls: PredictedBalls, frames: int, noise: MotionNoise) -> tuple[Ints, Ints]:
    """Predict which pairs of balls, both seen twice, may come within a diameter."""
    rows = np.flatnonzero(balls.count > 1)
    if len(rows) < 2:
        return rows[:0], rows[:0]
    xy, speed = balls.xy[rows], np.hypot(*balls.v[rows].T) * frames
    reach = (1 + 3 * noise.distance) * noise.diameter
    if len(rows) <= MAX_BALLS_FOR_ALL_PAIRS:
        i, j = _list_pairs(len(rows))
    else:
        i, j = cKDTree(xy).query_pairs(reach + 2 * float(speed.max()), output_type="ndarray").T.astype(np.int64)
    near = ((xy[i] - xy[j]) ** 2).sum(axis=1) < (reach + speed[i] + speed[j]) ** 2
    return rows[i[near]], rows[j[near]]


@cache
def _list_pairs(count: int) -> tuple[Ints, Ints]:
    i, j = np.triu_indices(count, 1)
    return i, j
