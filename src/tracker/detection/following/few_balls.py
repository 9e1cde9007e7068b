"""Follows few balls as long as none may meet another and their links are sure, until `assignment` has to weigh.

The steps are those of `assignment.link_frame`, to the last bit. Numbers in place of arrays make them ten times faster,
because numpy's time for two balls is that of its calls.
"""

from collections.abc import Sequence
from enum import Enum
from itertools import combinations
from math import hypot, inf, log, pi, sqrt
from typing import NamedTuple

import numpy as np

from synthcam_shared.arrays import Array, Ints
from tracker.detection.following.motion_filter import MAX_SIGMA_OF_OWN, MotionNoise, PredictedBalls

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
        right, down = noise.fall[0] * t, noise.fall[1] * t
        x, y, vx, vy = x + t * vx + right * (t / 2), y + t * vy + down * (t / 2), vx + right, vy + down
        return _State(x, y, vx, vy, wide, xv + t * vv + push * t**3 / 2, vv + push * t * t)

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


class _Meeting(Enum):
    """What two balls may do before the next frame, as `motion_filter` predicts it."""

    APART = 0  # they stay too far apart to meet
    PARTING = 1  # they are near, and move away from each other
    POSSIBLE = 2


def follow_apart(
    balls: PredictedBalls,
    frames: Sequence[int],
    parts: Sequence[Ints],
    xy: Array,
    first: int,
    longest: int,
    noise: MotionNoise,
) -> tuple[PredictedBalls, list[Ints]]:
    """Follow few balls from the frame before the `first` on, as long as no two may meet and all links are sure.

    frames: numbers of all frames with detections. parts: rows of xy (n, 2), px, that are theirs. longest: frames from
    one detection of a ball to the next, at most.
    Returns the balls in the last of these frames, and for each of them the row of each ball, or -1 of one not found.
    """
    rows = list[Ints]()
    if not 0 < len(balls) <= MAX_FEW_BALLS:
        return balls, rows
    states = [_State(*state) for state in np.hstack([balls.xy, balls.v, balls.cov]).tolist()]
    counts, seen, last = balls.count.tolist(), balls.seen.tolist(), balls.last.tolist()
    for k in range(first, len(frames)):
        step = frames[k] - frames[k - 1]
        if len(parts[k]) > len(states) or (rows and any(frames[k] - each > longest for each in seen)):
            break
        meeting = _predict_meeting(states, counts, step, noise)
        if meeting is _Meeting.POSSIBLE:
            break
        found = xy[parts[k]].tolist()
        ahead = [state.advance(float(step), noise) for state in states]
        own = None
        if meeting is _Meeting.APART and len(found) == len(states) and min(counts) > 1:
            own = _match(ahead, found, noise)
        if own is None and any(_is_outside(state, noise) for state in ahead):
            break  # at a wall, perhaps
        if own is None:
            unhit = [(step, (state.x, state.y)) for state in states]
            if noise.hidden_hits:
                unhit = [(frames[k] - each, at) for each, at in zip(seen, last, strict=True)]
            own = _match_surely(states, ahead, counts, unhit, found, step, noise)
        if own is None:
            break
        states = list[_State]()
        for i, (state, at) in enumerate(zip(ahead, own, strict=True)):
            if at < 0:
                states.append(state)
                continue
            states.append(state.correct(found[at], noise))
            counts[i], seen[i], last[i] = counts[i] + 1, frames[k], found[at]
        rows.append(np.array([parts[k][at] if at >= 0 else -1 for at in own], dtype=np.int64))
    if not rows:
        return balls, rows
    now = np.array(states)
    followed = PredictedBalls(
        number=balls.number,
        seen=np.array(seen, dtype=balls.seen.dtype),
        count=np.array(counts, dtype=balls.count.dtype),
        last=np.array(last),
        xy=now[:, :2],
        v=now[:, 2:4],
        cov=now[:, 4:],
    )
    return followed, rows


def _is_outside(state: _State, noise: MotionNoise) -> bool:
    """True beyond what balls ever reach."""
    left, top, right, bottom = noise.bounds
    return not (left <= state.x <= right and top <= state.y <= bottom)


def _predict_meeting(states: Sequence[_State], counts: Sequence[int], step: int, noise: MotionNoise) -> _Meeting:
    """Predict whether two balls, both seen twice, may meet, as `find_near_balls` and `predict_hits` do."""
    rounding = 1e-9  # in doubt they may: numpy's hypot differs in the last bit
    reach, out = (1 + 3 * noise.distance) * noise.diameter, _Meeting.APART
    for one, other in combinations([state for state, count in zip(states, counts, strict=True) if count > 1], 2):
        right, down = other.x - one.x, other.y - one.y
        near = reach + (hypot(one.vx, one.vy) + hypot(other.vx, other.vy)) * step
        if right * right + down * down < (1 + rounding) * near**2:
            vx, vy = other.vx - one.vx, other.vy - one.vy
            if not right * vx + down * vy > rounding * hypot(right, down) * hypot(vx, vy):
                return _Meeting.POSSIBLE
            out = _Meeting.PARTING
    return out


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


def _match_surely(
    states: Sequence[_State],
    ahead: Sequence[_State],
    counts: Sequence[int],
    unhit: Sequence[tuple[int, Sequence[float]]],
    found: Sequence[Sequence[float]],
    step: int,
    noise: MotionNoise,
) -> list[int] | None:
    """The detection of each ball, or -1, where the likelihoods of `assignment` leave no choice; None otherwise.

    That is so if each detection has a gain with one ball only, which came freely, and no ball has two of them. A bound
    on each gain decides; in doubt there is a choice. No ball meets another. unhit: how many frames ago each ball was
    surely on its way, and where.
    """
    rounding, doubt = 1 + 1e-9, 1e-6  # of squares, and of logarithms
    base, own, taken = noise.log_seen - log(noise.false_density), [-1] * len(states), set[int]()
    for i, (before, state, count, (unhit_for, start)) in enumerate(zip(states, ahead, counts, unhit, strict=True)):
        variance = state.xx + noise.position**2
        speed = (hypot(before.vx, before.vy) + (sqrt(before.vv) if noise.hidden_hits else 0.0)) * unhit_for
        lost = 0.6 * noise.diameter * unhit_for + noise.tolerance * speed
        back = 0.3 * noise.diameter * unhit_for + speed
        hit_by_unseen = log(noise.unseen_hits * unhit_for / (pi * max(lost, speed) ** 2))
        for at, (x, y) in enumerate(found):
            off = (x - state.x) ** 2 + (y - state.y) ** 2
            if count < 2:  # seen once, it may go anywhere within reach
                if off < rounding * (noise.reach * step) ** 2:
                    return None
                continue
            way = (x - start[0]) ** 2 + (y - start[1]) ** 2
            free, unseen = -log(2 * pi * variance) - off / (2 * variance), -inf
            if off < rounding * lost**2 or way < rounding * back**2:
                unseen = hit_by_unseen
            if max(free, unseen) + log(2) + base < -doubt:
                continue
            if own[i] >= 0 or at in taken or free + base < doubt or unseen > free - doubt:
                return None
            own[i] = at
            taken.add(at)
    return own if len(taken) == len(found) else None
