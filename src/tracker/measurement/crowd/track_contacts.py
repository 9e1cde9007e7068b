"""Finds the contacts in the tracks of any number of balls: which balls, when, where, and how sure that is.

A contact is a kink of two paths at a distance of one diameter. A kink of one path alone is a wall, or something unseen.
Short paths before and after a contact are parabolas whose curvature is at most that of a sliding ball. The contact is
the instant at which they meet and the balls are a diameter apart. Its evidence is the chi^2 by which two such paths fit
better than one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import expit

from tracker.measurement.collision.collision_model import GRAVITY
from tracker.measurement.collision.contacts import find_near_pairs
from tracker.measurement.positions import BallTrack
from tracker.measurement.stretch_cuts import StretchCutter, measure_noise

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
NO_BALL = -1  # in place of a second ball: a wall, or something unseen
CUTTER = StretchCutter(kink_positions=3, max_acceleration=2.4, kink_sigma=4.0)  # candidates only
MAX_SPIN_TRANSFER = 5 / 14  # of balls whose surfaces stick to one another
_NOTHING = np.full(2, np.nan)


@dataclass(frozen=True)
class FinderSettings:
    """How contacts are found."""

    positions: int = 6  # of a path before a contact
    positions_after: int = 6  # and after it, where a slide may end
    least_positions: int = 2
    curvature: float = 2.0  # rms acceleration of a ball beyond that of its slide after the contact, m/s^2
    friction: float = 0.2  # of the plate, on which a ball slides after a contact; 0 of bodies that glide
    known_curvature: float = 0.2  # the same, where the film shows the friction
    least_slides: int = 6  # contacts that show it
    most_slides: int = 15  # of those with the greatest evidence
    most_worse: float = 3.0  # log-likelihood of each that the smaller curvature may cost
    spin_transfer: float = 0.3  # share of the relative speed of the surfaces that a contact gives to a spin
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
    known_slide_share: float = 0.016  # the same, where the film shows the friction
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
    slips : (balls, 2) array
        Velocities of the lowest points just after, m/s, against which balls slide; NaN if unknown, 0 if they glide.
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
    slips: Floats

    @property
    def balls(self) -> tuple[int, ...]:
        """Its particles."""
        return (self.one,) if self.other == NO_BALL else (self.one, self.other)


class _Slide(NamedTuple):
    """A ball that slides against its slip, the speed of its lowest point, until two sevenths of it are lost."""

    start: float  # s
    slip: Floats  # (2,) there
    decel: float

    @property
    def duration(self) -> float:
        return 2 * float(np.hypot(*self.slip)) / (7 * self.decel)

    @property
    def direction(self) -> Floats:
        return self.slip / max(float(np.hypot(*self.slip)), 1e-12)

    def shape(self, time: Floats) -> Floats:
        """The way (m,) that the ball lost since the start."""
        since = np.maximum(time - self.start, 0.0)
        lasts = np.minimum(since, self.duration)
        return np.asarray(self.decel * lasts * (since - lasts / 2))

    def rate(self, time: float) -> float:
        """The speed that the ball lost since the start."""
        return self.decel * min(max(time - self.start, 0.0), self.duration)

    def left(self, time: float) -> Floats:
        """Compute the slip (2,) at a later instant."""
        return self.slip * max(1 - (time - self.start) / max(self.duration, 1e-12), 0.0)


class _Path(NamedTuple):
    """A parabola: position, velocity and half the acceleration at its origin of time, with their covariance.

    A slide from before adds the way that the ball lost, times a vector near minus its direction.
    """

    value: Floats  # (3 or 4, 2)
    cov: Floats
    chi2: float
    slide: _Slide | None = None

    def at(self, time: Floats) -> tuple[Floats, Floats]:
        """Positions (m, 2) and their variances (m,)."""
        basis = _make_basis(time, self.slide)
        return basis @ self.value, ((basis @ self.cov) * basis).sum(axis=1)

    def velocity(self, time: float) -> tuple[Floats, float]:
        """Velocity (2,) and its variance."""
        basis = np.array([0.0, 1.0, 2 * time, *([] if self.slide is None else [self.slide.rate(time)])])
        return basis @ self.value, float(basis @ self.cov @ basis)


def _make_basis(time: Floats, slide: _Slide | None) -> Floats:
    basis = np.empty((len(time), 3 if slide is None else 4))
    basis[:, 0], basis[:, 1], basis[:, 2] = 1.0, time, time * time
    if slide is not None:
        basis[:, 3] = slide.shape(time)
    return basis


def _fit_path(
    time: Floats,
    position: Floats,
    variance: float,
    curvature: float,
    slide: _Slide | None = None,
    *,
    slide_error: float = 0.2,
) -> _Path:
    """Fit a parabola whose acceleration is `curvature` or so; slide_error: relative, of either component of its way."""
    basis = _make_basis(time, slide)
    square, right = basis.T @ basis / variance, basis.T @ position / variance
    square[2, 2] += 4 / curvature**2
    if slide is not None:
        square[3, 3] += 1 / slide_error**2
        right[3] -= slide.direction / slide_error**2
    cov = np.asarray(np.linalg.inv(square), dtype=np.float64)
    value = cov @ right
    left, bend = position - basis @ value, value[2]
    chi2 = np.vdot(left, left) / variance + np.vdot(bend, bend) * 4 / curvature**2
    if slide is not None:
        away = value[3] + slide.direction
        chi2 += np.vdot(away, away) / slide_error**2
    return _Path(value, cov, float(chi2), slide)


def _fit_slides(
    parts: Sequence[BallTrack],
    late: Sequence[NDArray[np.bool_]],
    zero: float,
    start: float,
    variances: Sequence[float],
    ways: list[list[_Path | None]],
    settings: FinderSettings,
    *,
    turns: int = 2,
) -> list[Floats]:
    """Fit the paths after a contact again, as if no ball slid there; returns the slips.

    late: rows after the contact. start: of the slides, s after the instant `zero`.
    """
    slips = list[Floats]()
    for _ in range(turns):  # the kick and the slide depend on one another
        slips = _predict_slips(ways, start, settings)
        for way, slip, part, rows, variance in zip(ways, slips, parts, late, variances, strict=True):
            if np.isfinite(slip).all():
                time = part.time[rows] - zero
                slide = _Slide(start, slip, settings.friction * GRAVITY)
                position = part.position[rows] + np.outer(slide.shape(time), slide.direction)
                way[1] = _fit_path(time, position, variance, settings.curvature)
    return slips


def _predict_slips(ways: Sequence[Sequence[_Path | None]], start: float, settings: FinderSettings) -> list[Floats]:
    """Predict how fast the lowest point of each ball slides after a contact; NaN where a path is not known.

    The kick adds to what is left of the slip of an earlier contact. The surfaces of balls that roll also drag one
    another upwards or downwards, and change the spins. A wall does that twice as much as a ball at rest.
    """
    before, after = (
        [_NOTHING if side is None else side.velocity(start)[0] for side in sides] for sides in zip(*ways, strict=True)
    )
    left = [np.zeros(2) if way[0] is None or way[0].slide is None else way[0].slide.left(start) for way in ways]
    kicks = [new - old for old, new in zip(before, after, strict=True)]
    rolled = [velocity - slip for velocity, slip in zip(before, left, strict=True)]
    if len(ways) == 1:
        normal, share = kicks[0], 2 * settings.spin_transfer
    else:
        places = [next(side for side in way if side is not None).at(np.array([start]))[0][0] for way in ways]
        normal, share = places[0] - places[1], settings.spin_transfer
    normal = normal / max(float(np.hypot(*normal)), 1e-12)
    speeds = [float(velocity @ normal) for velocity in rolled]
    dragged = share * sum(speed for speed in speeds if np.isfinite(speed)) * normal
    return [slip + kick + dragged for slip, kick in zip(left, kicks, strict=True)]


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
    slips: Floats  # (balls, 2)


@dataclass
class _Film:
    """A recording of balls, and what is known of their contacts so far."""

    frame_s: float
    diameter: float
    settings: FinderSettings
    events: dict[int, list[float]]  # of each ball, frames at which something may have happened to it
    slides: dict[int, list[_Slide]] = field(default_factory=dict)  # of each ball, in order of time

    def note_slides(self, found: Sequence[TrackContact]) -> None:
        """Keep the slides after these contacts."""
        self.slides, decel = {}, self.settings.friction * GRAVITY
        if not decel:
            return
        for contact in sorted(found, key=lambda contact: contact.time):
            for ball, slip in zip(contact.balls, contact.slips, strict=True):
                if np.isfinite(slip).all():
                    self.slides.setdefault(ball, []).append(_Slide(contact.time, slip, decel))

    def fit_path(self, part: BallTrack, zero: float, variance: float) -> _Path:
        """Fit a part of a track, with the slide of the last contact before it if that fits better.

        zero: the instant from which times count.
        """
        time, curvature = part.time - zero, self.settings.curvature
        before = [slide for slide in self.slides.get(part.particle, ()) if slide.start < part.time[0]]
        rolls = _fit_path(time, part.position, variance, curvature)
        if not before or before[-1].start + before[-1].duration < part.time[0]:
            return rolls
        slide = before[-1]._replace(start=before[-1].start - zero)
        return min(rolls, _fit_path(time, part.position, variance, curvature, slide), key=lambda path: path.chi2)


def find_track_contacts(
    balls: Sequence[BallTrack], diameter: float, settings: FinderSettings | None = None, *, glides: bool = False
) -> list[TrackContact]:
    """Find all contacts in the tracks of any number of balls, in order of time; diameter: m.

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
    events = {n: [*at.tolist(), *(f for a, b, f in pairs if n in (a.particle, b.particle))] for n, at in kinks.items()}
    film = _Film(frame_s, diameter, settings, events)
    found = list[TrackContact]()
    for turn in range(settings.turns):  # each with better instants of the contacts before and after
        away = settings.other_frames if turn else settings.vague_frames
        tried = [
            contact for one, other, frame in pairs if (contact := _examine((one, other), frame, away, film)) is not None
        ]
        found = list[TrackContact]()
        for contact in sorted(tried, key=lambda contact: -contact.gain):
            if not _is_explained(contact, found, frame_s, settings):
                found.append(contact)
        film.events = {n: _list_events(by_number[n], kinks[n], found, settings) for n in kinks}
        if settings.friction and film.settings.curvature > settings.known_curvature and turn < settings.turns - 1:
            film.settings = _fit_friction(found, by_number, film)
        film.note_slides(found)
        centres = {(c.one, c.other): c for c in found}
        pairs = [(one, other, _refine(one, other, frame, centres, settings)) for one, other, frame in pairs]
    for ball in balls:
        own = [float(np.interp(c.time, ball.time, ball.frame)) for c in found if ball.particle in c.balls]
        for frame in kinks[ball.particle].tolist():
            if min((abs(at - frame) for at in own), default=np.inf) > settings.same_frames:
                contact = _examine((ball,), frame, settings.other_frames, film)
                if contact is not None:
                    found.append(contact)
    return _widen_errors(_find_partners(found, balls, diameter, frame_s, settings), frame_s, settings)


