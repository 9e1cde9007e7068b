"""Fits contacts that lie between two frames: short paths before and after each meet there, for many contacts at once.

A path is a parabola whose curvature is at most that of a sliding ball. A slide from an earlier contact, or after this
one, adds the way that it costs. Arrays have a row for each gap between two frames, then one for each ball.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from synthcam_shared.arrays import Array, Flags, Ints


@dataclass(frozen=True)
class ContactFinderSettings:
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
    spin_transfer_std: float = 0.3
    least_spin_transfer_std: float = 0.03  # of one that a film shows, because it may differ between contacts
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


class ConsecutivePositions(NamedTuple):
    """Consecutive positions of one ball."""

    particle: int
    frame: Ints  # (n,)
    time: Array  # (n,) s
    position: Array  # (n, 2) m
    variance: Array  # (n,) of a coordinate, m^2

    def between(self, low: float, high: float) -> ConsecutivePositions:
        """The positions in frames after `low` and before `high`."""
        rows = slice(*np.searchsorted(self.frame, (np.floor(low) + 1, np.ceil(high))))
        position, variance = self.position[rows], self.variance[rows]
        return ConsecutivePositions(self.particle, self.frame[rows], self.time[rows], position, variance)


class Slides(NamedTuple):
    """Balls that slide against their slips, the speeds of their lowest points, until two sevenths of these are lost.

    A slip of zero is no slide.
    """

    start: Array  # (...) s
    slip: Array  # (..., 2) there
    decel: float

    @property
    def duration(self) -> Array:
        """How long they last (...), s."""
        return np.asarray(2 * np.hypot(self.slip[..., 0], self.slip[..., 1]) / (7 * max(self.decel, 1e-300)))

    @property
    def direction(self) -> Array:
        """Unit vectors (..., 2) along the slips."""
        return np.asarray(self.slip / np.maximum(np.hypot(self.slip[..., 0], self.slip[..., 1]), 1e-12)[..., None])

    def shape(self, time: Array) -> Array:
        """The ways (..., n) that the balls lost since the start."""
        since = np.maximum(time - self.start[..., None], 0.0)
        lasts = np.minimum(since, self.duration[..., None])
        return np.asarray(self.decel * lasts * (since - lasts / 2))

    def rate(self, time: Array) -> Array:
        """The speeds (...) that the balls lost since the start."""
        return np.asarray(self.decel * np.clip(time - self.start, 0.0, self.duration))

    def left(self, time: Array) -> Array:
        """Compute the slips (..., 2) at later instants."""
        share = np.maximum(1 - (time - self.start) / np.maximum(self.duration, 1e-12), 0.0)
        return np.asarray(self.slip * share[..., None])

    def where(self, holds: Flags) -> Slides:
        """The same slides, and none elsewhere."""
        return self._replace(slip=np.where(holds[..., None], self.slip, 0.0))


class Parabolas(NamedTuple):
    """Parabolas: positions, velocities and half the accelerations at the origin of time, with their covariances.

    Slides from before add the way that the balls lost, times a vector near minus their direction.
    """

    value: Array  # (..., 4, 2)
    cov: Array  # (..., 4, 4)
    chi2: Array  # (...)
    slides: Slides

    def at(self, time: Array) -> tuple[Array, Array]:
        """Positions (..., n, 2) at times (..., n), and their variances (..., n)."""
        basis = _make_basis(time, self.slides)
        return basis @ self.value, ((basis @ self.cov) * basis).sum(axis=-1)

    def velocity(self, time: Array) -> tuple[Array, Array]:
        """Velocities (..., 2) and their variances (...)."""
        basis = np.zeros((*time.shape, 1, 4))
        basis[..., 0, 1], basis[..., 0, 2], basis[..., 0, 3] = 1.0, 2 * time, self.slides.rate(time)
        variance = (basis @ self.cov @ np.swapaxes(basis, -1, -2))[..., 0, 0]
        return (basis @ self.value)[..., 0, :], variance

    def replace_where(self, holds: Flags, other: Parabolas) -> Parabolas:
        """The others where a condition (...) holds."""
        return Parabolas(
            np.where(holds[..., None, None], other.value, self.value),
            np.where(holds[..., None, None], other.cov, self.cov),
            np.where(holds, other.chi2, self.chi2),
            Slides(
                np.where(holds, other.slides.start, self.slides.start),
                np.where(holds[..., None], other.slides.slip, self.slides.slip),
                self.slides.decel,
            ),
        )


def _make_basis(time: Array, slides: Slides) -> Array:
    basis = np.empty((*time.shape, 4))
    basis[..., 0], basis[..., 1], basis[..., 2], basis[..., 3] = 1.0, time, time * time, slides.shape(time)
    return basis


def _fit_paths(
    time: Array, position: Array, used: Flags, variance: Array, curvature: float, slides: Slides
) -> Parabolas:
    """Fit parabolas whose acceleration is `curvature` or so to the used ones of positions (..., n, 2)."""
    basis = _make_basis(time, slides)
    weight = used / variance[..., None]
    weighted = np.swapaxes(basis * weight[..., None], -1, -2)
    square, right = weighted @ basis, weighted @ position
    square[..., 2, 2] += 4 / curvature**2
    slide_error = 0.2  # relative, of either component of the way that an earlier slide costs
    square[..., 3, 3] += 1 / slide_error**2
    right[..., 3, :] -= slides.direction / slide_error**2
    few = np.count_nonzero(used, axis=-1) < 2
    square[..., 0, 0] += few  # a path that has no fit, and is not used
    square[..., 1, 1] += few
    cov = np.asarray(np.linalg.inv(square), dtype=np.float64)
    value = cov @ right
    left, bend, away = position - basis @ value, value[..., 2, :], value[..., 3, :] + slides.direction
    chi2 = ((left**2).sum(axis=-1) * weight).sum(axis=-1)
    chi2 += (bend**2).sum(axis=-1) * 4 / curvature**2 + (away**2).sum(axis=-1) / slide_error**2
    return Parabolas(value, cov, chi2, slides)


class ContactGaps(NamedTuple):
    """Gaps between two frames in which balls may touch, with the positions about them."""

    candidate: Ints  # (m,) number of the contact that may lie in the gap
    time: Array  # (m, balls, n) s after `zero`
    position: Array  # (m, balls, n, 2) m
    variance: Array  # (m, balls) m^2
    before: Flags  # (m, balls, n) which positions lie on either side of the gap; the others only fill the array
    after: Flags
    zero: Array  # (m,) s, the middle of a gap
    low: Array  # (m,) its ends, s after that
    high: Array
    slides: Slides  # (m, balls) of earlier contacts, which may last into the positions

    def take(self, rows: Flags) -> ContactGaps:
        """Those gaps."""
        kept = {name: values[rows] for name, values in self._asdict().items() if name != "slides"}
        return ContactGaps(**kept, slides=Slides(self.slides.start[rows], self.slides.slip[rows], self.slides.decel))


def gather_gaps(
    candidates: Sequence[Sequence[ConsecutivePositions]],
    gaps: Sequence[Sequence[tuple[int, int]]],
    last_slides: Sequence[Sequence[tuple[float, Array] | None]],
    decel: float,
    frame_s: float,
) -> ContactGaps:
    """Gather the gaps of candidates, each with the positions of as many balls.

    gaps: of each candidate, frames before and after each gap.
    last_slides: of each ball of it, instant and slip of the slide before its positions.
    decel: of a slide, m/s^2.
    frame_s: duration of a frame, s.
    """
    candidate = np.repeat(np.arange(len(candidates)), [len(each) for each in gaps])
    left, right = np.array([gap for each in gaps for gap in each], dtype=np.int64).reshape(-1, 2).T
    shape = len(candidates), len(candidates[0])
    most = max(len(part.frame) for parts in candidates for part in parts)
    frame = np.full((*shape, most), np.iinfo(np.int64).min // 4)
    time, position, spread = np.zeros((*shape, most)), np.zeros((*shape, most, 2)), np.full((*shape, most), np.inf)
    start, slip, count = np.full(shape, -1e9), np.zeros((*shape, 2)), np.zeros(shape, np.int64)
    for i, parts in enumerate(candidates):
        for k, part in enumerate(parts):
            n = len(part.frame)
            frame[i, k, :n], time[i, k, :n], position[i, k, :n] = part.frame, part.time, part.position
            spread[i, k, :n], count[i, k] = part.variance, n
            slide = last_slides[i][k]
            if slide is not None:
                start[i, k], slip[i, k] = slide
    spread.sort(axis=-1)
    middle = np.stack([np.maximum(count - 1, 0) // 2, np.minimum(count // 2, most - 1)], axis=-1)
    variance = np.take_along_axis(spread, middle, axis=-1).mean(axis=-1)[candidate]
    frame, time, position, start, slip = (values[candidate] for values in (frame, time, position, start, slip))
    there = np.arange(most) < count[candidate][..., None]

    def find_times(at: Array) -> Array:
        """The instants (m, balls) of frames (m,) that a track may lack."""
        nearest = np.argmin(np.abs(frame - at[:, None, None]), axis=-1)[..., None]
        steps = at[:, None] - np.take_along_axis(frame, nearest, axis=-1)[..., 0]
        return np.asarray(np.take_along_axis(time, nearest, axis=-1)[..., 0] + steps * frame_s)

    zero = find_times((left + right) / 2).mean(axis=1)
    return ContactGaps(
        candidate=candidate,
        time=np.where(there, time - zero[:, None, None], 0.0),
        position=position,
        variance=variance,
        before=there & (frame <= left[:, None, None]),
        after=there & (frame >= right[:, None, None]),
        zero=zero,
        low=find_times(left.astype(np.float64)).max(axis=1) - zero,
        high=find_times(right.astype(np.float64)).min(axis=1) - zero,
        slides=Slides(start - zero[:, None], slip, decel),
    )


class ContactFits(NamedTuple):
    """The best instants of contacts in m gaps, and what is known there."""

    candidate: Ints  # (m,)
    time: Array  # (m,)
    time_std: Array
    chi2: Array
    smooth: Array  # chi^2 without a contact
    excess: Array  # chi^2 over its degrees of freedom, at least 1
    places: Array  # (m, balls, 2)
    before: Array  # (m, balls, 2) velocities; NaN where too few positions show one
    after: Array
    velocity_std: Array  # (m, balls) of the change
    slips: Array  # (m, balls, 2) just after; NaN if unknown, 0 if balls glide

    def take(self, rows: Ints | int) -> ContactFits:
        """Those gaps."""
        return ContactFits(**{name: values[rows] for name, values in self._asdict().items()})


def fit_gaps(gaps: ContactGaps, settings: ContactFinderSettings, diameter: float, exposure: float) -> ContactFits:
    """Fit the best instant of a contact in each gap, without the gaps in which a ball has too few positions.

    diameter: m; exposure: s.
    """
    gaps, has_before, has_after = _take_usable(gaps, settings.least_positions)
    both = has_before & has_after
    before, whole = (
        _fit_with_slides(gaps, used, settings.curvature) for used in (gaps.before, gaps.before | gaps.after)
    )
    at, bend, cost, places, after, slips = _find_instants(gaps, before, (has_before, has_after), settings, diameter)
    best = np.argmin(cost, axis=1)
    cost = np.take_along_axis(cost, best[:, None], axis=1)[:, 0]
    positions = np.count_nonzero(gaps.before | gaps.after, axis=-1)
    dof = 1 + np.maximum(2 * positions - 4 * (has_before.astype(int) + has_after), 0).sum(axis=1)
    smooth = np.where(both, whole.chi2, np.where(has_before, before.chi2, after.chi2)).sum(axis=1)
    excess = np.maximum(cost / dof, 1.0)
    exposed = np.minimum(at - gaps.low, gaps.high - at) < exposure / 2  # a frame shows both paths
    when = np.broadcast_to(at[:, None], both.shape)
    (v_before, var_before), (v_after, var_after) = before.velocity(when), after.velocity(when)
    bend = np.maximum(bend, 2 * excess / (gaps.high - gaps.low) ** 2)  # the instant lies in the gap
    std = np.hypot(np.sqrt(2 / bend * excess), np.where(exposed, exposure / 2, 0.0))
    return ContactFits(
        candidate=gaps.candidate,
        time=gaps.zero + at,
        time_std=np.minimum(std, gaps.high - gaps.low),
        chi2=cost,
        smooth=smooth,
        excess=excess,
        places=np.take_along_axis(places, best[:, None, None, None], axis=2)[:, :, 0],
        before=np.where(has_before[..., None], v_before, np.nan),
        after=np.where(has_after[..., None], v_after, np.nan),
        velocity_std=np.sqrt(np.where(both, excess[:, None] * (var_before + var_after), np.nan)),
        slips=slips,
    )


class _Instants(NamedTuple):
    """The best instants of contacts in m gaps, and the paths after them."""

    at: Array  # (m,) s after `zero`
    bend: Array  # (m,) second derivatives of chi^2 there
    cost: Array  # (m, n) chi^2 at the instants that were tried
    places: Array  # (m, balls, n, 2) of the balls there
    after: Parabolas
    slips: Array  # (m, balls, 2) just after; 0 if balls glide


def _find_instants(
    gaps: ContactGaps,
    before: Parabolas,
    has: tuple[Flags, Flags],
    settings: ContactFinderSettings,
    diameter: float,
) -> _Instants:
    """Find the instants at which the paths before and after a contact meet best; has: which balls have such paths."""
    steps_in_gap = 8  # instants between two frames that are tried
    after = _fit_side(gaps, gaps.after, settings.curvature)
    touch = diameter, settings.distance_share * diameter
    times = np.linspace(gaps.low, gaps.high, steps_in_gap + 1, axis=-1)  # (m, steps)
    at, slips = np.zeros(len(times)), np.zeros_like(gaps.position[:, :, 0])
    for _ in range(2 if gaps.slides.decel else 1):  # each with slides from the instant of the last
        for _ in range(2 if gaps.slides.decel else 0):  # the kick and the slide depend on one another
            slips = _predict_slips(before, after, has, at, settings.spin_transfer)
            known = np.all(np.isfinite(slips), axis=-1)
            slide = Slides(np.broadcast_to(at[:, None], known.shape), slips, gaps.slides.decel).where(known)
            moved = gaps.position + slide.shape(gaps.time)[..., None] * slide.direction[..., None, :]
            rolling = _fit_side(gaps._replace(position=moved), gaps.after, settings.curvature)
            after = after.replace_where(known, rolling)
        cost, places = _compare_paths(before, after, has, times, touch)
        at, bend = _find_least(times, cost)
    return _Instants(at, bend, cost, places, after, slips)


def _fit_side(gaps: ContactGaps, used: Flags, curvature: float, slides: Slides | None = None) -> Parabolas:
    """Fit parabolas to the used positions; slides of earlier contacts: none by default."""
    if slides is None:
        balls = gaps.slides.start.shape
        slides = Slides(np.zeros(balls), np.zeros((*balls, 2)), gaps.slides.decel)
    return _fit_paths(gaps.time, gaps.position, used, gaps.variance, curvature, slides)


def _fit_with_slides(gaps: ContactGaps, used: Flags, curvature: float) -> Parabolas:
    """Fit parabolas with the slide of the last contact before, where that fits better."""
    first = gaps.time.min(axis=-1, where=gaps.before | gaps.after, initial=np.inf)
    start = gaps.slides.start
    earlier = gaps.slides.where((start < first) & (start + gaps.slides.duration >= first))
    rolls = _fit_side(gaps, used, curvature)
    if not earlier.slip.any():
        return rolls
    slide = _fit_side(gaps, used, curvature, earlier)
    return rolls.replace_where(slide.chi2 < rolls.chi2, slide)


def _take_usable(gaps: ContactGaps, least: int) -> tuple[ContactGaps, Flags, Flags]:
    """The gaps with enough positions, and for each ball whether it has `least` positions before and after.

    A single ball needs both sides. If there are two balls, one needs both sides and the other needs one.
    """
    has_before, has_after = (np.count_nonzero(side, axis=-1) >= least for side in (gaps.before, gaps.after))
    both = has_before & has_after
    usable = np.all(has_before | has_after, axis=1) & np.any(both, axis=1) & (gaps.low < gaps.high)
    return gaps.take(usable), has_before[usable], has_after[usable]


def _predict_slips(
    before: Parabolas, after: Parabolas, has: tuple[Flags, Flags], start: Array, spin_transfer: float
) -> Array:
    """Predict how fast the lowest point of each ball slides after a contact; NaN where a path is not known.

    The kick adds to what is left of the slip of an earlier contact. The surfaces of balls that roll also drag one
    another upwards or downwards, and change the spins. A wall does that twice as much as a ball at rest.
    """
    at = np.broadcast_to(start[:, None], has[0].shape)
    sides = zip(has, (before, after), strict=True)
    old, new = (np.where(known[..., None], side.velocity(at)[0], np.nan) for known, side in sides)
    left = np.where(has[0][..., None], before.slides.left(at), 0.0)
    kicks, rolled = new - old, old - left
    if kicks.shape[1] == 1:
        normal, share = kicks[:, 0], 2 * spin_transfer
    else:
        here = np.where(has[0][..., None], *(side.at(at[..., None])[0][..., 0, :] for side in (before, after)))
        normal, share = here[:, 0] - here[:, 1], spin_transfer
    normal = normal / np.maximum(np.hypot(normal[:, :1], normal[:, 1:]), 1e-12)
    dragged = share * np.nansum((rolled * normal[:, None]).sum(axis=-1), axis=1)[:, None] * normal
    return np.asarray(left + kicks + dragged[:, None])


def _compare_paths(
    before: Parabolas, after: Parabolas, has: tuple[Flags, Flags], times: Array, touch: tuple[float, float]
) -> tuple[Array, Array]:
    """The chi^2 (m, n) of contacts at each of n instants, and the places (m, balls, n, 2) of the balls there.

    The paths before and after meet there. touch: distance of two balls, m, with its error.
    """
    at = np.broadcast_to(times[:, None], (*has[0].shape, times.shape[1]))
    (place, var), (other, other_var) = before.at(at), after.at(at)
    both = (has[0] & has[1])[..., None]
    cost = np.where(has[0], before.chi2, 0.0) + np.where(has[1], after.chi2, 0.0)
    apart = ((place - other) ** 2).sum(axis=-1) / (var + other_var)
    total = (cost[..., None] + np.where(both, apart, 0.0)).sum(axis=1)
    weight = np.where(both, other_var / (var + other_var), has[0][..., None])
    place = place * weight[..., None] + other * (1 - weight[..., None])
    spread = np.where(both, var * weight, np.where(has[0][..., None], var, other_var))
    if place.shape[1] == 2:
        gap = np.hypot(*np.moveaxis(place[:, 0] - place[:, 1], -1, 0))
        total = total + (gap - touch[0]) ** 2 / (touch[1] ** 2 + spread.sum(axis=1))
    return total, place


def _find_least(times: Array, cost: Array) -> tuple[Array, Array]:
    """The instants of the least costs (m,), by parabolas about the least of those tried, and second derivatives."""
    best, rows = np.argmin(cost, axis=1), np.arange(len(cost))
    inner = np.clip(best, 1, times.shape[1] - 2)
    step = times[:, 1] - times[:, 0]
    low, middle, high = (cost[rows, inner + k] for k in (-1, 0, 1))
    bend = np.maximum((high - 2 * middle + low) / step**2, 1e-300)
    with np.errstate(over="ignore"):  # costs on a straight line: the parabola has no least
        ahead = (high - low) / (2 * step) / bend
    finer = np.clip(times[rows, inner] - ahead, times[:, 0], times[:, -1])
    return np.where(best == inner, finer, times[rows, best]), bend
