"""How long two bodies that glide push each other, by how their paths bend at a contact.

Before and after the contact the acceleration of a body changes evenly, as on uneven air. During the contact the other
body pushes it. The force is taken as half a sine, as that of a linear spring. Both bodies share the middle and the
duration of the push. All else is free, so masses and diameters do not enter. An instant is a push of no duration.

The force of real bodies follows other laws. `LAWS` says by how much durations are then off.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from synthcam_shared.arrays import Array, Flags
from tracker.measurement.local.stretches import NEAR_ERRORS
from tracker.measurement.positions import BallTrack
from tracker.measurement.stretch_cuts import CUTTER

MIN_SIGMA = 3.5  # standard errors by which the positions must reject an instant
WINDOWS_S = (0.12, 0.075, 0.048)  # to either side of the contact; the first that a push describes counts
MAX_RESIDUAL = 1.5  # rms of the residuals over the errors, up to which it does
MIN_POSITIONS = 8  # of each body on either side, not beside the contact
SHORTEST_FRAMES = 2.0  # of the durations that are tried
LONGEST_SHARE = 0.5  # of the window on one side, which the longest of them takes
STEP = 1.3  # from one of them to the next
COEFFICIENTS = 7  # of a path along an axis: a cubic, the push, and other second and third powers after it
# By restitution: the duration of the half sine that describes a force, over the duration of the force, and the scatter
# of this ratio. These are means and standard deviations over six laws: linear springs and Hertz springs with dashpots,
# that pull at the end or do not, and bodies that keep a dent.
LAWS = np.array([[0.4, 0.5, 0.6, 0.7, 0.9], [0.86, 0.92, 0.945, 0.96, 0.955], [0.15, 0.11, 0.085, 0.065, 0.055]])


class PushDuration(NamedTuple):
    """How long two bodies push each other."""

    value: float  # s
    std: float  # s, with the scatter of the laws of the force
    sigma: float  # standard errors by which the positions reject an instant


class _Path(NamedTuple):
    """Positions of one body near the contact, in errors; those beside it have NEAR_ERRORS times their errors."""

    since: Array  # (n,) s, from the instant of the local fit
    near: Flags  # (n,) whether beside the contact
    weight: Array  # (n,) 1/m
    cubics: Array  # (n, 4) orthonormal; every path with a push contains them
    left: Array  # (n, 2) what they leave of the positions
    exposure: float  # s


class _Push(NamedTuple):
    """The best push of those that are tried, and an instant."""

    duration: float  # s
    middle: float  # s
    square: float  # sum of squared residuals, in errors
    square_of_instant: float
    may_be_longer: bool  # than all that are tried


class _Errors(NamedTuple):
    """The size of the errors, by the residuals of a fit."""

    variance: float  # over the claimed one
    freedom: float  # degrees of freedom
    independent: float  # the same, less what neighbours have in common

    def find_rise(self, squares: Array | float, least: float, size: float) -> Array:
        """Find by how much chi^2 rises above the least, for errors of this variance, which is uncertain itself."""
        share = np.maximum(np.asarray(squares) - least, 0.0) / (size * self.freedom)
        return np.asarray(self.independent * np.log1p(share))


def measure_push(
    tracks: Sequence[BallTrack], instant: float, restitution: float, frame_s: float
) -> PushDuration | None:
    """Measure how long two bodies push each other; None where the positions do not reject an instant.

    instant: of the contact by the local fit, s. restitution: by the same, on which the laws of the force depend.

    The duration has a flat prior. Errors are those of the residuals, and larger if neighbouring residuals correlate.
    """
    claimed = bool(np.isinf(tracks[0].noise_dof))
    for window_s in WINDOWS_S:
        paths = [_cut_path(track, instant, window_s, frame_s) for track in tracks]
        if not all(map(_has_both_sides, paths)):
            return None
        push = _find_push(paths, window_s, frame_s)
        if push is None:
            return None
        errors = _measure_errors(paths, push)
        if errors.variance > MAX_RESIDUAL**2:
            continue
        size = max(errors.variance, 1.0) if claimed else errors.variance
        sigma = float(np.sqrt(errors.find_rise(push.square_of_instant, push.square, size)))
        if push.may_be_longer or not sigma > MIN_SIGMA:
            return None
        return _average_durations(paths, push, errors, size, restitution)._replace(sigma=sigma)
    return None


def _cut_path(track: BallTrack, instant: float, window_s: float, frame_s: float) -> _Path:
    rows = np.abs(track.time - instant) <= window_s
    near = CUTTER.is_beside(track.time, instant, instant, frame_s)[rows]
    since, position = track.time[rows] - instant, track.position[rows]
    weight = 1 / (np.sqrt(track.variance[rows]) * np.where(near, NEAR_ERRORS, 1.0))
    cubics, _ = np.linalg.qr(np.vander(since / window_s, 4, increasing=True) * weight[:, None])
    seen = (position - position.mean(axis=0)) * weight[:, None] if len(position) else position
    left = seen - cubics @ (cubics.T @ seen)
    return _Path(since, near, weight, cubics, left, track.exposure)


def _has_both_sides(path: _Path) -> bool:
    far = path.since[~path.near]
    return bool(min((far < 0).sum(), (far > 0).sum()) >= MIN_POSITIONS)


def _find_push(paths: Sequence[_Path], window_s: float, frame_s: float) -> _Push | None:
    """Find the best push of several durations; None where the paths are too short for one.

    The middle of a long push is found from afar, and starts the search for those of the others.
    """
    shorter = min(float(end) for path in paths for end in (-path.since[0], path.since[-1]))
    longest, shortest = (
        min(LONGEST_SHARE * window_s, 2 * (shorter - MIN_POSITIONS * frame_s)),
        SHORTEST_FRAMES * frame_s,
    )
    if longest < STEP * shortest:
        return None
    durations = np.append(longest / STEP ** np.arange(int(np.log(longest / shortest) / np.log(STEP)) + 1), 0.0)
    middle, _ = _fit_middles(paths, durations[:1], np.zeros(1), durations[:1] / 8)
    middles, squares = _fit_middles(paths, durations, middle, np.maximum(durations, frame_s) / 8)
    best = int(np.argmin(squares[:-1]))
    return _Push(float(durations[best]), float(middles[best]), float(squares[best]), float(squares[-1]), best == 0)


def _fit_middles(paths: Sequence[_Path], durations: Array, middles: Array, reach: Array) -> tuple[Array, Array]:
    """Fit the middles (m,) of pushes, s, from a start and a reach: these, and sums of squares (m,)."""
    for _ in range(3):  # parabolas through three points
        tried = middles + reach * np.array([[-1.0], [0.0], [1.0]])
        before, at, after = _sum_squares(paths, tried.ravel(), np.tile(durations, 3)).reshape(3, -1)
        bend = before - 2 * at + after
        step = np.where(bend > 0, (before - after) / (2 * np.where(bend > 0, bend, 1.0)), np.sign(before - after))
        middles, reach = middles + reach * np.clip(step, -2, 2), reach / 4
    return middles, _sum_squares(paths, middles, durations)


def _sum_squares(paths: Sequence[_Path], middles: Array, durations: Array) -> Array:
    """Sums (m,) of squared residuals, in errors, of the best paths with each of m pushes."""
    total = np.zeros(len(middles))
    for path in paths:
        terms = _list_terms(path, middles[:, None], durations[:, None])
        by_terms = np.swapaxes(terms, 1, 2) @ path.left
        found = np.linalg.solve(np.swapaxes(terms, 1, 2) @ terms, by_terms)
        total += (path.left**2).sum() - (by_terms * found).sum(axis=(1, 2))
    return total


def _list_terms(path: _Path, middles: Array, durations: Array) -> Array:
    """The terms (m, n, 3) of a path with a push beside cubics, of size 1: middles and durations (m, 1), s."""
    late = path.since - middles
    after = np.maximum(late, 0.0)
    push = integrate_push(late, durations, path.exposure)
    terms = np.stack([push, after**2, after**2 * after], -1) * path.weight[:, None]
    terms -= path.cubics @ (path.cubics.T @ terms)
    return np.asarray(terms / np.sqrt((terms**2).sum(axis=1, keepdims=True)))


def integrate_push(late: Array, duration: Array | float, exposure: float = 0.0) -> Array:
    """Integrate a push of unit impulse twice: the way, s, that it adds to a path at times `late` after its middle, s.

    exposure: s, over which the way is averaged.
    """
    duration = np.maximum(duration, 1e-9)
    if exposure > 0:
        last, first = (_integrate_way(late + side * exposure / 2, duration) for side in (1, -1))
        return np.asarray((last - first) / exposure)
    done = np.clip(late / duration + 0.5, 0.0, 1.0)
    inside = duration * (done / 2 - np.sin(np.pi * done) / (2 * np.pi))
    return np.asarray(np.where(done < 1, inside, late))


def _integrate_way(late: Array, duration: Array | float) -> Array:
    """The integral of the way, s^2."""
    done = np.clip(late / duration + 0.5, 0.0, 1.0)
    inside = np.square(duration) * (done**2 / 4 + (np.cos(np.pi * done) - 1) / (2 * np.pi**2))
    return np.asarray(inside + np.where(done < 1, 0.0, (late**2 - np.square(duration) / 4) / 2))


def _measure_errors(paths: Sequence[_Path], push: _Push) -> _Errors:
    """Measure the errors by the residuals of the best paths with a push; those beside the contact show no size."""
    square = follow = alike = 0.0
    for path in paths:
        (terms,) = _list_terms(path, np.array([[push.middle]]), np.array([[push.duration]]))
        left = path.left - terms @ np.linalg.solve(terms.T @ terms, terms.T @ path.left)
        square += float((left[~path.near] ** 2).sum())
        follow += float((left[1:] * left[:-1]).sum())
        alike += float((left**2).sum())
    rho = min(max(follow / max(alike, 1e-300), 0.0), 0.98)
    counted = sum(2 * int((~path.near).sum()) for path in paths)
    freedom = max(counted - 2 * COEFFICIENTS * len(paths) - 2, 1)
    return _Errors(square / freedom, freedom, freedom * (1 - rho) / (1 + rho))


def _average_durations(
    paths: Sequence[_Path], push: _Push, errors: _Errors, size: float, restitution: float
) -> PushDuration:
    """Average the durations about the best one, with their probabilities, and correct for the law of the force."""
    durations = push.duration * np.linspace(0.5, 1.9, 29)
    _, squares = _fit_middles(paths, durations, np.full(len(durations), push.middle), durations / 32)
    weights = np.exp(-errors.find_rise(squares, float(squares.min()), size) / 2)
    weights /= weights.sum()
    mean = float(weights @ durations)
    std = float(np.sqrt(weights @ (durations - mean) ** 2))
    ratio, scatter = (float(np.interp(restitution, LAWS[0], row)) for row in LAWS[1:])
    return PushDuration(mean / ratio, float(np.hypot(std, scatter * mean)) / ratio, 0.0)
