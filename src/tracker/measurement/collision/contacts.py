"""Finds the contacts of two balls in a clip, the striker of each, and first guesses for the fits."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.ndimage import minimum_filter1d

from synthcam_shared.arrays import Array
from tracker.measurement.collision.collision_model import AFTER, SPIN, TIED, compute_unit_vectors, tied_to_free
from tracker.measurement.collision.least_squares import BallPair
from tracker.measurement.positions import BallTrack, measure_separation
from tracker.settings import FitSettings

MAX_POSITIONS_OF_APPROACH = 6  # from which velocities before and after the contact are read


@dataclass(frozen=True, eq=False)
class Contact:
    """Two balls about one contact; ball 2, the striker, is the faster."""

    pair: BallPair
    frame: int  # of least separation
    reason: str = ""  # why it cannot be fitted
    first: int | None = None  # frames of a contact that lasts; None: `frame` alone
    last: int | None = None

    @property
    def start(self) -> int:
        """First frame in contact."""
        return self.frame if self.first is None else self.first

    @property
    def end(self) -> int:
        """Last frame in contact."""
        return self.frame if self.last is None else self.last


@dataclass(frozen=True)
class EarlierHit:
    """The state that earlier hits leave a ball in."""

    rolls_from: float = -np.inf  # until then it slides, s; inf: unknown
    spin: float = 0.0  # R w_z, m/s


@dataclass(frozen=True, eq=False)
class ContactCandidate:
    """A possible contact: two balls, each with the frames in which it has no other contact."""

    one: BallTrack
    other: BallTrack
    frame: int

    def is_marked(self, marked: Sequence[MarkedContact]) -> bool:
        """Test whether a user has marked it."""
        return any(mark.is_near((self.one.particle, self.other.particle), self.frame) for mark in marked)


class MarkedContact(NamedTuple):
    """A contact that a user has seen: numbers of two particles, and the frame."""

    one: int
    other: int
    frame: int

    def is_near(self, particles: Collection[int], frame: int) -> bool:
        """Test whether a contact of two particles is this one, by five frames or fewer between them."""
        return set(particles) == {self.one, self.other} and abs(frame - self.frame) <= 5


def find_contacts(
    balls: list[BallTrack], diameter: float, steps: float = 0.75, marked: Sequence[MarkedContact] = ()
) -> list[ContactCandidate]:
    """Find all contacts of the balls of a clip, in order of time; diameter in m.

    steps: frames' worth of approach by which balls that touch between two frames may be farther apart in both.
    marked: contacts to add; each replaces what is found near it.
    """
    found = [
        (k, a, b)
        for a, b in find_near_pairs(balls, diameter, steps)
        for k in _contact_frames(a, b, diameter, steps)
        if not any(mark.is_near((a.particle, b.particle), k) for mark in marked)
    ]
    named = {ball.particle: ball for ball in balls}
    found += [(mark.frame, named[mark.one], named[mark.other]) for mark in marked]
    found.sort(key=lambda m: m[0])
    out = []
    for i, (frame, a, b) in enumerate(found):
        cut = []
        for track in (a, b):
            others = [f for j, (f, *pair) in enumerate(found) if j != i and track in pair]
            first = max((f for f in others if f < frame), default=-1)
            last = min((f for f in others if f > frame), default=np.iinfo(np.int64).max)
            cut.append(track.where((track.frame > first) & (track.frame < last)))
        out.append(ContactCandidate(cut[0], cut[1], frame))
    return out


def find_second_touch(candidate: ContactCandidate, diameter: float) -> int | None:
    """Find the second contact of a clip: the frame in which balls come back to a diameter (m), or None.

    Rolling balls whose restitution is under .4 do so, because the striker rolls on faster than the struck ball.
    """
    smoothed = 5  # frames, over which the separation is averaged
    frames, apart, one, two = measure_separation(candidate.one, candidate.other)
    late = frames > candidate.frame
    if late.sum() < 2 * smoothed:
        return None
    noise = np.sqrt(np.trace(candidate.one.cov[one] + candidate.other.cov[two], axis1=1, axis2=2) / 2)
    error = float(np.median(noise)) / np.sqrt(smoothed)
    excess = np.convolve(apart[late], np.ones(smoothed) / smoothed, "valid") - diameter
    parted = np.flatnonzero(excess > 5 * error)
    back = np.flatnonzero(excess < 2 * error)
    back = back[back > parted[0]] if len(parted) else back[:0]
    return int(frames[late][back[0]]) if len(back) else None


def find_near_pairs(balls: list[BallTrack], diameter: float, steps: float) -> Iterator[tuple[BallTrack, BallTrack]]:
    """Iterate over the pairs whose paths come so near that `_contact_frames` may find a contact, by their bounds."""
    if len(balls) < 2:
        return
    low, high = (np.array([end(b.position, axis=0) for b in balls]) for end in (np.min, np.max))
    first, last = np.array([(b.frame[0], b.frame[-1]) for b in balls]).T
    gap = np.array([np.diff(b.frame).max(initial=1) for b in balls])
    fastest = [np.hypot(*(np.diff(b.position, axis=0) / np.diff(b.frame)[:, None]).T).max(initial=0.0) for b in balls]
    step = np.array(fastest)
    for i, ball in enumerate(balls[:-1]):
        rest = slice(i + 1, None)
        apart = np.hypot(*np.maximum(np.maximum(low[rest] - high[i], low[i] - high[rest]), 0.0).T)
        reach = 1.02 * diameter + steps * 1.001 * (step[rest] + step[i]) * np.maximum(gap[rest], gap[i])
        meet = np.minimum(last[rest], last[i]) - np.maximum(first[rest], first[i]) >= 4
        for j in np.flatnonzero((apart <= reach) & meet):
            yield ball, balls[i + 1 + j]


def find_slow_contacts(balls: list[BallTrack], diameter: float) -> list[ContactCandidate]:
    """Find contacts that noise hides from frame to frame: balls that approach, touch and part over many frames."""
    out, span = [], 40
    for a, b in find_near_pairs(balls, diameter, 1.0):
        frames, apart, _, _ = measure_separation(a, b)
        if len(frames) < 12:
            continue
        noise = float(np.sqrt(np.trace(np.median(a.cov, axis=0) + np.median(b.cov, axis=0)) / 2))
        near = np.flatnonzero(apart < diameter + 2 * noise)
        if not len(near):
            continue
        for run in np.split(near, np.flatnonzero(np.diff(near) > 3) + 1):
            slopes = []
            for rows in (slice(max(run[0] - span, 0), run[0]), slice(run[-1] + 1, run[-1] + 1 + span)):
                t = frames[rows] - frames[rows].mean() if len(frames[rows]) > 4 else np.zeros(len(frames[rows]))
                slopes.append(float(t @ apart[rows]) / np.sqrt(max(float(t @ t), 1e-300)) / noise)
            if slopes[0] < -5 and slopes[1] > 5:
                out.append(ContactCandidate(a, b, int(frames[run[np.argmin(apart[run])]])))
    return sorted(out, key=lambda candidate: candidate.frame)[:1]


def prepare_contact(
    candidate: ContactCandidate, diameter: float, earlier: Mapping[int, EarlierHit], settings: FitSettings
) -> Contact:
    """Prepare a contact of a clip for the fits: which ball strikes, and which positions count; diameter in m.

    earlier: by particle, the state after earlier hits. Positions while a ball still slides are left out.
    """
    balls, spin = [], 0.0
    for track in (candidate.one, candidate.other):
        past = earlier.get(track.particle, EarlierHit())
        rolls = track.where(track.start > past.rolls_from)
        if not (rolls.frame < candidate.frame).any() and (track.frame < candidate.frame).any():
            reason = "a ball still slides when it is hit again: how it spins then is not known well enough"
            if np.isinf(past.rolls_from):
                reason = "an earlier hit of a ball could not be measured"
            return Contact(BallPair(candidate.one, candidate.other, diameter), candidate.frame, reason)
        balls.append(_shorten_rest(rolls, candidate.frame))
        spin += past.spin
    return _assign_roles(BallPair(balls[0], balls[1], diameter, spin=spin, settings=settings), candidate.frame)


def fit_velocity(track: BallTrack) -> tuple[Array, Array, float]:
    """Fit a straight line to one side of a contact of a clip: velocity (2,) m/s, position (2,) m, and error, m/s."""
    t = track.time - track.time.mean()
    spread = float((t**2).sum())
    std = float(np.sqrt(np.trace(track.cov.mean(axis=0)) / 2 / spread))
    return t @ track.position / spread, track.position.mean(axis=0), std


def _read_beside(track: BallTrack, frame: int, after: bool) -> BallTrack:
    """The last few positions before a frame, or the first few after it; those 15 frames off do not show the contact."""
    ahead = track.frame - frame if after else frame - track.frame
    near = (ahead > 0) & (ahead <= 15)
    count = near.cumsum() if after else near[::-1].cumsum()[::-1]
    return track.where(near & (count <= MAX_POSITIONS_OF_APPROACH))


def _contact_frames(a: BallTrack, b: BallTrack, diameter: float, steps: float) -> list[int]:
    """Frames of least separation at which two balls touched and changed direction; gaps are bridged straight."""
    frames = np.arange(max(a.frame[0], b.frame[0]), min(a.frame[-1], b.frame[-1]) + 1)
    if len(frames) < 5:
        return []
    one, two = (np.stack([np.interp(frames, c.frame, axis) for axis in c.position.T]) for c in (a, b))
    apart = np.hypot(*(one - two))
    step = np.abs(np.diff(apart))
    found = []
    for k in np.flatnonzero(apart == minimum_filter1d(apart, 7, mode="nearest")):
        if not 0 < k < len(frames) - 1:
            continue
        reach = step[max(k - 3, 0) : k + 3].max() * max(_gap(c, int(frames[k])) for c in (a, b))
        if apart[k] < diameter * 1.01 + steps * reach and _changed_velocity(a, b, int(frames[k])):
            found.append(int(frames[k]))
    return found


def _gap(track: BallTrack, frame: int) -> int:
    """Longest gap, in frames, between positions next to a frame."""
    i = int(np.searchsorted(track.frame, frame))
    near = track.frame[max(i - 2, 0) : i + 3]
    return int(np.diff(near).max(initial=1))


def _changed_velocity(a: BallTrack, b: BallTrack, frame: int) -> bool:
    """Test whether the velocity of either ball changed there by more than noise and friction do."""
    for track in (a, b):
        early, late = (_read_beside(track, frame, after) for after in (False, True))
        if len(early) < 2 or len(late) < 2:
            continue
        (v, _, s), (w, _, q) = fit_velocity(early), fit_velocity(late)
        if np.linalg.norm(w - v) > max(6 * np.hypot(s, q), 0.05 * max(np.linalg.norm(v), np.linalg.norm(w))):
            return True
    return False


def _assign_roles(pair: BallPair, frame: int) -> Contact:
    """Make the faster ball before contact ball 2, and give the reason if a clip shows too little."""
    early = [_read_beside(track, frame, after=False) for _, track in pair.balls]
    if min(len(e) for e in early) < 2:
        return Contact(pair, frame, "the approach is not in view")
    speeds = [float(np.linalg.norm(fit_velocity(e)[0])) for e in early]
    if speeds[0] > speeds[1]:
        pair = replace(pair, struck=pair.striker, striker=pair.struck)
    rest = _rest_start(pair.struck, frame, 0.002 * max(speeds))  # slower than this is at rest for every purpose
    if rest is not None:
        pair = replace(pair, struck=pair.struck.where(pair.struck.frame >= rest))
    if min(int((c.frame > frame).sum()) for _, c in pair.balls) < 4:
        return Contact(pair, frame, "too few frames after the contact")
    return Contact(replace(pair, target_moves=rest is None), frame)


def _rest_start(track: BallTrack, frame: int, slow: float) -> int | None:
    """First frame from which a ball rests until the contact; None if it moves then.

    The stretch grows from the contact outwards for as long as one position describes it: a ball may have rolled to a
    stop before. The frame next to the contact may be late where others are missing.
    """
    before = track.where(track.frame < frame - 1)
    if len(before) < 2:
        before = track.where(track.frame < frame)
    first, count, last = None, MAX_POSITIONS_OF_APPROACH, len(before)
    while first is None or first > before.frame[0]:
        part = before.where(np.arange(last) >= last - count)
        v, _, std = fit_velocity(part)
        if np.linalg.norm(v) > max(slow, 5 * std):
            break
        first, count = int(part.frame[0]), 2 * count
    return first


def _shorten_rest(track: BallTrack, frame: int) -> BallTrack:
    """The ball without the part of a rest that is far from the contact: its positions share the error that limits."""
    longest, same = 150, 0.3  # positions that are kept; widths of a glint within which a ball has not moved
    if len(track) <= longest or track.width <= 0:
        return track
    keep = np.ones(len(track), dtype=bool)
    still = np.hypot(*(track.position[longest:] - track.position[:-longest]).T) < same * track.width
    keep[:-longest] &= ~(still & (track.frame[longest:] < frame))
    keep[longest:] &= ~(still & (track.frame[:-longest] > frame))
    return track.where(keep)


def guess_parameters(contact: Contact) -> list[Array]:
    """Guess tied parameters (16,) of a contact, the best first; none where the approach leads past the other ball.

    The launch comes from the approach alone: straight lines, and the time at which the balls are one diameter apart.
    The impact comes from a coarse grid over all physical values, the best for each friction. If frames about the
    contact are missing, the frames next to it are tried too.
    """
    near = np.arange(contact.frame - 2, contact.frame + 3)
    whole = all(np.isin(near, track.frame).all() for _, track in contact.pair.balls)
    grid = (0.5, 0.75, 0.95), (0.1, 0.2, 0.4), (0.1, 0.35)  # r, mu_k and C
    starts, rolling = [], [0.0] * len(SPIN)
    for frame in (contact.frame,) if whole else (contact.frame - 1, contact.frame, contact.frame + 1):
        launch = guess_launch(contact.pair, frame)
        if launch is not None:
            starts += [[*launch[:8], r, np.log(mu), c, *rolling, *launch[8:]] for r, mu, c in product(*grid)]
    if not starts:
        return []
    guesses = np.array(starts)
    ordered = guesses[np.argsort(_rough_chi2(contact.pair, guesses), kind="stable")]
    first = np.unique(ordered[:, TIED.index("log_mu")], return_index=True)[1]
    return list(ordered[np.sort(first)])


def _rough_chi2(pair: BallPair, tied: Array) -> Array:
    """Sums (k,) of squared distances, in their errors, between the positions after the hit and the guesses (k, 16).

    Rough: instants for exposures, and a rolling ball loses speed evenly.
    """
    free = np.asarray(tied_to_free(tied, pair.spin), dtype=np.float64)
    _, normal, _ = compute_unit_vectors(tied[:, 3], tied[:, 4])
    total = np.zeros(len(tied))
    for ball, track in pair.balls:
        at, contact = AFTER[ball], free[:, 1:3] - (ball - 1) * pair.diameter * normal
        v, f, tau = free[:, at : at + 2], free[:, at + 2 : at + 4], np.exp(free[:, at + 4 : at + 5])
        later = track.time > free[:, 0].min()
        since = track.time[later] - free[:, :1]  # (k, n)
        slide = np.clip(since, 0.0, tau)
        speed = np.maximum(np.hypot(f[:, 0], f[:, 1]), 1e-9)[:, None]
        loss = free[:, 6:7] * speed + free[:, 7:8]
        roll = np.clip(since - tau, 0.0, speed / loss)
        grown = roll - loss * roll**2 / (2 * speed) + slide**2 / (2 * tau)  # weight of f
        distance = (slide - slide**2 / (2 * tau))[..., None] * v[:, None] + grown[..., None] * f[:, None]
        off = contact[:, None] + distance - track.position[later]
        total += np.where(since > 0, track.whiten.distance(off, later), 0.0).sum(-1)
    return total


def guess_launch(pair: BallPair, frame: int) -> list[float] | None:
    """Guess the first eight tied parameters and ball 1's velocity, from positions before a contact in `frame`."""
    line, target = (_read_beside(track, frame, after=False) for track in (pair.striker, pair.struck))
    if len(line) < 2 or len(target) < 1 + pair.target_moves:
        return None
    v, middle, _ = fit_velocity(line)
    w, position = fit_velocity(target)[:2] if pair.target_moves else (np.zeros(2), target.position.mean(axis=0))
    late = float(line.time.mean() - target.time.mean()) if pair.target_moves else 0.0
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
