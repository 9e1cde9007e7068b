"""Whitens one ball's positions for the tracker's fits: by noise, and by errors that a pixel pattern makes.

A pixel's own response and offset are the same in every frame. So a ball at rest has the same error in all frames, and
a slow ball shares part of it from frame to frame. To first order, a random pattern of pixels shifts a Gaussian glint by
the gradient of a smooth random field. With the glint's width s, shifts at two positions D apart then correlate as (1 -
D D^T / 2 s^2) exp(-|D|^2 / 4 s^2). At D = 0, a resting ball, that is one. Any further correlation from frame to frame
is described by a first-order autoregression.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, product

import numpy as np
from scipy.linalg.blas import dtrmm

from synthcam_shared.arrays import Array, Flags, Ints, inverse_roots


class PositionWhitener:
    """Turns errors of n positions of one ball into independent ones of unit size.

    Rows are whitened in blocks. A block ends where the next position is far away; a single row needs no block.
    """

    def __init__(
        self, position: Array, cov: Array, fixed: Array, width: float,
        frame: Ints | None = None, rho: float = 0.0,
        drifts: Sequence[tuple[float, float]] = (),
    ) -> None:  # fmt: skip
        """The arguments are attributes of a `positions.BallTrack`."""
        self.alone = inverse_roots(cov) if len(cov) else cov
        self.blocks: list[tuple[slice, Array]] = []
        if width > 0 and len(cov) and fixed.any():
            step = np.hypot(*np.diff(position, axis=0).T)
            # five widths apart, shifts correlate by less than 0.002
            longest = max(width, *(length for _, length in drifts), 0.0)
            for start, end in _split_stretches(step > 5.0 * longest):
                rows = slice(start, end)
                whole = position_covariance(position[rows], cov[rows], fixed[rows], width, drifts)
                self.blocks.append((rows, _lower_root(whole)))
        self.kept = None if frame is None or rho == 0 else rho ** np.diff(frame)

    def __call__(self, errors: Array) -> Array:
        """errors (..., n, 2) -> (..., 2n)."""
        root, out = self.alone, np.empty(errors.shape)
        out[..., 0] = root[:, 0, 0] * errors[..., 0]
        out[..., 1] = root[:, 1, 0] * errors[..., 0] + root[:, 1, 1] * errors[..., 1]
        out = out.reshape(*errors.shape[:-2], -1)
        for rows, whole in self.blocks:
            block = errors[..., rows, :].reshape(-1, len(whole))
            part = slice(2 * rows.start, 2 * rows.start + len(whole))
            white = dtrmm(1.0, whole.T, block.T, trans_a=1)  # whole @ block.T, without what is zero
            out[..., part] = white.T.reshape(*errors.shape[:-2], -1)
        return out if self.kept is None else compute_innovations(out, self.kept)

    def distance(self, errors: Array, rows: Flags | slice = slice(None)) -> Array:
        """(..., n) squared Mahalanobis distance of each position by itself, errors (..., n, 2) of n of the rows."""
        root, x, y = self.alone[rows], errors[..., 0], errors[..., 1]
        return np.asarray((root[:, 0, 0] * x) ** 2 + (root[:, 1, 0] * x + root[:, 1, 1] * y) ** 2)


def compute_innovations(errors: Array, kept: Array) -> Array:
    """Whiten errors (..., 2n) that keep a share (n - 1,) of the previous row: innovations (..., 2n) of unit size."""
    rows = errors.reshape(*errors.shape[:-1], -1, 2)
    new = (rows[..., 1:, :] - kept[:, None] * rows[..., :-1, :]) / np.sqrt(1 - kept**2)[:, None]
    return np.concatenate([rows[..., :1, :], new], axis=-2).reshape(errors.shape)


def _split_stretches(breaks: Flags) -> list[tuple[int, int]]:
    """(first, beyond last) of the stretches of two or more rows between breaks, none longer than 200."""
    edges = [0, *(np.flatnonzero(breaks) + 1).tolist(), len(breaks) + 1]
    parts = [(k, min(k + 200, last)) for first, last in pairwise(edges) for k in range(first, last, 200)]
    return [(first, last) for first, last in parts if last - first > 1]


def position_covariance(
    position: Array, cov: Array, fixed: Array, width: float, drifts: Sequence[tuple[float, float]] = ()
) -> Array:
    """Compute the full covariance (2n, 2n), m^2, of a ball's positions (n, 2); arguments as for `PositionWhitener`."""
    n = len(position)
    if drifts:
        own = sum(size**2 for size, _ in drifts) * np.eye(2)
        whole = position_covariance(position, cov - own, fixed - own, width).reshape(n, 2, n, 2)
        near = _correlate_drifts(position[:, None] - position[None], drifts)
        for axis in (0, 1):
            whole[:, axis, :, axis] += near
        return whole.reshape(2 * n, 2 * n)
    fixed, root = _find_roots_of_fixed(cov, fixed)
    kernel = np.empty((n, 2, n, 2))
    _correlate_shifts((position[:, None] - position[None]) / width, kernel.transpose(0, 2, 1, 3))
    half = (root @ kernel.reshape(n, 2, 2 * n)).reshape(2 * n, n, 2)
    shared = (root @ half.transpose(1, 2, 0)).reshape(2 * n, 2 * n)  # both symmetric: so is the transpose
    each = np.arange(n)
    shared.reshape(n, 2, n, 2)[each, :, each, :] += cov - fixed
    return np.asarray(shared, dtype=np.float64)