def _fit_friction(found: Sequence[TrackContact], balls: dict[int, BallTrack], film: _Film) -> FinderSettings:
    """The settings with the friction of the plate, and the drag of surfaces, by which slides fit best.

    Without enough contacts these stay as they are.
    """
    settings = film.settings
    best = sorted((c for c in found if len(c.balls) == 2), key=lambda contact: -contact.gain)[: settings.most_slides]
    if len(best) < settings.least_slides:
        return settings
    places = list[tuple[list[BallTrack], int]]()
    for contact in best:
        frame = float(np.interp(contact.time, balls[contact.one].time, balls[contact.one].frame))
        parts = [_cut(balls[n], frame, film.events[n], settings.other_frames, settings) for n in contact.balls]
        places.append((parts, int(np.floor(frame))))

    def misfit(friction: float, spin_transfer: float, curvature: float = settings.known_curvature) -> float:
        """Minus the log-likelihood, with heavy tails because events are missed."""
        tried = replace(settings, friction=friction, spin_transfer=spin_transfer, curvature=curvature)
        fits = [_fit_gap(parts, left, left + 1, replace(film, settings=tried)) for parts, left in places]
        dof = 2 * (settings.positions + settings.positions_after)
        return float(sum(dof / 2 * np.log1p(fit.chi2 / dof) for fit in fits if fit is not None))

    start = FinderSettings()
    friction = float(
        minimize_scalar(
            lambda mu: misfit(mu, start.spin_transfer) + (np.log(mu / start.friction) / np.log(2)) ** 2 / 2,
            bounds=(start.friction / 8, start.friction * 4),
            method="bounded",
            options={"xatol": 0.01},
        ).x
    )
    transfer = float(
        minimize_scalar(
            lambda c: misfit(friction, c) + ((c - start.spin_transfer) / start.spin_transfer) ** 2 / 2,
            bounds=(0.0, MAX_SPIN_TRANSFER),
            method="bounded",
            options={"xatol": 0.04},
        ).x
    )
    worse = misfit(friction, transfer) - misfit(friction, transfer, start.curvature)
    if worse > settings.most_worse * len(best):  # other forces bend the paths
        return replace(settings, friction=friction, spin_transfer=transfer)
    return replace(
        settings,
        friction=friction,
        spin_transfer=transfer,
        curvature=settings.known_curvature,
        slide_share=settings.known_slide_share,
    )


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
    away: float,
    film: _Film,
) -> TrackContact | None:
    """The contact of two balls, or of one with a wall, at about a frame; None if there is none.

    away: frames within which an event of a ball is this contact.
    """
    fits, settings = list[_Found](), film.settings
    parts = [_cut(ball, frame, film.events[ball.particle], away, settings) for ball in pair]
    if max(len(part) for part in parts) < 2 * settings.least_positions:
        return None
    gaps = np.unique(np.concatenate([part.frame for part in parts]))
    reach = min(away, 1.5) + 1.0
    gaps = gaps[(gaps >= frame - reach) & (gaps <= frame + reach)]
    for left, right in pairwise(gaps):
        here = _fit_gap(parts, int(left), int(right), film)
        if here is not None:
            fits.append(here)
    return _judge(pair, _weigh_gaps(fits), film.diameter, settings) if fits else None


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
    parts: Sequence[BallTrack], left: int, right: int, film: _Film, *, steps_in_gap: int = 8, turns: int = 2
) -> _Found | None:
    """The best instant between two frames; None where a ball has too few positions before or after.

    steps_in_gap: instants between two frames that are tried. turns: each with slides from the instant of the last.
    """
    if min(map(len, parts)) == 0:
        return None
    settings, frame_s = film.settings, film.frame_s
    zero = float(np.mean([_time_of((left + right) / 2, part, frame_s) for part in parts]))
    low, high = (
        max(_time_of(left, part, frame_s) for part in parts) - zero,
        min(_time_of(right, part, frame_s) for part in parts) - zero,
    )
    if not low < high:
        return None
    variances = [float(np.median(np.trace(part.cov, axis1=1, axis2=2))) / 2 for part in parts]
    ways = list[list[_Path | None]]()
    for part, variance in zip(parts, variances, strict=True):
        halves = part.frame <= left, part.frame >= right
        seen = [rows.sum() >= settings.least_positions for rows in halves]
        if not any(seen) or not (all(seen) or len(parts) == 2):
            return None
        before, after = (part.where(rows) for rows in halves)
        ways.append(
            [
                film.fit_path(before, zero, variance) if seen[0] else None,
                _fit_path(after.time - zero, after.position, variance, settings.curvature) if seen[1] else None,
            ]
        )
    if not any(None not in way for way in ways):
        return None
    times, at, slips = np.linspace(low, high, steps_in_gap + 1), 0.0, [np.zeros(2)] * len(parts)
    for _ in range(turns if settings.friction else 1):
        if settings.friction:
            late = [part.frame >= right for part in parts]
            slips = _fit_slides(parts, late, zero, at, variances, ways, settings)
        cost, places = _compare_paths(ways, times, film)
        at, bend = _find_least(times, cost)
    smooth, dof = 0.0, 1
    for part, variance, way in zip(parts, variances, ways, strict=True):
        known = [side for side in way if side is not None]
        dof += max(2 * len(part) - 4 * len(known), 0)
        smooth += film.fit_path(part, zero, variance).chi2 if len(known) == 2 else known[0].chi2
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
        velocity_std=np.sqrt(
            [np.nan if None in way else excess * sum(side[1] for side in way if side) for way in velocities]
        ),
        slips=np.array(slips),
    )


