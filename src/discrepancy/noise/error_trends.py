"""Corrects claimed errors: a shift of every second frame, and noise that is not the same for all positions.

Both are read from smooth stretches of the tracks, without their cubics, so neither depends on a model of the impact.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc, fdtrc, ndtri

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import T_C
from discrepancy.data.notes import SearchNote, SearchNoteKind
from discrepancy.noise.model import CUBIC_COEFFICIENTS, Noise, cubic_basis
from discrepancy.policy import current_policy
from synthcam_shared.arrays import Array, Ints

Clips = list[MeasuredCollision]


# --- A shift of every second frame ---


def remove_frame_shift(
    clips: Sequence[MeasuredCollision], usual: Sequence[MeasuredCollision]
) -> tuple[Clips, list[SearchNote]]:
    """Remove what moves every second frame: a displacement that all positions share, or a delay.

    Half-frames of an interlaced film and a shutter with two curtains make such shifts. A least-squares fit gives x, y
    and the delay. The scatter of the stretches about it gives their covariance (the sandwich estimate of Liang & Zeger,
    Biometrika 73 (1986) 13). Hotelling's T^2 gives their significance.

    usual: the clips to fit, which show the shift; clips: all from which it is removed. Returns those, and a note if
    there is such a shift.
    """
    parts = [part for clip in usual for part in _shift_equations(clip)]
    kept: list[int] = [0, 1, 2]
    while len(parts) > 3 * len(kept):
        shift, covariance = _solve_shift(parts, kept)
        sigma = _hotelling_sigma(shift, covariance, len(parts))
        if not sigma > current_policy().frame_shift_sigma:
            break
        own = [_hotelling_sigma(shift[[k]], covariance[[k]][:, [k]], len(parts)) for k in range(len(kept))]
        weakest = int(np.argmin(own))
        if own[weakest] > current_policy().frame_shift_sigma or len(kept) == 1:
            whole = np.zeros(3)
            whole[kept] = shift
            values = {"x_um": 1e6 * whole[0], "y_um": 1e6 * whole[1], "late_ms": 1e3 * whole[2], "sigma": sigma}
            moved = [replace(c, xy=c.xy - _shift_columns(c.frame, _velocities(c)) @ whole) for c in clips]
            return moved, [SearchNote(SearchNoteKind.FRAME_SHIFT, values=values)]
        del kept[weakest]
    return list(clips), []


def _parity(frame: Ints) -> Array:
    """+1/2 in odd frames, -1/2 in even ones, so that a strength of 1 is the difference between them."""
    return np.where(frame % 2 == 1, 0.5, -0.5)


def _shift_columns(frame: Ints, velocity: Array) -> Array:
    """Displacements (n, 2, 3) by 1 m in x, 1 m in y, and 1 s later."""
    columns = np.concatenate([np.broadcast_to(np.eye(2), (len(frame), 2, 2)), velocity[:, :, None]], axis=2)
    return np.asarray(_parity(frame)[:, None, None] * columns)


def _shift_equations(clip: MeasuredCollision) -> Iterator[tuple[Array, Array]]:
    """Normal equations (3, 3) and right sides (3,) of each stretch, weighted by the claimed errors."""
    claimed, least = clip.claimed_std(), current_policy().min_short_stretch_positions
    for rows in clip.stretch_rows():
        if len(rows) < least:
            continue
        frame, weight = clip.frame[rows], 1 / claimed[rows]
        q, _ = np.linalg.qr(cubic_basis(frame - frame[0]) * weight[:, None])
        columns = _shift_columns(frame, _velocity(frame, clip.xy[rows], clip.fps))
        both = np.concatenate([columns, clip.xy[rows][..., None]], axis=2) * weight[:, None, None]
        left = both - np.einsum("nk,mk,mai->nai", q, q, both)
        gram = np.einsum("nai,naj->ij", left, left)
        yield gram[:-1, :-1], gram[:-1, -1]


def _solve_shift(parts: Sequence[tuple[Array, Array]], kept: list[int]) -> tuple[Array, Array]:
    """The shift (k,) and its covariance (k, k), from normal equations; k = len(kept)."""
    grams = np.array([gram[np.ix_(kept, kept)] for gram, _ in parts])
    sides = np.array([side[kept] for _, side in parts])
    inverse = np.linalg.pinv(grams.sum(axis=0))
    shift = inverse @ sides.sum(axis=0)
    pulls = sides - grams @ shift
    return shift, inverse @ (pulls.T @ pulls) @ inverse * len(parts) / (len(parts) - len(kept))


def _hotelling_sigma(shift: Array, covariance: Array, count: int) -> float:
    """Sigma of a shift of k numbers from `count` stretches."""
    size = len(shift)
    squared = float(shift @ np.linalg.pinv(covariance) @ shift)
    return _to_sigma(float(fdtrc(size, count - size, squared * (count - size) / (size * (count - 1)))))


def _to_sigma(p: float) -> float:
    """The |z| of a normal variable with this p-value; 37 at most, where p-values end."""
    return float(-ndtri(max(p, 1e-300) / 2))


def _velocity(frame: Ints, xy: Array, fps: float) -> Array:
    """Velocity (n, 2), m/s, from the cubic through the positions of one stretch."""
    since = (frame - frame[0]) / fps
    unit = max(float(since[-1]), 1 / fps) / 2
    scaled = since / unit - 1
    cubic = np.polynomial.polynomial.polyfit(scaled, xy, min(CUBIC_COEFFICIENTS, len(frame)) - 1)
    slope = np.polynomial.polynomial.polyder(cubic)
    return np.asarray(np.polynomial.polynomial.polyval(scaled, slope).T / unit)


def _velocities(clip: MeasuredCollision, window: int = 7) -> Array:
    """Velocities (n, 2), m/s, of the rows: slopes over `window` positions of a ball, none across the contact."""
    velocity = np.zeros((len(clip.frame), 2))
    late = clip.frame / clip.fps >= clip.launch[T_C]
    for ball, side in itertools.product((0, 1), (~late, late)):
        part = np.flatnonzero((clip.ball == ball) & side)
        if len(part) < 2:
            continue
        width = min(window, len(part))
        first = np.clip(np.arange(len(part)) - width // 2, 0, len(part) - width)
        near = part[first[:, None] + np.arange(width)]
        time = clip.frame[near] / clip.fps
        time = time - time.mean(axis=1, keepdims=True)
        velocity[part] = np.einsum("nk,nka->na", time, clip.xy[near]) / (time**2).sum(axis=1)[:, None]
    return velocity


# --- Noise that is not the same everywhere ---


def rescale_errors(
    clips: Sequence[MeasuredCollision], usual: Sequence[MeasuredCollision], noise: Noise
) -> tuple[Clips, list[SearchNote]]:
    """Rescale the claimed errors where the size of the noise depends on speed, position, ball or frame parity.

    The logarithm of the variance is linear in columns for each of the four. Their coefficients maximise the gamma
    likelihood of the squared innovations, and their scatter gives the dispersion (McCullagh & Nelder, Generalized
    Linear Models, 1989, chapter 8). A dependence stays if it exceeds `SearchPolicy.noise_trend_sigma` and changes the
    noise by more than the factor `SearchPolicy.min_noise_trend`. The mean of the logarithm stays, and no factor
    exceeds those of the fitted rows.

    usual: the clips to fit, whose noise is `noise`; clips: all that are rescaled. Returns those and a note for each
    dependence.
    """
    squares, rows = _innovations(usual, noise)
    if not len(squares):
        return list(clips), []
    trends, policy = _list_trends(usual), current_policy()
    while trends:
        blocks = [np.concatenate([t(c)[r] for c, r in zip(usual, rows, strict=True)]) for t in trends.values()]
        sizes, sigmas = _fit_variance(squares, blocks)
        seen = [block @ size for block, size in zip(blocks, sizes, strict=True)]
        sigma = dict(zip(trends, sigmas, strict=True))
        ratio = dict(zip(trends, map(_ratio_of_sizes, seen), strict=True))
        failing = [k for k in trends if not (sigma[k] > policy.noise_trend_sigma and ratio[k] > policy.min_noise_trend)]
        if failing:
            del trends[min(failing, key=sigma.__getitem__)]
            continue
        level, scaled = float(np.mean(sum(seen))), []
        for clip in clips:  # no further than the fitted rows show
            each = zip(trends.values(), sizes, seen, strict=True)
            log = sum(np.clip(t(clip) @ s, part.min(), part.max()) for t, s, part in each)
            scaled.append(replace(clip, covariance=clip.covariance * np.exp(log - level)[:, None, None]))
        return scaled, [SearchNote(kind, values={"ratio": ratio[kind], "sigma": sigma[kind]}) for kind in trends]
    return list(clips), []


def _list_trends(clips: Sequence[MeasuredCollision]) -> dict[SearchNoteKind, Callable[[MeasuredCollision], Array]]:
    """List what the noise may depend on: columns (n, k) for the rows of a clip, zero where nothing changes."""
    speeds = np.concatenate([_speeds(c) for c in clips])
    knots = np.array([0.0, *np.quantile(speeds[speeds > 0.05 * speeds.max()], (1 / 3, 2 / 3, 0.98))])
    middle = np.mean(np.concatenate([c.xy for c in clips]), axis=0)
    spread = np.std(np.concatenate([c.xy for c in clips]), axis=0)

    def by_speed(clip: MeasuredCollision) -> Array:
        weights = [np.interp(_speeds(clip), knots, unit) for unit in np.eye(len(knots))[1:]]
        return np.stack(weights, axis=1)

    def by_place(clip: MeasuredCollision) -> Array:
        x, y = ((clip.xy - middle) / spread).T
        return np.stack([x, y, x * x, x * y, y * y], axis=1)

    def by_ball(clip: MeasuredCollision) -> Array:
        return np.asarray(np.where((clip.ball == 1) == (clip.striker == "b"), 0.5, -0.5)[:, None])

    return {
        SearchNoteKind.NOISE_BY_SPEED: by_speed,
        SearchNoteKind.NOISE_BY_PLACE: by_place,
        SearchNoteKind.NOISE_BY_BALL: by_ball,
        SearchNoteKind.NOISE_BY_PARITY: lambda clip: _parity(clip.frame)[:, None],
    }


def _speeds(clip: MeasuredCollision) -> Array:
    return np.asarray(np.hypot(*_velocities(clip).T))


def _innovations(clips: Sequence[MeasuredCollision], noise: Noise, min_share: float = 0.05) -> tuple[Array, list[Ints]]:
    """Squared innovations (n,) of tracks less their cubics, over the share that these leave; and their rows."""
    squares, rows, least = list[Array](), list[Ints](), current_policy().min_short_stretch_positions
    for clip in clips:
        claimed, own = clip.claimed_std(), [np.zeros(0, dtype=np.int64)]
        for part in _cut(clip.stretch_rows(), least, whole=not noise.whole_phase_scale):
            frame = clip.frame[part] - clip.frame[part[0]]
            lags = noise.own.autocovariances(int(frame[-1]) + 1)
            factor = np.linalg.cholesky(lags[np.abs(frame[:, None] - frame)])
            both = np.column_stack([cubic_basis(frame), clip.xy[part]]) / claimed[part, None]
            white = np.linalg.solve(factor, both)
            q, _ = np.linalg.qr(white[:, :CUBIC_COEFFICIENTS])
            seen = white[:, CUBIC_COEFFICIENTS:]
            left, share = seen - q @ (q.T @ seen), 1 - (q**2).sum(axis=1)
            shown = share > min_share
            squares.append((left[shown] ** 2).mean(axis=1) / share[shown])
            own.append(part[shown])
        rows.append(np.concatenate(own))
    return np.concatenate(squares) if squares else np.zeros(0), rows


def _cut(stretches: Iterator[Ints], size: int, whole: bool) -> Iterator[Ints]:
    """Stretches of at least `size` positions; cut into pieces of that size where no cubic follows a whole one."""
    for rows in stretches:
        if whole and len(rows) >= size:
            yield rows
        elif not whole:
            yield from (rows[k : k + size] for k in range(0, len(rows) - size + 1, size))


def _fit_variance(squares: Array, blocks: Sequence[Array], rounds: int = 30) -> tuple[list[Array], list[float]]:
    """Fit log variances, linear in all blocks: coefficients and sigma of each. Each scoring step is least squares."""
    design = np.column_stack([np.ones(len(squares)), *blocks])
    inverse = np.linalg.pinv(design)
    squares = np.maximum(squares, 1e-6 * squares.mean())
    x = np.zeros(design.shape[1])
    x[0] = np.log(squares.mean())
    for _ in range(rounds):
        ratio = squares * np.exp(-design @ x)
        step = inverse @ (ratio - 1)
        x = x + step * min(1.0, 1.0 / max(float(np.abs(design @ step).max()), 1e-12))
        if np.abs(step).max() < 1e-6:
            break
    dispersion = float(np.sum((squares * np.exp(-design @ x) - 1) ** 2)) / max(len(squares) - len(x), 1)
    covariance = dispersion * (inverse @ inverse.T)
    sizes, sigmas, first = [], [], 1
    for block in blocks:
        own = slice(first, first + block.shape[1])
        first += block.shape[1]
        sizes.append(x[own])
        chi2 = float(x[own] @ np.linalg.pinv(covariance[own, own]) @ x[own])
        sigmas.append(_to_sigma(float(chdtrc(block.shape[1], chi2))))
    return sizes, sigmas


def _ratio_of_sizes(logs: Array) -> float:
    """The ratio of the noise where it is large to that where it is small, from logarithms of the variance."""
    low, high = np.quantile(logs, (0.05, 0.95))
    return float(np.exp((high - low) / 2))
