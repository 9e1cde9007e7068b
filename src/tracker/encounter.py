"""Which balls met, which of them was moving, and roughly when, where and how: the start of every fit."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from .fitting import Whitened
from .motion import TIED
from .places import Course

Floats = NDArray[np.float64]
APPROACH = 6  # frames from which the approach is read
AT_REST = 0.03  # of the striker's speed


@dataclass(frozen=True)
class Encounter:
    """Two balls about one contact, `frame` that of least separation, `reason` why it cannot be fitted."""

    struck: Course
    striker: Course
    frame: int
    reason: str = ""


def encounters(balls: list[Course], diameter: float) -> list[Encounter]:
    """All collisions of a recording, in order; each with the stretch in which neither ball meets another."""
    meetings = [(frame, a, b) for a, b in combinations(balls, 2) for frame in _contact_frames(a, b, diameter)]
    meetings.sort(key=lambda m: m[0])
    found = []
    for frame, a, b in meetings:
        others = [f for f, *pair in meetings if f != frame and (a in pair or b in pair)]
        first = max((f for f in others if f < frame), default=-1)
        last = min((f for f in others if f > frame), default=np.iinfo(np.int64).max)
        a_cut, b_cut = (c.where((c.frame > first) & (c.frame < last)) for c in (a, b))
        found.append(_roles(a_cut, b_cut, frame))
    return found


def velocity(course: Course) -> tuple[Floats, Floats, float]:
    """Straight line through a few places: velocity (2,), place at the mean time (2,), std of the velocity."""
    t = course.time - course.time.mean()
    spread = float((t**2).sum())
    std = float(np.sqrt(np.trace(course.cov.mean(axis=0)) / 2 / spread))
    return t @ course.place / spread, course.place.mean(axis=0), std


def _contact_frames(a: Course, b: Course, diameter: float) -> list[int]:
    """Frames of least separation at which two balls touched and changed course."""
    frames, ia, ib = np.intersect1d(a.frame, b.frame, return_indices=True)
    if len(frames) < 5:
        return []
    apart = np.linalg.norm(a.place[ia] - b.place[ib], axis=1)
    step = np.abs(np.diff(apart))
    found = []
    for k in range(1, len(frames) - 1):
        closest = apart[k] == apart[max(k - 3, 0) : k + 4].min()
        reach = step[max(k - 3, 0) : k + 3].max()
        if closest and apart[k] < diameter * 1.01 + 0.75 * reach and _kicked(a, b, int(frames[k])):
            found.append(int(frames[k]))
    return found


def _kicked(a: Course, b: Course, frame: int) -> bool:
    """Whether either ball's velocity changed there by more than noise and friction do."""
    for course in (a, b):
        early = course.where((course.frame < frame) & (course.frame >= frame - APPROACH))
        late = course.where((course.frame > frame) & (course.frame <= frame + APPROACH))
        if len(early) < 2 or len(late) < 2:
            continue
        (v, _, s), (w, _, q) = velocity(early), velocity(late)
        if np.linalg.norm(w - v) > max(6 * np.hypot(s, q), 0.05 * max(np.linalg.norm(v), np.linalg.norm(w))):
            return True
    return False


def _roles(a: Course, b: Course, frame: int) -> Encounter:
    """Ball 2 is the faster before contact; says why where a clip shows too little."""
    early = [c.where((c.frame < frame) & (c.frame >= frame - APPROACH)) for c in (a, b)]
    if min(len(e) for e in early) < 2:
        return Encounter(a, b, frame, "the approach is not in view")
    speeds = [velocity(e) for e in early]
    if np.linalg.norm(speeds[0][0]) > np.linalg.norm(speeds[1][0]):
        a, b, speeds = b, a, speeds[::-1]
    rest, fast = float(np.linalg.norm(speeds[0][0])), float(np.linalg.norm(speeds[1][0]))
    if rest > max(AT_REST * fast, 6 * speeds[0][2]):
        return Encounter(a, b, frame, "both balls move before they meet")
    if min(int((c.frame > frame).sum()) for c in (a, b)) < 4:
        return Encounter(a, b, frame, "too few frames after the contact")
    return Encounter(a, b, frame)


def first_guess(meeting: Encounter, diameter: float) -> Floats | None:
    """Tied parameters (11,) to start from; None where the approach leads past the resting ball.

    The launch comes from the approach alone: a straight line, and the time at which it is one diameter from
    the resting ball. What the impact did comes from a coarse grid over all that is physical.
    """
    early = meeting.striker.where(
        (meeting.striker.frame < meeting.frame) & (meeting.striker.frame >= meeting.frame - APPROACH)
    )
    v, middle, _ = velocity(early)
    rest = meeting.struck.place[meeting.struck.frame < meeting.frame].mean(axis=0)
    v0 = float(np.linalg.norm(v))
    d = v / v0
    gap = rest - middle
    across = float(d[0] * gap[1] - d[1] * gap[0])  # z . (d x gap) = -b
    sine = -across / diameter
    if abs(sine) > 1.05:
        return None
    beta = float(np.arcsin(np.clip(sine, -0.98, 0.98)))
    t_c = float(early.time.mean() + (d @ gap - diameter * np.cos(beta)) / v0)
    launch = [t_c, *rest, float(np.arctan2(d[1], d[0])), beta, v0, 0.1, 0.01]
    problem = Whitened(meeting.struck, meeting.striker, diameter, tied=True)
    grid = [
        np.array([*launch, r, np.log(mu), c])
        for r, mu, c in product((0.5, 0.75, 0.95), (0.1, 0.2, 0.4), (0.1, 0.35))
    ]
    costs = [float((problem(start)[0] ** 2).sum()) for start in grid]
    assert len(grid[0]) == len(TIED)
    return grid[int(np.argmin(costs))]
