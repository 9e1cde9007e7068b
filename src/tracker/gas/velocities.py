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

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.gas.hidden_slides import MAX_CHI2_PER_DOF


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
    time: Array, position: Array, at: Array, window_rows: int, slide_end: float = np.nan, noise: float = np.inf
) -> HalfVelocities:
    """Fit velocities at the instants `at` (m,) to the nearest rows of one free path.

    A parabola is fitted to each half of the nearest `window_rows` rows. Few rows have one parabola or straight line
    together. If the slide ends within the window, the acceleration changes there, and the window has more rows. An
    instant may lie beyond the ends of the rows; the parabola is then continued to it.

    time: (n,) s, ascending.
    position: (n, 2) m.
    slide_end: s.
    noise: of a coordinate, m. Windows whose residuals are much larger hide a contact; their gains grow with them.
    """
    result = _fit_windows(time, position, at, window_rows, np.nan, noise)
    if np.isfinite(slide_end):
        wide = window_rows * 8 // 5
        start = time[_choose_rows(time, at, min(window_rows, len(time)))[:, [0, -1]]]
        across = (start[:, 0] < slide_end) & (slide_end < start[:, 1])
        if across.any():
            own = _fit_windows(time, position, at[across], wide, slide_end, noise)
            for one in fields(HalfVelocities):
                getattr(result, one.name)[across] = getattr(own, one.name)
    return result


def _choose_rows(time: Array, at: Array, rows: int) -> Ints:
    """The `rows` consecutive rows whose mean time is nearest to each instant, (m, rows)."""
    first = _nearest(np.lib.stride_tricks.sliding_window_view(time, rows).mean(axis=1), at)
    return np.asarray(first[:, None] + np.arange(rows))


def _fit_windows(
    time: Array, position: Array, at: Array, window_rows: int, slide_end: float, noise: float
) -> HalfVelocities:
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
    if change is not None and rows <= min_rows_of_parabola:
        change = None
    terms = 3 if rows >= min_rows_of_parabola else 2
    one, gain, chi2 = _slope(since, where, terms, change)
    chi2 = chi2 / noise**2 / max(2 * (rows - terms - (change is not None)), 1)
    wider = np.where(chi2 > MAX_CHI2_PER_DOF, chi2, 1.0)
    if rows >= min_rows_of_halves + 2 * (change is not None):
        (even, gain_even, _), (odd, gain_odd, _) = (_slope(since[:, k::2], where[:, k::2], 3, change) for k in (0, 1))
        return HalfVelocities(even, odd, gain_even * wider, gain_odd * wider, np.zeros(m))
    return HalfVelocities(one, one.copy(), gain * wider, gain * wider, gain)


def _nearest(ascending: Array, at: Array) -> Ints:
    """Index of the nearest of ascending values, for each of `at`."""
    if len(ascending) == 1:
        return np.zeros(len(at), dtype=np.int64)
    after = np.clip(np.searchsorted(ascending, at), 1, len(ascending) - 1)
    return np.asarray(after - (at - ascending[after - 1] < ascending[after] - at))


def _slope(since: Array, position: Array, terms: int, change: Array | None = None) -> tuple[Array, Array, Array]:
    """Fit polynomials of `terms` coefficients to (m, k) times and (m, k, 2) positions.

    Returns slopes at time 0, their gains, and the sums of the squares of the residuals.

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
    squares = ((position - design @ coefficients) ** 2).sum(axis=(1, 2))
    return coefficients[:, 1] / scale, inverse[:, 1, 1] / scale[:, 0] ** 2, squares


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
