"""Finds the contacts in the tracks of any number of balls: which balls, when, where, and how sure that is.

A contact is a kink of two paths at a distance of one diameter. A kink of one path alone is a wall, or something unseen.
Short paths before and after a contact are parabolas whose curvature is at most that of a sliding ball. The contact is
the instant at which they meet and the balls are a diameter apart. Its evidence is the chi^2 by which two such paths fit
better than one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from tracker.measurement.collision.collision_model import GRAVITY
from tracker.measurement.collision.contacts import find_near_pairs
from tracker.measurement.positions import BallTrack
from tracker.measurement.stretch_cuts import StretchCutter, measure_noise

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
NO_BALL = -1  # in place of a second ball: a wall, or something unseen
CUTTER = StretchCutter(kink_positions=3, max_acceleration=2.4, kink_sigma=4.0)  # candidates only
_NOTHING = np.full(2, np.nan)


@dataclass(frozen=True)
class FinderSettings:
    """How contacts are found."""

    positions: int = 6  # of a path before a contact
    positions_after: int = 4  # and after it, where a slide may end
    least_positions: int = 2
    curvature: float = 2.0  # rms acceleration of a ball beyond that of its slide after the contact, m/s^2
    friction: float = 0.2  # of the plate, on which a ball slides after a contact; 0 of bodies that glide
    distance_share: float = 0.016  # error of the distance at which balls touch, diameters
    near_share: float = 0.05  # farther than a diameter by this, balls do not touch
    prior_log_odds: float = -10.0  # of a contact at a position and time at which one is searched
    least_confidence: float = 0.5
    same_frames: float = 1.5  # within which two contacts of a ball are one kink
    vague_frames: float = 3.5  # the same, where the instants are not yet known
    other_frames: float = 0.5  # from which on another contact of a ball is not this one
    event_frames: float = 0.1  # from an event to the first position that counts
    unseen_share: float = 0.5  # of a kick within `same_frames` of another, by which both may be mixed
    slide_share: float = 0.04  # error of a kick, relative, by the slide after it
    turns: int = 3
    least_impulse_sigma: float = 3.0
    least_alignment: float = 0.85  # cosine between a kick and the line of centres
    rough_share: float = 0.1  # by which the distance of balls may be off a diameter, where paths are too short


@dataclass(frozen=True)
class TrackContact:
    """A contact of two balls, or of one with a wall.

    Attributes
    ----------
    time, time_std : float
        Instant and its standard error, s.
    one, other : int
        Particles; `other` is NO_BALL for a wall.
    xy : (2,) array
        Where the surfaces touch, m; of a wall the centre of the ball.
    normal : (2,) array
        Unit vector along which ball `one` is pushed.
    kick, kick_std : float
        Change of the velocity of `one` along `normal`, m/s; of two balls half the change of their relative velocity.
    gain : float
        chi^2 by which the contact fits better than none.
    confidence : float
        A score from 0 to 1 that grows with `gain`; it is no calibrated probability.
    """

    time: float
    time_std: float
    one: int
    other: int
    xy: Floats
    normal: Floats
    kick: float
    kick_std: float
    gain: float
    confidence: float

    @property
    def balls(self) -> tuple[int, ...]:
        """Its particles."""
        return (self.one,) if self.other == NO_BALL else (self.one, self.other)


class _Path(NamedTuple):
    """A parabola: position, velocity and half the acceleration at its origin of time, with their covariance."""

    value: Floats  # (3, 2)
    cov: Floats  # (3, 3)
    chi2: float

    def at(self, time: Floats) -> tuple[Floats, Floats]:
        """Positions (m, 2) and their variances (m,)."""
        powers = np.stack([np.ones_like(time), time, time**2], axis=1)
        return powers @ self.value, np.einsum("mi,ij,mj->m", powers, self.cov, powers)

    def velocity(self, time: float) -> tuple[Floats, float]:
        """Velocity (2,) and its variance."""
        powers = np.array([0.0, 1.0, 2 * time])
        return powers @ self.value, float(powers @ self.cov @ powers)


def _fit_path(time: Floats, position: Floats, variance: float, curvature: float) -> _Path:
    basis = np.stack([np.ones_like(time), time, time**2], axis=1)
    square = basis.T @ basis / variance
    square[2, 2] += 4 / curvature**2
    cov = np.asarray(np.linalg.inv(square), dtype=np.float64)
    value = cov @ (basis.T @ position) / variance
    left = position - basis @ value
    return _Path(value, cov, float((left**2).sum() / variance + (2 * value[2] ** 2).sum() * 2 / curvature**2))


def _fit_slide(
    time: Floats,
    position: Floats,
    variance: float,
    sides: Sequence[_Path | None],
    settings: FinderSettings,
    *,
    turns: int = 2,
) -> _Path | None:
    """Fit the path after a contact at time 0 without the way that a ball loses while it slides.

    A ball that rolled slides after a kick, against the kick, until two sevenths of the kick are lost.
    """
    before, after = sides
    for _ in range(turns):  # the kick and the slide depend on one another
        if before is None or after is None:
            break
        kick = after.velocity(0.0)[0] - before.velocity(0.0)[0]
        size = max(float(np.hypot(*kick)), 1e-12)
        decel = settings.friction * GRAVITY
        lasts = np.minimum(time, 2 * size / (7 * decel))
        lost = decel * lasts * (time - lasts / 2)
        after = _fit_path(time, position + np.outer(lost, kick / size), variance, settings.curvature)
    return after


class _Found(NamedTuple):
    """The best instant of a contact, and what is known there."""

    time: float
    time_std: float
    chi2: float
    smooth: float  # chi^2 without a contact
    excess: float  # chi^2 over its degrees of freedom, at least 1
    places: Floats  # (balls, 2)
    before: Floats  # (balls, 2) velocities; NaN where too few positions show one
    after: Floats
    velocity_std: Floats  # (balls,) of the change


def find_track_contacts(
    balls: Sequence[BallTrack], diameter: float, settings: FinderSettings | None = None, *, glides: bool = False
) -> list[TrackContact]:
    """Find all contacts in the tracks of a recording, in order of time; diameter: m.

    glides: whether the bodies glide, as on air, and do not slide after a contact until they roll.
    """
    settings = settings or FinderSettings()
    settings = replace(settings, friction=0.0) if glides else settings
    noise = measure_noise([(ball.frame, ball.position) for ball in balls])
    kinks = {ball.particle: _find_kinks(ball, noise) for ball in balls}
    by_number = {ball.particle: ball for ball in balls}
    frame_s = _frame_duration(balls)
    pairs = [
        (one, other, frame)
        for one, other in find_near_pairs(list(balls), diameter, 1.0)
        for frame in _find_approaches(one, other, diameter, settings)
    ]
    # of each ball, when something may have happened to it
    events = {n: [*at.tolist(), *(f for a, b, f in pairs if n in (a.particle, b.particle))] for n, at in kinks.items()}
    found = list[TrackContact]()
    for turn in range(settings.turns):  # each with better instants of the contacts before and after
        away = settings.other_frames if turn else settings.vague_frames
        tried = [
            contact
            for one, other, frame in pairs
            if (contact := _examine((one, other), frame, events, away, frame_s, diameter, settings)) is not None
        ]
        found = list[TrackContact]()
        for contact in sorted(tried, key=lambda contact: -contact.gain):
            if not _is_explained(contact, found, frame_s, settings):
                found.append(contact)
        events = {n: _list_events(by_number[n], kinks[n], found, settings) for n in kinks}
        centres = {(c.one, c.other): c for c in found}
        pairs = [(one, other, _refine(one, other, frame, centres, settings)) for one, other, frame in pairs]
    for ball in balls:
        own = [float(np.interp(c.time, ball.time, ball.frame)) for c in found if ball.particle in c.balls]
        for frame in kinks[ball.particle].tolist():
            if min((abs(at - frame) for at in own), default=np.inf) > settings.same_frames:
                contact = _examine((ball,), frame, events, settings.other_frames, frame_s, diameter, settings)
                if contact is not None:
                    found.append(contact)
    return _widen_errors(_find_partners(found, balls, diameter, frame_s, settings), frame_s, settings)


def _widen_errors(found: Sequence[TrackContact], frame_s: float, settings: FinderSettings) -> list[TrackContact]:
    """The contacts in order of time, with larger errors where a ball has another contact within a frame or so.

    Its path between both is not seen. The path after both then is off by the other kick times the time between.
    """
    found, out, same = sorted(found, key=lambda contact: contact.time), [], settings.same_frames * frame_s
    time = np.array([contact.time for contact in found])
    for contact in found:
        late = kick = 0.0
        first, last = np.searchsorted(time, (contact.time - same, contact.time + same))
        for other in found[first:last]:
            if other is not contact and set(other.balls) & set(contact.balls):
                kick = max(kick, settings.unseen_share * other.kick)
                share = settings.unseen_share * min(other.kick / contact.kick, 1.0)
                late = max(late, share * max(abs(other.time - contact.time), same / 3))
        time_std, kick_std = np.hypot(contact.time_std, late), np.hypot(contact.kick_std, kick / 2)
        out.append(replace(contact, time_std=float(time_std), kick_std=float(kick_std)))
    return out


def _find_partners(
    found: Sequence[TrackContact],
    balls: Sequence[BallTrack],
    diameter: float,
    frame_s: float,
    settings: FinderSettings,
) -> list[TrackContact]:
    """The contacts, where a kink of one ball is that with a ball whose own path is too short to show it.

    The other ball lies a diameter behind the kick. It has a kink of its own, of that contact or of another.
    """
    out, same = list(found), settings.same_frames * frame_s
    for contact in sorted(found, key=lambda contact: -contact.gain):
        if len(contact.balls) == 2 or not any(c is contact for c in out):
            continue
        near = {n for c in found for n in c.balls if c is not contact and abs(c.time - contact.time) < same}
        best, chosen = settings.least_alignment, None
        for ball in balls:
            if ball.particle == contact.one or ball.particle not in near:
                continue
            place = np.array([np.interp(contact.time, ball.time, axis) for axis in ball.position.T])
            apart = contact.xy - place
            size = max(float(np.hypot(*apart)), 1e-12)
            aligned = float(apart @ contact.normal) / size
            if abs(size / diameter - 1) < settings.rough_share and aligned > best:
                best, chosen = aligned, (ball.particle, apart / size, place)
        pair = None if chosen is None else {contact.one, chosen[0]}
        if chosen is None or any(set(c.balls) == pair and abs(c.time - contact.time) < same for c in out):
            continue
        middle = (contact.xy + chosen[2]) / 2
        whole = replace(contact, other=chosen[0], normal=chosen[1], xy=middle)
        out = [
            c
            for c in out
            if c is not contact
            and not (c.balls == (chosen[0],) and abs(c.time - contact.time) < same and c.normal @ chosen[1] < -best / 2)
        ]
        out.append(whole)
    return out


def _list_events(
    ball: BallTrack, kinks: Floats, found: Sequence[TrackContact], settings: FinderSettings
) -> list[float]:
    """Frames, with parts of them, of what happened to a ball: its contacts, and kinks that none explains."""
    own = [float(np.interp(c.time, ball.time, ball.frame)) for c in found if ball.particle in c.balls]
    free = [at for at in kinks.tolist() if min((abs(at - f) for f in own), default=np.inf) > settings.vague_frames]
    return [*own, *free]


def _refine(
    one: BallTrack,
    other: BallTrack,
    frame: float,
    found: dict[tuple[int, int], TrackContact],
    settings: FinderSettings,
) -> float:
    """The frame of a contact of two balls as it was found, if it was."""
    contact = found.get((one.particle, other.particle))
    at = np.inf if contact is None else float(np.interp(contact.time, one.time, one.frame))
    return at if abs(at - frame) < settings.vague_frames else frame


def _frame_duration(balls: Sequence[BallTrack]) -> float:
    steps = [np.diff(ball.time) / np.diff(ball.frame) for ball in balls if len(ball) > 1]
    return float(np.median(np.concatenate(steps))) if steps else np.nan


def _find_kinks(ball: BallTrack, noise: float) -> Floats:
    """Frames, with halves, at which the path of a ball has a kink."""
    at = CUTTER.find_kinks(ball.time, CUTTER.measure_kinks(ball.time, ball.position, noise))
    return np.interp(at, ball.time, ball.frame)


def _find_approaches(one: BallTrack, other: BallTrack, diameter: float, settings: FinderSettings) -> list[float]:
    """Frames at which two balls are nearest to one another, and near enough to touch."""
    frames, mine, its = np.intersect1d(one.frame, other.frame, return_indices=True)
    if len(frames) < 2 * settings.least_positions:
        return []
    apart = np.hypot(*(one.position[mine] - other.position[its]).T)
    step = np.abs(np.diff(apart))
    reach = np.maximum(np.append(step, 0.0), np.append(0.0, step))
    least = (apart <= np.append(apart[1:], np.inf)) & (apart < np.append(np.inf, apart[:-1]))
    return [float(f) for f in frames[least & (apart < diameter * (1 + settings.near_share) + 1.5 * reach)]]


def _examine(
    pair: tuple[BallTrack, ...],
    frame: float,
    events: dict[int, list[float]],
    away: float,
    frame_s: float,
    diameter: float,
    settings: FinderSettings,
) -> TrackContact | None:
    """The contact of two balls, or of one with a wall, at about a frame; None if there is none.

    events: by particle, frames at which other things happen. away: frames within which they are the same as this.
    """
    fits = list[_Found]()
    parts = [_cut(ball, frame, events[ball.particle], away, settings) for ball in pair]
    if max(len(part) for part in parts) < 2 * settings.least_positions:
        return None
    gaps = np.unique(np.concatenate([part.frame for part in parts]))
    gaps = gaps[(gaps >= frame - 2.5) & (gaps <= frame + 2.5)]
    for left, right in pairwise(gaps):
        here = _fit_gap(parts, int(left), int(right), frame_s, diameter, settings)
        if here is not None:
            fits.append(here)
    return _judge(pair, _weigh_gaps(fits), diameter, settings) if fits else None


def _weigh_gaps(fits: Sequence[_Found]) -> _Found:
    """The best of the fits of several gaps, with the error of an instant that may lie in another of them."""
    best = min(fits, key=lambda fit: fit.chi2)
    time, std, chi2 = np.array([(fit.time, fit.time_std, fit.chi2) for fit in fits]).T
    weight = std * np.exp((best.chi2 - chi2) / (2 * best.excess))
    return best._replace(time_std=float(np.sqrt(weight @ (std**2 + (time - best.time) ** 2) / weight.sum())))


def _cut(ball: BallTrack, frame: float, events: list[float], away: float, settings: FinderSettings) -> BallTrack:
    """The positions of a ball about a frame, up to its next event on either side."""
    low = max((at for at in events if at < frame - away), default=-np.inf)
    high = min((at for at in events if at > frame + away), default=np.inf)
    rows = (ball.frame > low + settings.event_frames) & (ball.frame < high - settings.event_frames)
    rows &= (ball.frame >= frame - settings.positions - 2) & (ball.frame <= frame + settings.positions_after + 2)
    return ball.where(rows)


def _fit_gap(
    parts: Sequence[BallTrack],
    left: int,
    right: int,
    frame_s: float,
    diameter: float,
    settings: FinderSettings,
    *,
    steps_in_gap: int = 8,
) -> _Found | None:
    """The best instant between two frames; None where a ball has too few positions before or after.

    steps_in_gap: instants between two frames that are tried.
    """
    if min(map(len, parts)) == 0:
        return None
    zero = float(np.mean([_time_of((left + right) / 2, part, frame_s) for part in parts]))
    low, high = (
        max(_time_of(left, part, frame_s) for part in parts) - zero,
        min(_time_of(right, part, frame_s) for part in parts) - zero,
    )
    if not low < high:
        return None
    times = np.linspace(low, high, steps_in_gap + 1)
    cost, smooth, dof = np.zeros(len(times)), 0.0, 1
    places, spread, ways = list[Floats](), list[Floats](), list[tuple[_Path | None, _Path | None]]()
    for part in parts:
        early, late = part.frame <= left, part.frame >= right
        seen = [rows.sum() >= settings.least_positions for rows in (early, late)]
        if not any(seen) or not (all(seen) or len(parts) == 2):
            return None
        variance = float(np.median(np.trace(part.cov, axis1=1, axis2=2))) / 2
        sides = [
            _fit_path(part.time[rows] - zero, part.position[rows], variance, settings.curvature) if known else None
            for rows, known in zip((early, late), seen, strict=True)
        ]
        if all(seen) and settings.friction:
            sides[1] = _fit_slide(part.time[late] - zero, part.position[late], variance, sides, settings)
        known_sides = [(side.chi2, *side.at(times)) for side in sides if side is not None]
        chi2, (place, var) = sum(side[0] for side in known_sides), known_sides[0][1:]
        cost += chi2
        if len(known_sides) == 2:
            other, other_var = known_sides[1][1:]
            cost += ((place - other) ** 2).sum(axis=1) / (var + other_var)
            weight = (other_var / (var + other_var))[:, None]
            place, var = place * weight + other * (1 - weight), var * weight[:, 0]
            chi2 = _fit_path(part.time - zero, part.position, variance, settings.curvature).chi2
        smooth += chi2
        dof += max(2 * len(part) - 4 * len(known_sides), 0)
        places.append(place)
        spread.append(var)
        ways.append((sides[0], sides[1]))
    if not any(None not in way for way in ways):
        return None
    if len(parts) == 2:
        apart = np.hypot(*(places[0] - places[1]).T)
        variance_of_distance = (settings.distance_share * diameter) ** 2 + spread[0] + spread[1]
        cost += (apart - diameter) ** 2 / variance_of_distance
    at, bend = _find_least(times, cost)
    k = int(np.argmin(cost))
    excess = max(float(cost[k]) / dof, 1.0)
    exposed = min(at - low, high - at) < parts[0].exposure / 2  # a frame shows both paths
    blur = parts[0].exposure / 2 if exposed else 0.0
    velocities = [[None if side is None else side.velocity(at) for side in way] for way in ways]
    return _Found(
        time=zero + at,
        time_std=min(float(np.hypot(np.sqrt(2 / bend * excess), blur)), float(high - low)),
        chi2=float(cost[k]),
        smooth=smooth,
        excess=excess,
        places=np.array([place[k] for place in places]),
        before=np.array([_NOTHING if first is None else first[0] for first, _ in velocities]),
        after=np.array([_NOTHING if second is None else second[0] for _, second in velocities]),
        velocity_std=np.sqrt([np.nan if None in way else sum(side[1] for side in way if side) for way in velocities]),
    )


def _find_least(times: Floats, cost: Floats) -> tuple[float, float]:
    """The instant of the least cost, by a parabola about the least of those tried, and the cost's second derivative."""
    k = int(np.argmin(cost))
    inner = min(max(k, 1), len(times) - 2)
    step = times[1] - times[0]
    bend = max(float(cost[inner + 1] - 2 * cost[inner] + cost[inner - 1]) / step**2, 1e-300)
    slope = (cost[inner + 1] - cost[inner - 1]) / (2 * step)
    if 0 < k < len(times) - 1:
        return float(np.clip(times[inner] - slope / bend, times[0], times[-1])), bend
    return float(times[k]), bend


