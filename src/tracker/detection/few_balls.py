"""Follows few balls that keep apart, each by its own detection, until a frame needs the likelihoods of `assignment`.

The steps are those of `assignment.link_frame`, to the last bit. Numbers in place of arrays make them ten times faster,
because numpy's time for two balls is that of its calls.
"""

from collections.abc import Sequence
from itertools import combinations
from math import hypot
from typing import NamedTuple

import numpy as np

from synthcam_shared.arrays import Array, Ints
from tracker.detection.motion_filter import MAX_SIGMA_OF_OWN, MotionNoise, PredictedBalls

MAX_FEW_BALLS = 6  # beyond, arrays are as fast


class _State(NamedTuple):
    """The state of one ball, as in `PredictedBalls`."""

    x: float
    y: float
    vx: float
    vy: float
    xx: float
    xv: float
    vv: float

    def advance(self, t: float, noise: MotionNoise) -> "_State":
        """The state t frames later."""
        x, y, vx, vy, xx, xv, vv = self
        push = noise.acceleration**2 + noise.bend**2 * (vx * vx + vy * vy)
        wide = xx + 2 * t * xv + t * t * vv + push * t**4 / 4
        return _State(x + t * vx, y + t * vy, vx, vy, wide, xv + t * vv + push * t**3 / 2, vv + push * t * t)

    def correct(self, at: Sequence[float], noise: MotionNoise) -> "_State":
        """The state after a detection."""
        x, y, vx, vy, xx, xv, vv = self
        whole = xx + noise.position**2
        of_place, of_speed, right, down = xx / whole, xv / whole, at[0] - x, at[1] - y
        return _State(
            x + of_place * right,
            y + of_place * down,
            vx + of_speed * right,
            vy + of_speed * down,
            xx - xx * xx / whole,
            xv - xx * xv / whole,
            vv - xv * xv / whole,
        )


def follow_apart(
    balls: PredictedBalls,
    frames: Sequence[int],
    parts: Sequence[Ints],
    xy: Array,
    first: int,
    longest: int,
    noise: MotionNoise,
) -> tuple[PredictedBalls, list[Ints]]:
    """Follow few balls from the frame before the `first` on, as long as no two are near and each has a detection.

    frames: numbers of all frames with detections. parts: rows of xy (n, 2), px, that are theirs. longest: frames from
    one to the next, at most.
    Returns the balls in the last of these frames, and for each of them the row of each ball.
    """
    rows = list[Ints]()
    if not 0 < len(balls) <= MAX_FEW_BALLS or (balls.count < 2).any():
        return balls, rows
    states = [_State(*state) for state in np.hstack([balls.xy, balls.v, balls.cov]).tolist()]
    for k in range(first, len(frames)):
        step = frames[k] - frames[k - 1]
        if len(parts[k]) != len(states) or (rows and step > longest) or _may_meet(states, step, noise):
            break
        found = xy[parts[k]].tolist()
        ahead = [state.advance(float(step), noise) for state in states]
        own = _match(ahead, found, noise)
        if own is None:
            break
        states = [state.correct(found[at], noise) for state, at in zip(ahead, own, strict=True)]
        rows.append(parts[k][own])
    if not rows:
        return balls, rows
    last, now = frames[first + len(rows) - 1], np.array(states)
    followed = PredictedBalls(
        number=balls.number,
        seen=np.full_like(balls.seen, last),
        count=balls.count + len(rows),
        last=xy[rows[-1]],
        xy=now[:, :2],
        v=now[:, 2:4],
        cov=now[:, 4:],
    )
    return followed, rows


def _may_meet(states: Sequence[_State], step: int, noise: MotionNoise) -> bool:
    """Tell whether two balls may come within a diameter, as `motion_filter.find_near_balls` does."""
    rounding = 1 + 1e-9  # in doubt they may: numpy's hypot differs in the last bit
    reach = (1 + 3 * noise.distance) * noise.diameter
    for one, other in combinations(states, 2):
        square = (one.x - other.x) ** 2 + (one.y - other.y) ** 2
        if square < rounding * (reach + (hypot(one.vx, one.vy) + hypot(other.vx, other.vy)) * step) ** 2:
            return True
    return False


def _match(states: Sequence[_State], found: Sequence[Sequence[float]], noise: MotionNoise) -> list[int] | None:
    """The detection of each ball where every ball and every detection has its own; None otherwise."""
    own = list[int]()
    for state in states:
        off = [(state.x - x) * (state.x - x) + (state.y - y) * (state.y - y) for x, y in found]
        least = min(off)
        if not least < MAX_SIGMA_OF_OWN**2 * (state.xx + noise.position**2):
            return None
        own.append(off.index(least))
    return own if len(set(own)) == len(own) else None
