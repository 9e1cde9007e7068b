"""Finds the contacts in the tracks of any number of balls: which balls, when, where, and how sure that is.

A contact is a kink of two paths at a distance of one diameter. A kink of one path alone is a wall, or something unseen.
Short paths before and after a contact are parabolas whose curvature is at most that of a sliding ball. The contact is
the instant at which they meet and the balls are a diameter apart. Its evidence is the chi^2 by which two such paths fit
better than one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import expit

from synthcam_shared.arrays import Array
from tracker.measurement.collision.collision_model import GRAVITY
from tracker.measurement.collision.contacts import find_near_pairs
from tracker.measurement.crowd.gap_fits import (
    ConsecutivePositions,
    ContactFinderSettings,
    ContactFits,
    ContactGaps,
    fit_gaps,
    gather_gaps,
)
from tracker.measurement.positions import BallTrack, measure_separation
from tracker.measurement.stretch_cuts import StretchCutter, measure_path_noise

NO_BALL = -1  # in place of a second ball: a wall, or something unseen
CUTTER = StretchCutter(kink_positions=3, max_acceleration=2.4, kink_sigma=4.0)  # candidates only


@dataclass(frozen=True)
class TrackContact:
    """A contact of two balls, or of one with a wall."""

    time: float  # s
    time_std: float
    one: int  # particle
    other: int  # the second particle; NO_BALL for a wall
    xy: Array  # (2,) m, where the surfaces touch; of a wall the centre of the ball
    normal: Array  # (2,) unit vector along which ball `one` is pushed
    kick: float  # m/s, change of the velocity of `one` along it; of two balls half that of their relative velocity
    kick_std: float
    gain: float  # chi^2 by which the contact fits better than none
    confidence: float  # a score from 0 to 1 that grows with `gain`; it is no calibrated probability
    slips: Array  # (balls, 2) m/s, of the lowest points just after, against which balls slide; NaN if unknown, 0 on air
    spin_transfer: tuple[float, float]  # share of the surfaces' relative speed that goes to the spins, and its error
    surface_speed: float  # m/s, that relative speed of balls that roll: the sum of their speeds along the normal

    @property
    def balls(self) -> tuple[int, ...]:
        """Its particles."""
        return (self.one,) if self.other == NO_BALL else (self.one, self.other)


@dataclass
class _Film:
    """A recording of balls, and what is known of their contacts so far."""

    rows: dict[int, ConsecutivePositions]  # by ball
    exposure: float  # s
    frame_s: float
    diameter: float
    settings: ContactFinderSettings
    events: dict[int, list[float]]  # of each ball, frames at which something may have happened to it
    slides: dict[int, list[tuple[float, Array]]] = field(default_factory=dict)  # of each ball: instants and slips

    @property
    def same_s(self) -> float:
        """Seconds within which two contacts of a ball are one kink."""
        return self.settings.same_frames * self.frame_s

    def note_slides(self, found: Sequence[TrackContact]) -> None:
        """Keep the slides after these contacts."""
        self.slides = {}
        for contact in sorted(found if self.settings.friction else (), key=lambda contact: contact.time):
            for ball, slip in zip(contact.balls, contact.slips, strict=True):
                if np.isfinite(slip).all():
                    self.slides.setdefault(ball, []).append((contact.time, slip))

    def note_events(self, balls: dict[int, BallTrack], kinks: dict[int, Array], found: Sequence[TrackContact]) -> None:
        """Keep the contacts of each ball, and its kinks that are far from these; kinks: their frames."""
        self.events = {}
        for n, ball in balls.items():
            own, free = _list_events(ball, kinks[n], found, self.settings.same_frames)
            self.events[n] = [*own, *free]

    def cut(self, ball: int, frame: float, away: float) -> ConsecutivePositions:
        """The positions of a ball about a frame, up to its next event on either side.

        away: frames within which an event of a ball is the one at this frame.
        """
        settings, events = self.settings, self.events[ball]
        low = max((at for at in events if at < frame - away), default=-np.inf) + settings.event_frames
        high = min((at for at in events if at > frame + away), default=np.inf) - settings.event_frames
        first, last = frame - settings.positions - 2, frame + settings.positions_after + 2
        return self.rows[ball].between(max(low, np.nextafter(first, -np.inf)), min(high, np.nextafter(last, np.inf)))

    def gather(
        self, candidates: Sequence[Sequence[ConsecutivePositions]], gaps: Sequence[Sequence[tuple[int, int]]]
    ) -> ContactGaps:
        """The gaps of candidates, each with the positions of its balls."""
        last = [[self._find_last_slide(part) for part in parts] for parts in candidates]
        return gather_gaps(candidates, gaps, last, self.settings.friction * GRAVITY, self.frame_s)

    def fit(self, gaps: ContactGaps) -> ContactFits:
        """Fit a contact in each gap."""
        return fit_gaps(gaps, self.settings, self.diameter, self.exposure)

    def _find_last_slide(self, part: ConsecutivePositions) -> tuple[float, Array] | None:
        """The last slide of a ball that starts before its positions."""
        slides = self.slides.get(part.particle, ()) if len(part.time) else ()
        return next((slide for slide in reversed(slides) if slide[0] < part.time[0]), None)


def find_track_contacts(balls: Sequence[BallTrack], diameter: float, *, glides: bool = False) -> list[TrackContact]:
    """Find all contacts in the tracks of any number of balls, in order of time; diameter: m.

    glides: whether the bodies glide, as on air, and do not slide after a contact until they roll.
    """
    settings = ContactFinderSettings(friction=0.0) if glides else ContactFinderSettings()
    noise = measure_path_noise([(ball.frame, ball.position) for ball in balls])
    by_number = {ball.particle: ball for ball in balls}
    kinks = dict[int, Array]()  # frames, with halves, at which the path of a ball has a kink
    for n, ball in by_number.items():
        bends = CUTTER.find_kinks(ball.time, CUTTER.measure_kinks(ball.time, ball.position, noise))
        kinks[n] = np.interp(bends, ball.time, ball.frame)
    pairs = [
        (one, other, frame)
        for one, other in find_near_pairs(list(balls), diameter, 1.0)
        for frame in _find_approaches(one, other, diameter, settings)
    ]
    numbers = dict[tuple[int, int], list[int]]()  # of the approaches of each pair
    for k, (a, b, _) in enumerate(pairs):
        numbers.setdefault((a.particle, b.particle), []).append(k)
    events = {n: [*at.tolist(), *(f for a, b, f in pairs if n in (a.particle, b.particle))] for n, at in kinks.items()}
    rows = {n: ConsecutivePositions(n, b.frame, b.time, b.position, b.variance) for n, b in by_number.items()}
    steps = [np.diff(ball.time) / np.diff(ball.frame) for ball in balls if len(ball) > 1]
    frame_s = float(np.median(np.concatenate(steps))) if steps else np.nan
    film = _Film(rows, balls[0].exposure if balls else 0.0, frame_s, diameter, settings, events)
    found, bounces = list[TrackContact](), dict[int, Array]()
    for turn in range(settings.turns):  # each with better instants of the contacts before and after
        away = settings.other_frames if turn else settings.vague_frames
        tried = _examine([((one.particle, other.particle), frame) for one, other, frame in pairs], away, film)
        earlier, found = found, _choose(tried, [], film)
        known = [*found, *_choose(earlier, found, film)]  # two contacts of a ball may hide one another in turn
        film.note_events(by_number, kinks, known)
        if settings.friction and film.settings.curvature > settings.known_curvature and turn < settings.turns - 1:
            film.settings = _fit_friction(found, by_number, film)
        film.note_slides(found)
        bounces = _find_slow_bounces(by_number, film, noise)
        film.note_events(by_number, {n: np.append(at, bounces[n]) for n, at in kinks.items()}, known)
        for contact in known:  # a pair may hit twice within a few frames
            one = by_number[contact.one]
            at = float(np.interp(contact.time, one.time, one.frame))
            nearest = min(numbers[contact.one, contact.other], key=lambda k: abs(pairs[k][2] - at))
            pairs[nearest] = *pairs[nearest][:2], at
    found, walls = list(known), list[tuple[tuple[int, ...], float]]()
    for n, ball in by_number.items():
        every = np.append(kinks[n], bounces[n])
        walls += [((n,), frame) for frame in _list_events(ball, every, found, settings.same_frames)[1]]
    found += _examine(walls, settings.other_frames, film)
    return _widen_errors(_find_partners(found, balls, film), film)


def _find_slow_bounces(balls: dict[int, BallTrack], film: _Film, noise: float) -> dict[int, Array]:
    """Find the frames, with halves, at which each ball may bounce more slowly than friction could brake it.

    Friction does not turn a ball back within a frame. So a kink that is too small for a candidate counts if the ball
    moves against the kick before it, and with it afterwards.
    """
    cutter, candidates = replace(CUTTER, max_acceleration=0.0), list[tuple[tuple[int, ...], float]]()
    for n, ball in balls.items():
        bends = cutter.find_kinks(ball.time, cutter.measure_kinks(ball.time, ball.position, noise))
        frames, known = np.interp(bends, ball.time, ball.frame), np.array(film.events[n])
        far = np.abs(frames[:, None] - known).min(axis=1, initial=np.inf) > film.settings.same_frames
        candidates += [((n,), frame) for frame in frames[far].tolist()]
    out = dict[int, list[float]]()
    for contact in _examine(candidates, film.settings.other_frames, film):
        speeds = -contact.surface_speed, contact.kick + contact.surface_speed
        if min(speeds) > film.settings.least_impulse_sigma * contact.kick_std:
            ball = balls[contact.one]
            out.setdefault(contact.one, []).append(float(np.interp(contact.time, ball.time, ball.frame)))
    return {n: np.array(out.get(n, [])) for n in balls}


def _choose(tried: Sequence[TrackContact], known: Sequence[TrackContact], film: _Film) -> list[TrackContact]:
    """Choose the contacts of which other ones of both balls at that instant do not explain the kinks."""
    found = list[TrackContact]()
    for contact in sorted(tried, key=lambda contact: -contact.gain):
        near = [c for c in (*known, *found) if abs(c.time - contact.time) < film.same_s]
        if not set(contact.balls) <= {n for c in near for n in c.balls}:
            found.append(contact)
    return found


def _fit_friction(found: Sequence[TrackContact], balls: dict[int, BallTrack], film: _Film) -> ContactFinderSettings:
    """The settings with the friction of the plate, and the drag of surfaces, by which slides fit best.

    Without enough contacts these stay as they are.
    """
    settings = film.settings
    best = sorted((c for c in found if len(c.balls) == 2), key=lambda contact: -contact.gain)[: settings.most_slides]
    if len(best) < settings.least_slides:
        return settings
    parts, gaps = list[list[ConsecutivePositions]](), list[list[tuple[int, int]]]()
    for contact in best:
        frame = float(np.interp(contact.time, balls[contact.one].time, balls[contact.one].frame))
        parts.append([film.cut(n, frame, settings.other_frames) for n in contact.balls])
        gaps.append([(int(np.floor(frame)), int(np.floor(frame)) + 1)])

    def misfit(friction: float, spin_transfer: float, curvature: float = settings.known_curvature) -> float:
        """Minus the log-likelihood, with heavy tails because events are missed."""
        tried = replace(settings, friction=friction, spin_transfer=spin_transfer, curvature=curvature)
        own = replace(film, settings=tried)
        chi2, dof = own.fit(own.gather(parts, gaps)).chi2, 2 * (settings.positions + settings.positions_after)
        return float((dof / 2 * np.log1p(chi2 / dof)).sum())

    def minimise(price: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
        return float(minimize_scalar(price, bounds=(low, high), method="bounded", options={"xatol": tolerance}).x)

    start = ContactFinderSettings()
    mu, c = start.friction, start.spin_transfer
    friction = minimise(lambda x: misfit(x, c) + (np.log(x / mu) / np.log(2)) ** 2 / 2, mu / 8, mu * 4, 0.01)
    most = 5 / 14  # of balls whose surfaces stick to one another

    def price(x: float) -> float:
        return misfit(friction, x) + ((x - c) / start.spin_transfer_std) ** 2 / 2

    transfer, step = minimise(price, 0.0, most, 0.04), 0.1
    bend = (price(transfer + step) + price(transfer - step) - 2 * price(transfer)) / step**2
    error = max(1 / np.sqrt(max(bend, 1 / start.spin_transfer_std**2)), settings.least_spin_transfer_std)
    found_settings = replace(settings, friction=friction, spin_transfer=transfer, spin_transfer_std=float(error))
    worse = misfit(friction, transfer) - misfit(friction, transfer, start.curvature)
    if worse > settings.most_worse * len(best):  # other forces bend the paths
        return found_settings
    return replace(found_settings, curvature=settings.known_curvature, slide_share=settings.known_slide_share)


def _widen_errors(found: Sequence[TrackContact], film: _Film) -> list[TrackContact]:
    """The contacts in order of time, with larger errors where a ball has another contact within a frame or so.

    Its path between both is not seen. The path after both then is off by the other kick times the time between.
    """
    found, out, same, unseen = sorted(found, key=lambda c: c.time), [], film.same_s, film.settings.unseen_share
    time = np.array([contact.time for contact in found])
    for contact in found:
        late = kick = 0.0
        first, last = np.searchsorted(time, (contact.time - same, contact.time + same))
        for other in found[first:last]:
            if other is not contact and set(other.balls) & set(contact.balls):
                kick = max(kick, unseen * other.kick)
                share = unseen * min(other.kick / contact.kick, 1.0)
                late = max(late, share * max(abs(other.time - contact.time), same / 3))
        time_std, kick_std = np.hypot(contact.time_std, late), np.hypot(contact.kick_std, kick / 2)
        out.append(replace(contact, time_std=float(time_std), kick_std=float(kick_std)))
    return out


def _find_partners(found: Sequence[TrackContact], balls: Sequence[BallTrack], film: _Film) -> list[TrackContact]:
    """The contacts, where a kink of one ball is that with a ball whose own path is too short to show it.

    The other ball lies a diameter behind the kick. It has a kink of its own, of that contact or of another.
    """
    out, same, settings = list(found), film.same_s, film.settings
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
            if abs(size / film.diameter - 1) < settings.rough_share and aligned > best:
                best, chosen = aligned, (ball.particle, apart / size, place)
        pair = None if chosen is None else {contact.one, chosen[0]}
        if chosen is None or any(set(c.balls) == pair and abs(c.time - contact.time) < same for c in out):
            continue
        middle = (contact.xy + chosen[2]) / 2
        slips = np.vstack([contact.slips, [np.nan, np.nan]])
        whole = replace(contact, other=chosen[0], normal=chosen[1], xy=middle, slips=slips)
        of_other = [c for c in out if c.balls == (chosen[0],) and abs(c.time - contact.time) < same]
        gone = [contact, *(c for c in of_other if c.normal @ chosen[1] < -best / 2)]
        out = [*(c for c in out if not any(c is one for one in gone)), whole]
    return out


def _list_events(
    ball: BallTrack, kinks: Array, found: Sequence[TrackContact], apart: float
) -> tuple[list[float], list[float]]:
    """Frames, with parts of them, of the contacts of a ball, and of its kinks that are `apart` from these or more."""
    own = [float(np.interp(c.time, ball.time, ball.frame)) for c in found if ball.particle in c.balls]
    return own, [at for at in kinks.tolist() if min((abs(at - f) for f in own), default=np.inf) > apart]


def _find_approaches(one: BallTrack, other: BallTrack, diameter: float, settings: ContactFinderSettings) -> list[float]:
    """Frames at which two balls are nearest to one another, and near enough to touch."""
    frames, apart, _, _ = measure_separation(one, other)
    if len(frames) < 2 * settings.least_positions:
        return []
    step = np.abs(np.diff(apart))
    reach = np.maximum(np.append(step, 0.0), np.append(0.0, step))
    least = (apart <= np.append(apart[1:], np.inf)) & (apart < np.append(np.inf, apart[:-1]))
    return [float(f) for f in frames[least & (apart < diameter * (1 + settings.near_share) + 1.5 * reach)]]


def _examine(
    candidates: Sequence[tuple[tuple[int, ...], float]], away: float, film: _Film, *, at_once: int = 2000
) -> list[TrackContact]:
    """The contacts of two balls, or of one with a wall, at about a frame, of the candidates that are one.

    candidates: as many balls each, and the frame. away: frames within which an event of a ball is this contact.
    at_once: candidates that are fitted together, which take some 30 kB each.
    """
    batches = (candidates[first : first + at_once] for first in range(0, len(candidates), at_once))
    return [contact for batch in batches for contact in _examine_batch(batch, away, film)]


def _examine_batch(candidates: Sequence[tuple[tuple[int, ...], float]], away: float, film: _Film) -> list[TrackContact]:
    reach, chosen = min(away, 1.5) + 1.0, list[tuple[int, ...]]()
    parts, gaps = list[list[ConsecutivePositions]](), list[list[tuple[int, int]]]()
    for balls, frame in candidates:
        own = [film.cut(ball, frame, away) for ball in balls]
        if not 2 * film.settings.least_positions <= max(len(part.frame) for part in own):
            continue
        seen = np.unique(np.concatenate([part.frame for part in own]))
        seen = seen[(seen >= frame - reach) & (seen <= frame + reach)]
        chosen.append(balls)
        parts.append(own)
        gaps.append(list(pairwise(seen.tolist())))
    if not any(gaps):
        return []
    fits = film.fit(film.gather(parts, gaps))
    first, last = (np.searchsorted(fits.candidate, np.arange(len(chosen)), side=side) for side in ("left", "right"))
    out = list[TrackContact]()
    for balls, start, end in zip(chosen, first.tolist(), last.tolist(), strict=True):
        if start < end:
            contact = _judge(balls, _weigh_gaps(fits.take(np.arange(start, end))), film)
            out += [] if contact is None else [contact]
    return out


def _weigh_gaps(fits: ContactFits) -> ContactFits:
    """The best of the fits of several gaps, with the error of an instant that may lie in another of them."""
    best = fits.take(int(np.argmin(fits.chi2)))
    weight = fits.time_std * np.exp((best.chi2 - fits.chi2) / (2 * best.excess))
    variance = weight @ (fits.time_std**2 + (fits.time - best.time) ** 2) / weight.sum()
    return best._replace(time_std=np.sqrt(variance))


def _judge(pair: tuple[int, ...], found: ContactFits, film: _Film) -> TrackContact | None:
    """The contact of balls by the best of its gaps, if the paths show one."""
    settings = film.settings
    turn = found.after - found.before
    gain = float(found.smooth - found.chi2)
    confidence = float(expit(gain / 2 + settings.prior_log_odds))
    if not confidence >= settings.least_confidence:
        return None
    if len(pair) == 1:
        size = float(np.hypot(*turn[0]))
        normal, place, kick, error = turn[0] / max(size, 1e-12), found.places[0], size, float(found.velocity_std[0])
    else:
        normal = found.places[0] - found.places[1]
        apart = float(np.hypot(*normal))
        if apart > (1 + settings.near_share) * film.diameter:
            return None
        normal, place = normal / apart, found.places.mean(axis=0)
        kicks = np.array([turn[0] @ normal, -turn[1] @ normal])  # equal, if the balls are
        kick = float(np.nanmean(kicks))
        error = float(np.sqrt(np.nanmean(found.velocity_std**2) / np.isfinite(kicks).sum()))
        approach = float((found.before[0] - found.before[1]) @ normal)
        if approach > settings.least_impulse_sigma * error or not kick > settings.least_impulse_sigma * error:
            return None
    if settings.friction:
        error = float(np.hypot(error, settings.slide_share * kick))
    other = pair[1] if len(pair) == 2 else NO_BALL
    when, when_std = float(found.time), float(found.time_std)
    return TrackContact(
        time=when,
        time_std=when_std,
        one=pair[0],
        other=other,
        xy=place,
        normal=normal,
        kick=kick,
        kick_std=error,
        gain=gain,
        confidence=confidence,
        slips=found.slips,
        spin_transfer=(settings.spin_transfer, settings.spin_transfer_std),
        surface_speed=float(np.nansum(found.before @ normal)),
    )
