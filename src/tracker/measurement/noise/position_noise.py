"""Estimates the errors of positions from their scatter, where a table claims none or wrong ones.

Over a few frames a cubic follows any smooth motion to far less than the noise of a detector, so the residuals are
noise. A contact or a slide's end is not smooth; the few windows that contain one are left out. Among many balls most
windows may contain one. There only those count in which no ball comes near another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import chdtr, chdtri

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.measurement.noise.whitening import covariance_of_windows

WINDOW_FRAMES, POLYNOMIAL_ORDER = 7, 3  # consecutive frames, order of the polynomial
DOF_PER_AXIS = WINDOW_FRAMES - POLYNOMIAL_ORDER - 1  # degrees of freedom per axis
DOF_PER_WINDOW = 2 * DOF_PER_AXIS  # degrees of freedom of a window, both axes


class BallNoise(Protocol):
    """The attributes of a ball's positions that are used here; see `positions.BallTrack`."""

    @property
    def frame(self) -> Ints: ...
    @property
    def position(self) -> Array: ...
    @property
    def cov(self) -> Array: ...
    @property
    def fixed(self) -> Array: ...
    @property
    def width(self) -> float: ...
    @property
    def drifts(self) -> tuple[tuple[float, float], ...]: ...
    def __len__(self) -> int: ...


@dataclass(frozen=True)
class ScatterRatio:
    """Variance of positions about smooth motion, over the expected variance, and its degrees of freedom."""

    ratio: float
    dof: float

    @property
    def sigmas(self) -> float:
        """Distance of the logarithm of the ratio from zero, in its own standard errors."""
        return float(np.log(self.ratio) / np.sqrt(2 / self.dof))


def measure_scatter(balls: Sequence[BallNoise], diameter: float = np.nan) -> ScatterRatio | None:
    """Measure the positions' errors by their scatter about cubics in windows of consecutive frames.

    The balls' covariances give the expected scatter. Windows beyond the 95 % quantile of normal errors of the median
    size are left out. The mean of the others is corrected for that. None where no ball is seen in WINDOW consecutive
    frames.

    diameter: m, of more than two balls. Then windows in which a ball may touch another do not count. None where too few
    others are left: the film does not show noise apart from kinks.
    """
    kept_share = 0.95
    dof_share = 0.84  # share of the degrees of freedom that remains after the largest windows are left out
    enough = 20  # windows of moving balls from which on resting balls do not count: some tables round their positions
    least = 1e-10  # least ratio, for perfect positions
    crowd = len(balls) > 2 and np.isfinite(diameter)
    touches: Sequence[Flags | None] = find_touches(balls, diameter) if crowd else [None] * len(balls)
    parts = [_windows(course, near) for course, near in zip(balls, touches, strict=True)]
    if crowd and sum(len(starts) for starts, _, _ in parts) < enough:
        return None
    if sum(int(moved.sum()) for _, _, moved in parts) >= enough:
        parts = [(starts[moved], left[moved], moved[moved]) for starts, left, moved in parts]
    left = np.concatenate([np.empty(0), *(part[1] for part in parts)])
    if not len(left):
        return None
    limit = chdtri(DOF_PER_WINDOW, 1 - kept_share)
    kept = left[left <= float(np.median(left)) / chdtri(DOF_PER_WINDOW, 0.5) * limit]
    # the mean chi^2 of windows below the quantile, over that of all windows
    share = chdtr(DOF_PER_WINDOW + 2, limit) / kept_share
    ratio = max(float(kept.mean() / (DOF_PER_WINDOW * share)), least)
    return ScatterRatio(ratio, dof_share * _count_freedom([part[0] for part in parts]))


def find_touches(balls: Sequence[BallNoise], diameter: float) -> list[Flags]:
    """Find the positions (n,) of each ball from which it reaches another, or may come from it, within a step.

    The steps before and after a position show the velocity. diameter: m.
    """
    slack = 1.02
    frame, position = np.concatenate([b.frame for b in balls]), np.concatenate([b.position for b in balls])
    before = np.concatenate([np.diff(b.position, axis=0, prepend=b.position[:1]) for b in balls])
    after = np.concatenate([np.diff(b.position, axis=0, append=b.position[-1:]) for b in balls])
    longest = np.maximum(np.hypot(*before.T), np.hypot(*after.T))
    order, touches = np.argsort(frame, kind="stable"), np.zeros(len(frame), dtype=bool)
    for rows in np.split(order, np.flatnonzero(np.diff(frame[order])) + 1):
        reach = slack * diameter + 2 * longest[rows].max(initial=0.0)
        i, j = rows[cKDTree(position[rows]).query_pairs(reach, output_type="ndarray").T]
        way = np.maximum(*(np.hypot(*(step[i] - step[j]).T) for step in (before, after)))
        near = np.hypot(*(position[i] - position[j]).T) < slack * diameter + way
        touches[i[near]] = touches[j[near]] = True
    return np.split(touches, np.cumsum([len(b) for b in balls])[:-1])


