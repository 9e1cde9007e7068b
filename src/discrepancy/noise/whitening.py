"""Whitens the residuals of one clip for the fits of a search: noise becomes independent numbers from N(0, 1)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtri, dtrtrs

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.noise.model import Noise, NoiseComponent
from synthcam_shared.arrays import Array, Ints


@dataclass(frozen=True)
class ClipWhitener:
    """The inverse Cholesky factor of the noise's covariance, exact for any missing frames.

    Residuals are first scaled by the claimed covariances. Without shared noise, each ball is then filtered by itself;
    the resting target's constant offset is part of its covariance. With shared noise, or with what differs from stretch
    to stretch, all rows and both axes are filtered together, in order of frames. Each white number is the innovation of
    its row and axis, given the rows before it.
    """

    roots: Array  # (n, 2, 2): inverse Cholesky factors of the claimed covariances
    filters: tuple[Array, ...]  # of the rows of each ball; or one, (2n, 2n)
    order: Ints | None  # (2n,), for the one
    # (2n, 2n): the covariance of scaled residuals without what differs from stretch to stretch; None if nothing does
    noise_alone: Array | None = None

    @classmethod
    def of(cls, clip: MeasuredCollision, noise: Noise) -> ClipWhitener:
        """The whitener of a clip's positions for this noise."""
        roots, offset = clip.roots, clip.resting_offset
        if not noise.shared and clip.scatter is None:
            rows = (clip.ball == ball for ball in (0, 1))
            filters = (_inverse_factor(noise.own, clip.frame[r].tobytes(), offset[r].tobytes()) for r in rows)
            return cls(roots, tuple(filters), None)
        order = np.argsort(np.repeat(clip.frame, 2), kind="stable")
        given = (clip.frame.tobytes(), clip.ball.astype(np.int64).tobytes(), roots.tobytes(), offset.tobytes())
        if clip.scatter is None:
            return cls(roots, (_inverse_factor_of_both(noise.own, noise.shared, *given),), order)
        total = _covariance_of_both(noise.own, noise.shared, *given)
        alone = total.reshape(2 * len(roots), -1).copy()
        total += np.einsum("iab,ibjc,jdc->iajd", roots, clip.scatter, roots, optimize=True)
        return cls(roots, (_invert_covariance_factor(total, order),), order, alone)

    def __call__(self, residuals: Array) -> Array:
        """Residuals (n, 2, ...), m, as white ones (2n, ...) of unit size."""
        return self.decorrelate(self.scale(residuals))

    def scale(self, residuals: Array) -> Array:
        """Residuals (n, 2, ...), m, in units of the claimed errors. The noise has no part in it."""
        flat = residuals.reshape(*residuals.shape[:2], -1)
        scaled = np.empty(flat.shape)
        for axis in (0, 1):  # far quicker than a product of many small matrices
            np.multiply(self.roots[:, axis, :1], flat[:, 0], out=scaled[:, axis])
            scaled[:, axis] += self.roots[:, axis, 1:] * flat[:, 1]
        return scaled.reshape(residuals.shape)

    def decorrelate(self, scaled: Array) -> Array:
        """Scaled residuals (n, 2, ...) as white ones (2n, ...)."""
        rest = scaled.shape[2:]
        if self.order is None:
            split = len(self.filters[0])
            parts = (scaled[:split], scaled[split:])
            both = zip(self.filters, parts, strict=True)
            white = [f @ part.reshape(len(part), -1) for f, part in both if len(part)]
            return np.concatenate(white).reshape(-1, *rest)
        rows = scaled.reshape(2 * len(scaled), -1)
        out: Array = np.empty_like(rows)
        out[self.order] = self.filters[0] @ rows[self.order]
        return out.reshape(-1, *rest)

    def undo(self, white: Array) -> Array:
        """The residuals (n, 2, ...), m, of white numbers (2n, ...)."""
        n, rest = len(self.roots), white.shape[1:]
        flat = white.reshape(2 * n, -1)
        if self.order is None:
            split = len(self.filters[0])
            by_row = flat.reshape(n, -1)
            parts = (by_row[:split], by_row[split:])
            both = zip(self.filters, parts, strict=True)
            scaled = np.concatenate([_solve_lower(f, part) for f, part in both if len(part)])
        else:
            scaled = np.empty_like(flat)
            scaled[self.order] = _solve_lower(self.filters[0], flat[self.order])
        return np.asarray(np.linalg.solve(self.roots, scaled.reshape(n, 2, -1)).reshape(n, 2, *rest))

    def undo_noise(self, white: Array) -> Array:
        """As `undo`, without the most likely displacements by what differs from stretch to stretch."""
        if self.noise_alone is None or self.order is None:
            return self.undo(white)
        n, rest = len(self.roots), white.shape[1:]
        flat, pulled = white.reshape(2 * n, -1)[self.order], np.empty((2 * n, white.size // (2 * n)))
        pulled[self.order] = self.filters[0].T @ flat
        scaled = self.noise_alone @ pulled
        return np.asarray(np.linalg.solve(self.roots, scaled.reshape(n, 2, -1)).reshape(n, 2, *rest))

    @property
    def log_determinant(self) -> float:
        """Log determinant of the whole covariance less that of the claimed ones."""
        times = 2 if self.order is None else 1
        return -2 * times * float(sum(np.log(np.diagonal(f)).sum() for f in self.filters))


@lru_cache(maxsize=256)
def _inverse_factor(component: NoiseComponent, frames: bytes, offsets: bytes) -> Array:
    """The filter of one ball's rows and one axis; clips share it by the cache. frames: int64, offsets: float64."""
    frame = np.frombuffer(frames, dtype=np.int64)
    if not len(frame):
        return np.zeros((0, 0))
    apart = np.abs(frame[:, None] - frame)
    lags = component.autocovariances(int(apart.max(initial=0)) + 1)
    offset = np.frombuffer(offsets)
    out = _invert_lower(np.linalg.cholesky(lags[apart] + np.outer(offset, offset)))
    out.flags.writeable = False
    return out


@lru_cache(maxsize=32)
def _inverse_factor_of_both(
    own: NoiseComponent, shared: tuple[NoiseComponent, ...], frames: bytes, balls: bytes, roots: bytes, offsets: bytes
) -> Array:
    """The filter of both balls and axes, in order of frames, for shared noise; clips with the same frames share it."""
    order = np.argsort(np.repeat(np.frombuffer(frames, dtype=np.int64), 2), kind="stable")
    out = _invert_covariance_factor(_covariance_of_both(own, shared, frames, balls, roots, offsets), order)
    out.flags.writeable = False
    return out


def _covariance_of_both(
    own: NoiseComponent, shared: tuple[NoiseComponent, ...], frames: bytes, balls: bytes, roots: bytes, offsets: bytes
) -> Array:
    """The covariance (n, 2, n, 2) of the scaled residuals of both balls."""
    frame, ball = (np.frombuffer(given, dtype=np.int64) for given in (frames, balls))
    offset, n = np.frombuffer(offsets), len(frame)
    apart = np.abs(frame[:, None] - frame)
    longest = int(apart.max()) + 1
    alone = own.autocovariances(longest)[apart] * (ball[:, None] == ball) + np.outer(offset, offset)
    total = np.zeros((n, 2, n, 2))
    for axis in range(2):
        total[:, axis, :, axis] += alone
    for axis, component in enumerate(shared):
        push = np.frombuffer(roots).reshape(n, 2, 2)[:, :, axis]  # of a displacement, in scaled residuals
        lags = component.autocovariances(longest)[apart]
        for a, b in itertools.product(range(2), range(2)):
            if push[:, a].any() and push[:, b].any():
                total[:, a, :, b] += lags * np.outer(push[:, a], push[:, b])
    return total


def _invert_covariance_factor(total: Array, order: Ints) -> Array:
    """The inverse Cholesky factor of a covariance (n, 2, n, 2), its rows in this order."""
    size = len(order)
    return _invert_lower(np.linalg.cholesky(total.reshape(size, size)[np.ix_(order, order)]))


def _invert_lower(lower: NDArray[np.floating]) -> Array:
    return np.asarray(dtrtri(lower, lower=1)[0], dtype=np.float64)


def _solve_lower(lower: Array, columns: Array) -> Array:
    return np.asarray(dtrtrs(lower, columns, lower=1)[0])