def _time_of(frame: float, part: BallTrack, frame_s: float) -> float:
    """The instant, s, of a frame that a track may lack."""
    k = int(np.argmin(np.abs(part.frame - frame)))
    return float(part.time[k] + (frame - part.frame[k]) * frame_s)


def _judge(
    pair: tuple[BallTrack, ...], found: _Found, diameter: float, settings: FinderSettings
) -> TrackContact | None:
    """The contact, if the paths show one."""
    turn = found.after - found.before
    gain = found.smooth - found.chi2
    confidence = float(expit(gain / 2 + settings.prior_log_odds))
    if not confidence >= settings.least_confidence:
        return None
    if len(pair) == 1:
        size = float(np.hypot(*turn[0]))
        normal, place, kick, error = turn[0] / max(size, 1e-12), found.places[0], size, float(found.velocity_std[0])
    else:
        normal = found.places[0] - found.places[1]
        apart = float(np.hypot(*normal))
        if apart > (1 + settings.near_share) * diameter:
            return None
        normal, place = normal / apart, found.places.mean(axis=0)
        kicks = np.array([turn[0] @ normal, -turn[1] @ normal])  # equal, if the balls are
        kick, error = (
            float(np.nanmean(kicks)),
            float(np.sqrt(np.nanmean(found.velocity_std**2) / np.isfinite(kicks).sum())),
        )
        approach = float((found.before[0] - found.before[1]) @ normal)
        if approach > settings.least_impulse_sigma * error or not kick > settings.least_impulse_sigma * error:
            return None
    if settings.friction:
        error = float(np.hypot(error, settings.slide_share * kick))
    other = pair[1].particle if len(pair) == 2 else NO_BALL
    return TrackContact(
        found.time, found.time_std, pair[0].particle, other, place, normal, kick, error, gain, confidence
    )


def _is_explained(
    contact: TrackContact, found: Sequence[TrackContact], frame_s: float, settings: FinderSettings
) -> bool:
    """Decide whether other contacts of both balls at that instant explain the kinks."""
    near = [c for c in found if abs(c.time - contact.time) < settings.same_frames * frame_s]
    return set(contact.balls) <= {n for c in near for n in c.balls}