def _compare_paths(ways: Sequence[Sequence[_Path | None]], times: Floats, film: _Film) -> tuple[Floats, list[Floats]]:
    """The chi^2 (m,) of a contact at each of m instants, and the places (m, 2) of each ball there.

    The paths before and after meet there, and two balls are a diameter apart.
    """
    cost, places, spread = np.zeros(len(times)), list[Floats](), list[Floats]()
    for way in ways:
        known = [(side.chi2, *side.at(times)) for side in way if side is not None]
        cost += sum(side[0] for side in known)
        place, var = known[0][1:]
        if len(known) == 2:
            other, other_var = known[1][1:]
            cost += ((place - other) ** 2).sum(axis=1) / (var + other_var)
            weight = (other_var / (var + other_var))[:, None]
            place, var = place * weight + other * (1 - weight), var * weight[:, 0]
        places.append(place)
        spread.append(var)
    if len(ways) == 2:
        apart = np.hypot(*(places[0] - places[1]).T)
        variance = (film.settings.distance_share * film.diameter) ** 2 + spread[0] + spread[1]
        cost += (apart - film.diameter) ** 2 / variance
    return cost, places


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
        found.time,
        found.time_std,
        pair[0].particle,
        other,
        place,
        normal,
        kick,
        error,
        gain,
        confidence,
        found.slips,
    )


def _is_explained(
    contact: TrackContact, found: Sequence[TrackContact], frame_s: float, settings: FinderSettings
) -> bool:
    """Decide whether other contacts of both balls at that instant explain the kinks."""
    near = [c for c in found if abs(c.time - contact.time) < settings.same_frames * frame_s]
    return set(contact.balls) <= {n for c in near for n in c.balls}
