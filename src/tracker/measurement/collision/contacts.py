"""Which balls met, which of them was moving, and roughly when, where and how: the start of every fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from tracker.measurement.collision.collision_model import AFTER, SPIN, TIED, directions, release
from tracker.measurement.collision.fitting import Pair
from tracker.measurement.positions import Course

Floats = NDArray[np.float64]
APPROACH = 6  # positions from which the approach is read
LONGEST = 15  # frames; older positions say nothing about the moment of contact
CREEPING = 0.002  # of the relative speed: a target this slow is at rest for every purpose
STILL = 150  # frames at rest, beyond which more of them add nothing: their shared error is the limit
GRID = (0.5, 0.75, 0.95), (0.1, 0.2, 0.4), (0.1, 0.35)  # r, mu_k and C, from which a fit starts
ROLLS = (0.0,) * len(SPIN)
SAME = 0.3  # of a glint's width, within which a ball that has not moved is seen
NEAR = 0.75  # frames' worth of approach, by which balls that touch may be apart in the frames to either side


@dataclass(frozen=True, eq=False)
class Encounter:
    """Two balls about one contact, `frame` that of least separation; ball 2, the striker, is the faster.

    reason: why it cannot be fitted.
    """

    pair: Pair
    frame: int
    reason: str = ""


@dataclass(frozen=True)
class Past:
    """What earlier hits left of a ball: it slides until rolls_from, s (inf: not known), and R w_z is spin, m/s."""

    rolls_from: float = -np.inf
    spin: float = 0.0


@dataclass(frozen=True, eq=False)
class Meeting:
    """A contact as it is found: two balls, each with the stretch in which it meets no third or again the other."""

    one: Course
    other: Course
    frame: int


def meetings(balls: list[Course], diameter: float, steps: float = NEAR) -> list[Meeting]:
    """Find all contacts of a recording.

    Parameters
    ----------
    balls : list of Course
    diameter : float
        m.
    steps : float
        Frames' worth of approach by which balls that touch between two frames may be farther apart in both.

    Returns
    -------
    list of Meeting
        In order of time.
    """
    found = [(k, a, b) for a, b in combinations(balls, 2) for k in _contact_frames(a, b, diameter, steps)]
    found.sort(key=lambda m: m[0])
    out = []
    for i, (frame, a, b) in enumerate(found):
        cut = []
        for course in (a, b):
            others = [f for j, (f, *pair) in enumerate(found) if j != i and course in pair]
            first = max((f for f in others if f < frame), default=-1)
            last = min((f for f in others if f > frame), default=np.iinfo(np.int64).max)
            cut.append(course.where((course.frame > first) & (course.frame < last)))
        out.append(Meeting(cut[0], cut[1], frame))
    return out


def encounter(meeting: Meeting, diameter: float, pasts: Mapping[int, Past]) -> Encounter:
    """Prepare a contact to be fitted: which ball strikes, and which of their positions count.

    Parameters
    ----------
    meeting : Meeting
    diameter : float
        m.
    pasts : mapping of int to Past
        By particle, what earlier hits left of a ball: positions while it still slid are left out.

    Returns
    -------
    Encounter
        With a reason where it cannot be fitted.
    """
    balls, spin = [], 0.0
    for course in (meeting.one, meeting.other):
        past = pasts.get(course.particle, Past())
        rolls = course.where(course.start > past.rolls_from)
        if not (rolls.frame < meeting.frame).any() and (course.frame < meeting.frame).any():
            reason = "a ball still slides when it is hit again: how it spins then is not known well enough"
            if np.isinf(past.rolls_from):
                reason = "an earlier hit of a ball could not be measured"
            return Encounter(Pair(meeting.one, meeting.other, diameter), meeting.frame, reason)
        balls.append(_thinned(rolls, meeting.frame))
        spin += past.spin
    return _roles(Pair(balls[0], balls[1], diameter, spin=spin), meeting.frame)


def velocity(course: Course) -> tuple[Floats, Floats, float]:
    """Fit a straight line to a few positions.

    Returns the velocity (2,) m/s, the position (2,) m at the mean time, and the velocity's standard error, m/s.
    """
    t = course.time - course.time.mean()
    spread = float((t**2).sum())
    std = float(np.sqrt(np.trace(course.cov.mean(axis=0)) / 2 / spread))
    return t @ course.position / spread, course.position.mean(axis=0), std


def _before(course: Course, frame: int) -> Course:
    """The last few positions before a frame."""
    return course.where((course.frame >= frame - LONGEST) & _ranked(course.frame < frame, last=True))


def _after(course: Course, frame: int) -> Course:
    """The first few positions after a frame."""
    return course.where((course.frame <= frame + LONGEST) & _ranked(course.frame > frame, last=False))


def _ranked(rows: NDArray[np.bool_], last: bool) -> NDArray[np.bool_]:
    """The first or the last APPROACH of the rows that are set."""
    chosen = np.flatnonzero(rows)
    out = np.zeros_like(rows)
    out[chosen[-APPROACH:] if last else chosen[:APPROACH]] = True
    return out


def _contact_frames(a: Course, b: Course, diameter: float, steps: float) -> list[int]:
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
        if apart[k] < diameter * 1.01 + steps * reach and _kicked(a, b, int(frames[k])):
            found.append(int(frames[k]))
    return found


def _bridged(course: Course, frames: NDArray[np.int64]) -> Floats:
    return np.column_stack([np.interp(frames, course.frame, course.position[:, axis]) for axis in (0, 1)])


def _gap(course: Course, frame: int) -> int:
    """Longest stretch, in frames, between positions next to a frame."""
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


def _roles(pair: Pair, frame: int) -> Encounter:
    """Ball 2 is the faster before contact; says why where a clip shows too little."""
    early = [_before(c, frame) for _, c in pair.balls]
    if min(len(e) for e in early) < 2:
        return Encounter(pair, frame, "the approach is not in view")
    speeds = [float(np.linalg.norm(velocity(e)[0])) for e in early]
    if speeds[0] > speeds[1]:
        pair = replace(pair, struck=pair.striker, striker=pair.struck)
    rest = _at_rest(pair.struck, frame, CREEPING * max(speeds))
    if rest is not None:
        pair = replace(pair, struck=pair.struck.where(pair.struck.frame >= rest))
    if min(int((c.frame > frame).sum()) for _, c in pair.balls) < 4:
        return Encounter(pair, frame, "too few frames after the contact")
    return Encounter(replace(pair, moving=rest is None), frame)


def _at_rest(course: Course, frame: int, slow: float) -> int | None:
    """First frame from which a ball rests until the contact; None if it moves then.

    The stretch grows from the contact outwards for as long as one position describes it, so that a ball which rolled
    to a stop before is taken from there on. The frame next to the contact may be late where others are missing.
    """
    rows = np.flatnonzero(course.frame < frame - 1)
    if len(rows) < 2:
        rows = np.flatnonzero(course.frame < frame)
    first = None
    count = min(APPROACH, len(rows))
    while count <= len(rows):
        mask = np.zeros(len(course), dtype=bool)
        mask[rows[-count:]] = True
        part = course.where(mask)
        v, _, std = velocity(part)
        if np.linalg.norm(v) > max(slow, 5 * std):
            break
        first = int(part.frame[0])
        if count == len(rows):
            break
        count = min(2 * count, len(rows))
    return first


def _thinned(course: Course, frame: int) -> Course:
    """The ball without the part of a rest that is more than STILL positions from the contact: it adds nothing."""
    if len(course) <= STILL or course.width <= 0:
        return course
    keep = np.ones(len(course), dtype=bool)
    still = np.hypot(*(course.position[STILL:] - course.position[:-STILL]).T) < SAME * course.width
    keep[:-STILL] &= ~(still & (course.frame[STILL:] < frame))
    keep[STILL:] &= ~(still & (course.frame[:-STILL] > frame))
    return course.where(keep)


def first_guesses(meeting: Encounter) -> list[Floats]:
    """Tied parameters (16,) to start from, the likeliest first; none where the approach leads past the other ball.

    The launch comes from the approach alone: straight lines, and the time at which the balls are one diameter
    apart. What the impact did comes from a coarse grid over all that is physical, the best for each friction. Where
    frames about the contact are missing, it may have been a frame earlier or later than it seems.
    """
    near = np.arange(meeting.frame - 2, meeting.frame + 3)
    whole = all(np.isin(near, course.frame).all() for _, course in meeting.pair.balls)
    starts = []
    for frame in (meeting.frame,) if whole else (meeting.frame - 1, meeting.frame, meeting.frame + 1):
        launch = _launch(meeting.pair, frame)
        if launch is not None:
            starts += [[*launch[:8], r, np.log(mu), c, *ROLLS, *launch[8:]] for r, mu, c in product(*GRID)]
    if not starts:
        return []
    guesses = np.array(starts)
    ordered = guesses[np.argsort(_misfit(meeting.pair, guesses), kind="stable")]
    first = np.unique(ordered[:, TIED.index("log_mu")], return_index=True)[1]
    return list(ordered[np.sort(first)])


def _misfit(pair: Pair, tied: Floats) -> Floats:
    """Sums (k,) of squared distances, in their errors, between the positions after the hit and the guesses (k, 16).

    Rough: instants for exposures, and a rolling ball loses speed evenly.
    """
    free = np.asarray(release(tied, pair.spin), dtype=np.float64)
    _, normal, _ = directions(tied[:, 3], tied[:, 4])
    total = np.zeros(len(tied))
    for ball, course in pair.balls:
        at, contact = AFTER[ball], free[:, 1:3] - (ball - 1) * pair.diameter * normal
        v, f, tau = free[:, at : at + 2], free[:, at + 2 : at + 4], np.exp(free[:, at + 4 : at + 5])
        since = course.time - free[:, :1]  # (k, n)
        slide = np.clip(since, 0.0, tau)
        speed = np.maximum(np.hypot(f[:, 0], f[:, 1]), 1e-9)[:, None]
        loss = free[:, 6:7] * speed + free[:, 7:8]
        roll = np.clip(since - tau, 0.0, speed / loss)
        grown = roll - loss * roll**2 / (2 * speed) + slide**2 / (2 * tau)  # weight of f
        way = (slide - slide**2 / (2 * tau))[..., None] * v[:, None] + grown[..., None] * f[:, None]
        off = contact[:, None] + way - course.position
        total += np.where(since > 0, course.whiten.distance(off), 0.0).sum(-1)
    return total


def _launch(pair: Pair, frame: int) -> list[float] | None:
    """The first eight of the tied parameters and ball 1's velocity, from what lies before `frame`."""
    line, target = _before(pair.striker, frame), _before(pair.struck, frame)
    if len(line) < 2 or len(target) < 1 + pair.moving:
        return None
    v, middle, _ = velocity(line)
    w, position = velocity(target)[:2] if pair.moving else (np.zeros(2), target.position.mean(axis=0))
    late = float(line.time.mean() - target.time.mean()) if pair.moving else 0.0
    v0 = float(np.linalg.norm(v - w))
    if v0 == 0:
        return None
    d = (v - w) / v0
    gap = position + w * late - middle  # when ball 2 is at `middle`
    sine = float(d[1] * gap[0] - d[0] * gap[1]) / pair.diameter  # b/2R = -z . (d x gap) / 2R
    if abs(sine) > 1.05:
        return None
    beta = float(np.arcsin(np.clip(sine, -0.98, 0.98)))
    ahead = float(d @ gap - pair.diameter * np.cos(beta)) / v0
    x, y = position + w * (late + ahead)
    heading = float(np.arctan2(d[1], d[0]))
    return [float(line.time.mean()) + ahead, float(x), float(y), heading, beta, v0, 0.1, 0.01, *map(float, w)]
