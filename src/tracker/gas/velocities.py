"""Velocities of many balls between their contacts, from two independent halves of the positions.

A square of a noisy velocity is too large by the variance of the noise. The product of two velocities with independent
noise is not. So each velocity is estimated twice, from the even and from the odd rows of a short window. If the errors
of neighbouring frames are independent, the mean of their product is the square of the true velocity. The size of the
noise does not matter. The difference of both shows that size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import pandas as pd

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.measurement.positions import BallTrack


@dataclass(frozen=True, eq=False)
class HalfVelocities:
    """Velocities at n instants, by the even and by the odd rows of a window about each; NaN where there is no window.

    A window with few rows gives one velocity, which is both.
    """

    even: Array  # (n, 2) m/s
    odd: Array
    gain_even: Array  # (n,) 1/s^2: variance of a component over that of a position
    gain_odd: Array
    gain_common: Array  # the part of both that is the same error; 0 where the halves are independent

    @property
    def known(self) -> Flags:
        """(n,) Where there is a velocity."""
        return np.isfinite(self.even[:, 0])

    def square(self, noise: float) -> tuple[Array, Array]:
        """Estimate the squares of the velocities (n,), m^2/s^2, and their variances; noise: of a coordinate, m."""
        even, odd, common = (noise**2 * gain for gain in (self.gain_even, self.gain_odd, self.gain_common))
        product = (self.even * self.odd).sum(axis=1) - 2 * common
        return product, np.maximum(product, 0) * (even + odd + 2 * common) + 2 * (even * odd + common**2)

    def take(self, rows: Flags | Ints | slice) -> HalfVelocities:
        """Those instants."""
        return HalfVelocities(*(getattr(self, one.name)[rows] for one in fields(self)))

    @staticmethod
    def join(parts: Sequence[HalfVelocities]) -> HalfVelocities:
        """Make one of several."""
        names = [one.name for one in fields(HalfVelocities)]
        return HalfVelocities(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def fit_velocities(
    time: Array, position: Array, at: Array, window_rows: int, slide_end: float = np.nan
) -> HalfVelocities:
    """Fit velocities at the instants `at` (m,) to the nearest rows of one free path.

    A parabola is fitted to each half of the nearest `window_rows` rows. Few rows have one parabola or straight line
    together. If the slide ends within the window, the acceleration changes there, and the window has more rows. An
    instant may lie beyond the ends of the rows; the parabola is then continued to it.

    time: (n,) s, ascending.
    position: (n, 2) m.
    slide_end: s.
    """
    result = _fit_windows(time, position, at, window_rows, np.nan)
    if np.isfinite(slide_end):
        wide = window_rows * 8 // 5
        start = time[_choose_rows(time, at, min(window_rows, len(time)))[:, [0, -1]]]
        across = (start[:, 0] < slide_end) & (slide_end < start[:, 1])
        if across.any():
            own = _fit_windows(time, position, at[across], wide, slide_end)
            for one in fields(HalfVelocities):
                getattr(result, one.name)[across] = getattr(own, one.name)
    return result


def _choose_rows(time: Array, at: Array, rows: int) -> Ints:
    """The `rows` consecutive rows whose mean time is nearest to each instant, (m, rows)."""
    first = _nearest(np.lib.stride_tricks.sliding_window_view(time, rows).mean(axis=1), at)
    return np.asarray(first[:, None] + np.arange(rows))


def _fit_windows(time: Array, position: Array, at: Array, window_rows: int, slide_end: float) -> HalfVelocities:
    """Estimate velocities by `fit_velocities`, with a change of the acceleration at `slide_end` unless that is NaN."""
    min_rows_of_halves = 8  # of a window, from which each half has a parabola with an error
    min_rows_of_parabola = 4  # from which all rows together have one; fewer have a straight line
    rows, m = min(window_rows, len(time)), len(at)
    if rows < 2 or not m:
        nothing = np.full((m, 2), np.nan)
        return HalfVelocities(nothing, nothing.copy(), *np.full((3, m), np.nan))
    taken = _choose_rows(time, at, rows)
    since, where = time[taken] - at[:, None], position[taken]
    change = slide_end - at if np.isfinite(slide_end) else None
    if rows >= min_rows_of_halves + 2 * (change is not None):
        (even, gain_even), (odd, gain_odd) = (_slope(since[:, k::2], where[:, k::2], 3, change) for k in (0, 1))
        return HalfVelocities(even, odd, gain_even, gain_odd, np.zeros(m))
    terms = 3 if rows >= min_rows_of_parabola else 2
    one, gain = _slope(since, where, terms, change if rows > min_rows_of_parabola else None)
    return HalfVelocities(one, one.copy(), gain, gain.copy(), gain.copy())


def _nearest(ascending: Array, at: Array) -> Ints:
    """Index of the nearest of ascending values, for each of `at`."""
    if len(ascending) == 1:
        return np.zeros(len(at), dtype=np.int64)
    after = np.clip(np.searchsorted(ascending, at), 1, len(ascending) - 1)
    return np.asarray(after - (at - ascending[after - 1] < ascending[after] - at))


def _slope(since: Array, position: Array, terms: int, change: Array | None = None) -> tuple[Array, Array]:
    """Fit polynomials of `terms` coefficients to (m, k) times and (m, k, 2) positions: slopes at time 0, and gains.

    change: (m,) times at which the second derivative changes.
    """
    scale = np.abs(since).max(axis=1, keepdims=True)  # of the times, so that the equations are well conditioned
    design = (since / scale)[:, :, None] ** np.arange(terms)  # (m, k, terms)
    if change is not None:
        after, before = (np.maximum(way, 0) / scale for way in (since - change[:, None], -change[:, None]))
        bend = after**2 - before**2 - 2 * before * since / scale  # without value and slope at time 0
        design = np.concatenate([design, bend[:, :, None]], axis=2)
    inverse = np.linalg.inv(np.swapaxes(design, 1, 2) @ design)
    coefficients = inverse @ np.swapaxes(design, 1, 2) @ position
    return coefficients[:, 1] / scale, inverse[:, 1, 1] / scale[:, 0] ** 2


def find_slide_end(time: Array, position: Array, noise: float) -> float:
    """Find the end of a slide between contacts, where a ball's acceleration changes; NaN if nowhere.

    Two parabolas with the same value and slope where they meet are compared with one; noise: of a coordinate, m.
    """
    max_rows, min_sigma = 60, 5.0  # in which the slide may end; change of the acceleration, in its errors
    rows = min(len(time), max_rows)
    if rows < 6:
        return float("nan")
    since, where = time[:rows] - time[0], position[:rows]
    ends = since[2:-2]
    scale = since[-1]
    one = (since / scale)[:, None] ** np.arange(3)  # (rows, 3)
    left = where - one @ np.linalg.lstsq(one, where, rcond=None)[0]
    added = (np.maximum(since[None, :] - ends[:, None], 0) / scale) ** 2  # (ends, rows)
    added -= (one @ np.linalg.lstsq(one, added.T, rcond=None)[0]).T
    gain = ((added @ left) ** 2).sum(axis=1) / (added**2).sum(axis=1)
    best = int(np.argmax(gain))
    return float(time[0] + ends[best]) if gain[best] > (min_sigma * noise) ** 2 else float("nan")


@dataclass(frozen=True, eq=False)
class FreePath:
    """One ball between two of its contacts, or between a contact and the start or end of its track."""

    ball: int  # number of the particle
    frame: Ints  # (n,), of its positions
    time: Array  # (n,) s
    start: int  # row of the table of contacts before it; -1 where the track starts, or has a gap
    end: int  # and after it
    start_time: float  # s, of its contacts, or of its first and last position
    end_time: float
    velocities: HalfVelocities  # at the n positions, at its start, and at its end: n + 2 instants
    # (n,) m/s: how far velocities may be off because the slide after a contact is too short to be seen; 0 elsewhere
    unsure: Array


@dataclass(frozen=True, eq=False)
class PathCuts:
    """How tracks are cut into free paths, and how velocities are estimated on these."""

    window_rows: int  # of a velocity
    margins_s: Array  # of each contact: positions nearer to it do not count in a velocity
    max_gap_s: float  # a ball that was not seen for longer starts a new path
    noise: float  # of a coordinate, m
    slides: bool  # whether balls slide after a contact, as on a plate


def cut_free_paths(balls: Sequence[BallTrack], contacts: pd.DataFrame, cuts: PathCuts) -> list[FreePath]:
    """Cut tracks at contacts and at missing frames, and estimate the velocities of each part.

    contacts: columns t_s, particle1, particle2, in the order of time.
    """
    paths, at = [], contacts["t_s"].to_numpy(dtype=np.float64)
    for ball in balls:
        own = np.flatnonzero((contacts["particle1"] == ball.particle) | (contacts["particle2"] == ball.particle))
        breaks = at[own]
        part = np.searchsorted(breaks, ball.time)
        gaps = np.flatnonzero(np.diff(ball.time) > cuts.max_gap_s) + 1
        for k in range(len(breaks) + 1):
            inside = np.flatnonzero(part == k)
            for rows in np.split(inside, np.searchsorted(inside, gaps)):
                if not len(rows):
                    continue
                start = int(own[k - 1]) if k > 0 and rows[0] == inside[0] and rows[0] not in gaps else -1
                end = int(own[k]) if k < len(breaks) and rows[-1] == inside[-1] and rows[-1] + 1 not in gaps else -1
                paths.append(_fit_path(ball, rows, (start, end), at, breaks, cuts))
    return paths


def _fit_path(ball: BallTrack, rows: Ints, ends: tuple[int, int], at: Array, breaks: Array, cuts: PathCuts) -> FreePath:
    """Estimate the velocities of one path, whose contacts are the rows `ends` of all, which happen `at` these times."""
    time = ball.time[rows]
    first, last = (float(at[k]) if k >= 0 else float(edge) for k, edge in zip(ends, time[[0, -1]], strict=True))
    early, late = (float(cuts.margins_s[k]) if k >= 0 else 0.0 for k in ends)
    near = (time - first < early) | (last - time < late)
    free, position = time[~near], ball.position[rows[~near]]
    slide_end = find_slide_end(free, position, cuts.noise) if cuts.slides and ends[0] >= 0 else np.nan
    velocities = fit_velocities(free, position, np.append(time, [first, last]), cuts.window_rows, slide_end)
    unsure, step = np.zeros(len(time)), float(np.diff(ball.time).min(initial=1.0))
    if len(free) < 2 and min(ends) >= 0:
        places = [extrapolate_to_contact(ball, breaks, edge, later) for edge, later in ((first, False), (last, True))]
        (one, _), (other, _) = places
        chord = np.tile((other - one) / (last - first), (len(time) + 2, 1))
        gain = np.full(len(chord), 2 / (last - first) ** 2)
        velocities = HalfVelocities(chord, chord.copy(), gain, gain.copy(), gain.copy())
        short = (early + late + step * (2 - sum(sure for _, sure in places))) / 4  # interpolation cuts the corners
        unsure += np.hypot(*velocities.even[0]) * min(short / (last - first), 0.5)
    rows_of_slide = 4  # that show its friction
    if cuts.slides and ends[0] >= 0 and not (free < slide_end).sum() >= rows_of_slide:
        velocities.even[-2] = velocities.odd[-2] = np.nan  # the friction between contact and first row is not known
        rest = early + rows_of_slide * step - (time - first)  # of the longest slide that would not be seen
        usual_friction = 2.0  # m/s^2, deceleration of a ball that slides
        unsure = usual_friction * np.maximum(rest, 0) / 2
    return FreePath(ball.particle, ball.frame[rows], time, *ends, first, last, velocities, unsure)


def extrapolate_to_contact(ball: BallTrack, breaks: Array, at: float, later: bool) -> tuple[Array, bool]:
    """Find a ball's position at one of its contacts, by its path beyond it, and whether two positions show that path.

    breaks: times of all its contacts, s. later: whether that path comes after the contact.
    """
    beyond = breaks[breaks > at].min(initial=np.inf) if later else breaks[breaks < at].max(initial=-np.inf)
    inside = np.flatnonzero((ball.time > min(at, beyond)) & (ball.time < max(at, beyond)))
    rows = inside[:2] if later else inside[-2:]
    if len(rows) < 2:
        return np.array([np.interp(at, ball.time, axis) for axis in ball.position.T]), False
    (one, other), (start, end) = ball.position[rows], ball.time[rows]
    return one + (other - one) * (at - start) / (end - start), True