def covariance_of_windows(
    position: Array, cov: Array, fixed: Array, width: float, drifts: Sequence[tuple[float, float]], length: int
) -> Array:
    """The blocks (k, length, length, 2, 2) of `position_covariance` that windows of consecutive positions see."""
    own = sum(size**2 for size, _ in drifts) * np.eye(2)
    fixed, root = _find_roots_of_fixed(cov - own, fixed - own)
    first, lags = np.arange(len(position)), range(length)
    second = np.minimum(first[:, None] + lags, len(position) - 1)
    apart, band = position[second] - position[:, None], np.empty((len(position), length, 2, 2))
    _correlate_shifts(apart / width, band)
    band = root[:, None] @ band @ root[second]  # of a position and those after it
    band[:, 0] += cov - own - fixed
    band += _correlate_drifts(apart, drifts)[..., None, None] * np.eye(2)
    count = len(position) - length + 1
    out = np.empty((count, length, length, 2, 2))
    for i, lag in product(lags, lags):
        if i + lag < length:
            out[:, i, i + lag] = band[i : i + count, lag]
            out[:, i + lag, i] = np.swapaxes(band[i : i + count, lag], 1, 2)
    return out


def _find_roots_of_fixed(cov: Array, fixed: Array) -> tuple[Array, Array]:
    """The part of covariances (n, 2, 2) that lasts, a thousandth less than the whole at most, and its square roots.

    Each frame so keeps a thousandth of its variance for itself, and the matrix of all stays regular.
    """
    each_root = inverse_roots(cov)
    most = np.linalg.eigvalsh(each_root @ fixed @ np.swapaxes(each_root, 1, 2))[:, -1]
    fixed = fixed * np.minimum(1.0, (1 - 1e-3) / np.maximum(most, 1e-300))[:, None, None]
    size, axes = np.linalg.eigh(fixed)
    return fixed, axes * np.sqrt(np.maximum(size, 0.0))[:, None, :] @ np.swapaxes(axes, 1, 2)


def _correlate_shifts(apart: Array, out: Array) -> None:
    """Compute the correlation (..., 2, 2) of shifts by a pixel pattern, of positions `apart` (..., 2) widths."""
    x, y = np.ascontiguousarray(apart[..., 0]), np.ascontiguousarray(apart[..., 1])
    half_x, half_y = x * x / 2, y * y / 2
    near = np.exp((half_x + half_y) / -2)
    out[..., 0, 0], out[..., 1, 1] = near * (1 - half_x), near * (1 - half_y)
    out[..., 0, 1] = out[..., 1, 0] = near * x * y / -2


def _correlate_drifts(apart: Array, drifts: Sequence[tuple[float, float]]) -> Array:
    """Covariance (...) along either axis, m^2, of drifts at positions `apart` (..., 2), m: Matern's kernel (3/2)."""
    way, near = np.sqrt(3) * np.hypot(apart[..., 0], apart[..., 1]), np.zeros(apart.shape[:-1])
    for rms, length in drifts:
        near += rms**2 * (1 + way / length) * np.exp(-way / length)
    return near


def _lower_root(cov: Array) -> Array:
    """`inverse_roots` of one matrix, by halves down to 24 rows, in a third of the time."""
    half = len(cov) // 2
    if half < 24:
        return inverse_roots(cov)
    out = np.zeros_like(cov)
    first = out[:half, :half] = _lower_root(cov[:half, :half])
    below = cov[half:, :half] @ first.T
    second = out[half:, half:] = _lower_root(cov[half:, half:] - below @ below.T)
    out[half:, :half] = -second @ (below @ first)
    return out