def find_bent_windows(course: BallNoise) -> Ints:
    """Find windows whose scatter is no noise, because motion is not smooth there (p < 1e-6): frames (m,)."""
    starts, left, _ = _windows(course)
    limit = chdtri(DOF_PER_WINDOW, 1e-6) / chdtri(DOF_PER_WINDOW, 0.5)
    return starts[left > np.median(left) * limit] if len(left) else starts


def share_seen_by_scatter(rho: float) -> float:
    """Share of the variance of errors correlated by `rho` from frame to frame that `measure_scatter` sees."""
    over = _residual_basis()
    lag = np.abs(np.subtract.outer(np.arange(WINDOW_FRAMES), np.arange(WINDOW_FRAMES)))
    return float(np.trace(over.T @ rho**lag @ over)) / DOF_PER_AXIS


def _residual_basis() -> Array:
    """Orthonormal basis (WINDOW_FRAMES, DOF_PER_AXIS) of what a cubic leaves in a window."""
    cubics = np.vander(np.linspace(-1, 1, WINDOW_FRAMES), POLYNOMIAL_ORDER + 1)
    return np.linalg.qr(cubics, mode="complete")[0][:, POLYNOMIAL_ORDER + 1 :]


def _windows(course: BallNoise, touches: Flags | None = None) -> tuple[Ints, Array, Flags]:
    """First frames (m,) of all whole windows; chi^2 of their residuals (m,); whether the ball moved there (m,).

    A ball counts as moving if it covers three widths of a glint. A window in which a position is only repeated shows
    no noise and is left out: some recorders drop what moves too little. So are windows with one of `touches` (n,).
    """
    stride = 94  # windows whose covariance is computed at once
    count = len(course) - WINDOW_FRAMES + 1
    if count < 1:
        return np.empty(0, np.int64), np.empty(0), np.empty(0, dtype=bool)
    over = _residual_basis()
    slide = np.lib.stride_tricks.sliding_window_view
    rest = (slide(course.position, WINDOW_FRAMES, axis=0) @ over).reshape(count, DOF_PER_WINDOW)
    left = np.empty(count)
    for first in range(0, count, stride):
        rows = slice(first, min(first + stride, count))
        left[rows] = (rest[rows] * np.linalg.solve(_spread(course, rows, over), rest[rows, :, None])[..., 0]).sum(-1)
    steps = np.abs(np.diff(course.position, axis=0)).sum(axis=1)
    whole = course.frame[WINDOW_FRAMES - 1 :] - course.frame[:count] == WINDOW_FRAMES - 1
    whole &= slide(steps, WINDOW_FRAMES - 1).max(-1) > 0
    if touches is not None:
        whole &= ~slide(touches, WINDOW_FRAMES).any(-1)
    moved = np.hypot(*(course.position[WINDOW_FRAMES - 1 :] - course.position[:count]).T) > 3.0 * course.width
    return course.frame[:count][whole], left[whole], moved[whole]


def _spread(course: BallNoise, windows: slice, over: Array) -> Array:
    """Expected covariances (k, DOF, DOF) of the residuals from cubics, axis by axis."""
    k = windows.stop - windows.start
    rows = slice(windows.start, windows.stop + WINDOW_FRAMES - 1)
    out = np.zeros((k, 2, DOF_PER_AXIS, 2, DOF_PER_AXIS))
    if course.fixed.any() and course.width > 0:
        position, cov, fixed = course.position[rows], course.cov[rows], course.fixed[rows]
        blocks = covariance_of_windows(position, cov, fixed, course.width, course.drifts, WINDOW_FRAMES)
        half = (over.T @ blocks.reshape(k, WINDOW_FRAMES, -1)).reshape(k, DOF_PER_AXIS, WINDOW_FRAMES, 4)
        out += (over.T @ half).reshape(k, DOF_PER_AXIS, DOF_PER_AXIS, 2, 2).transpose(0, 3, 1, 4, 2)
    else:
        own = np.lib.stride_tricks.sliding_window_view(course.cov[rows], WINDOW_FRAMES, axis=0)  # (k, 2, 2, frames)
        out += np.einsum("ia,kxyi,ib->kxayb", over, own, over)
    return out.reshape(k, DOF_PER_WINDOW, DOF_PER_WINDOW)


def _count_freedom(starts: list[Ints]) -> float:
    """Effective degrees of freedom of overlapping windows: twice the squared mean of their sum, over its variance."""
    t = np.linspace(-1, 1, WINDOW_FRAMES)
    q = np.linalg.qr(np.vander(t, POLYNOMIAL_ORDER + 1))[0]
    rest = np.eye(WINDOW_FRAMES) - q @ q.T
    total = sum(map(len, starts))
    square = float(total * DOF_PER_AXIS)
    for lag in range(1, WINDOW_FRAMES):
        pairs = sum(int(np.isin(first + lag, first).sum()) for first in starts)
        square += 2 * pairs * float((rest[lag:, lag:] * rest[:-lag, :-lag]).sum())
    return 2 * (DOF_PER_AXIS * total) ** 2 / square
