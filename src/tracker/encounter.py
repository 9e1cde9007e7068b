"""Which balls met, which of them was moving, and roughly when, where and how: the start of every fit."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from .fitting import Whitened
from .places import Course

Floats = NDArray[np.float64]
APPROACH = 6  # places from which the approach is read
LONGEST = 15  # frames; older places tell nothing of the moment of contact
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


def _before(course: Course, frame: int) -> Course:
    """The last few places before a frame."""
    return course.where((course.frame >= frame - LONGEST) & _ranked(course.frame < frame, last=True))


def _after(course: Course, frame: int) -> Course:
    """The first few places after a frame."""
    return course.where((course.frame <= frame + LONGEST) & _ranked(course.frame > frame, last=False))


def _ranked(rows: NDArray[np.bool_], last: bool) -> NDArray[np.bool_]:
    """The first or the last APPROACH of the rows that are set."""
    chosen = np.flatnonzero(rows)
    out = np.zeros_like(rows)
    out[chosen[-APPROACH:] if last else chosen[:APPROACH]] = True
    return out


def _contact_frames(a: Course, b: Course, diameter: float) -> list[int]:
    """Frames of least separation at which two balls touched and changed course; gaps are bridged straight."""
    frames = np.arange(max(a.frame[0], b.frame[0]), min(a.frame[-1], b.frame[-1]) + 1)
    if len(frames) < 5:
        return []
    apart = np.hypot(*(_bridged(a, frames) - _bridged(b, frames)).T)
    step = np.abs(np.diff(apart))
    found = []
    for k in range(1, len(frames) - 1):
        closest = apart[k] == apart[max(k - 3, 0) : k + 4].min()
        if not closest:
            continue
        reach = step[max(k - 3, 0) : k + 3].max() * max(_gap(c, int(frames[k])) for c in (a, b))
        if apart[k] < diameter * 1.01 + 0.75 * reach and _kicked(a, b, int(frames[k])):
            found.append(int(frames[k]))
    return found


def _bridged(course: Course, frames: NDArray[np.int64]) -> Floats:
    return np.column_stack([np.interp(frames, course.frame, course.place[:, axis]) for axis in (0, 1)])


def _gap(course: Course, frame: int) -> int:
    """Longest stretch, in frames, between places next to a frame."""
    i = int(np.searchsorted(course.frame, frame))
    near = course.frame[max(i - 2, 0) : i + 3]
    return int(np.diff(near).max(initial=1))


def _kicked(a: Course, b: Course, frame: int) -> bool:
    """Whether either ball's velocity changed there by more than noise and friction do."""
    for course in (a, b):
        early, late = _before(course, frame), _after(course, frame)
        if len(early) < 2 or len(late) < 2:
            continue
        (v, _, s), (w, _, q) = velocity(early), velocity(late)
        if np.linalg.norm(w - v) > max(6 * np.hypot(s, q), 0.05 * max(np.linalg.norm(v), np.linalg.norm(w))):
            return True
    return False


def _roles(a: Course, b: Course, frame: int) -> Encounter:
    """Ball 2 is the faster before contact; says why where a clip shows too little."""
    early = [_before(c, frame) for c in (a, b)]
    if min(len(e) for e in early) < 2:
        return Encounter(a, b, frame, "the approach is not in view")
    speeds = [velocity(e) for e in early]
    if np.linalg.norm(speeds[0][0]) > np.linalg.norm(speeds[1][0]):
        a, b, speeds = b, a, speeds[::-1]
    rest, fast = float(np.linalg.norm(speeds[0][0])), float(np.linalg.norm(speeds[1][0]))
    if rest > max(AT_REST * fast, 6 * speeds[0][2]) and _moves(a, frame - 2, AT_REST * fast):
        return Encounter(a, b, frame, "both balls move before they meet")
    if min(int((c.frame > frame).sum()) for c in (a, b)) < 4:
        return Encounter(a, b, frame, "too few frames after the contact")
    return Encounter(a, b, frame)


def _moves(course: Course, until: int, slow: float) -> bool:
    """Whether a ball moved well before the contact, whose frame is uncertain where others are missing."""
    early = _before(course, until)
    if len(early) < 2:
        return True
    v, _, std = velocity(early)
    return bool(np.linalg.norm(v) > max(slow, 6 * std))


def first_guess(meeting: Encounter, diameter: float) -> Floats | None:
    """Tied parameters (11,) to start from; None where the approach leads past the resting ball.

    The launch comes from the approach alone: a straight line, and the time at which it is one diameter from
    the resting ball. What the impact did comes from a coarse grid over all that is physical. Where frames about
    the contact are missing, it may have been a frame earlier or later than it seems.
    """
    near = np.arange(meeting.frame - 2, meeting.frame + 3)
    whole = all(np.isin(near, course.frame).all() for course in (meeting.struck, meeting.striker))
    problem = Whitened(meeting.struck, meeting.striker, diameter, tied=True)
    starts = []
    for frame in (meeting.frame,) if whole else (meeting.frame - 1, meeting.frame, meeting.frame + 1):
        launch = _launch(meeting, frame, diameter)
        if launch is not None:
            grid = product((0.5, 0.75, 0.95), (0.1, 0.2, 0.4), (0.1, 0.35))
            starts += [np.array([*launch, r, np.log(mu), c]) for r, mu, c in grid]
    if not starts:
        return None
    return starts[int(np.argmin([float((problem.residual(start) ** 2).sum()) for start in starts]))]


def _launch(meeting: Encounter, frame: int, diameter: float) -> list[float] | None:
    """The first eight of the tied parameters, from what lies before `frame`."""
    line = _before(meeting.striker, frame)
    still = meeting.struck.place[meeting.struck.frame < frame]
    if len(line) < 2 or not len(still):
        return None
    v, middle, _ = velocity(line)
    rest = still.mean(axis=0)
    v0 = float(np.linalg.norm(v))
    if v0 == 0:
        return None
    d = v / v0
    gap = rest - middle
    sine = float(d[1] * gap[0] - d[0] * gap[1]) / diameter  # b/2R = -z . (d x gap) / 2R
    if abs(sine) > 1.05:
        return None
    beta = float(np.arcsin(np.clip(sine, -0.98, 0.98)))
    t_c = float(line.time.mean() + (d @ gap - diameter * np.cos(beta)) / v0)
    return [t_c, *map(float, rest), float(np.arctan2(d[1], d[0])), beta, v0, 0.1, 0.01]
