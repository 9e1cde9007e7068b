"""The errors of positions, from their own scatter about smooth motion: where a table carries no errors, or wrong ones.

A smooth motion is a cubic over a few frames, to far less than the noise of any detector; what a cubic leaves over
is noise. Contact and slide ends are no cubics: the few windows that hold one are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtr, chdtri

from tracker.measurement.noise.whitening import position_covariance

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
WINDOW, ORDER = 7, 3  # consecutive frames, order of the polynomial
OVER = WINDOW - ORDER - 1
DOF = 2 * OVER  # of a window, both axes
KEPT = 0.95  # quantile of a window with normal errors beyond which a window is left out
SPARED = 0.84  # share of the degrees of freedom that this leaves
MOVED = 3.0  # widths of a glint in a window: a ball that rests may be given in whole pixels, and then never scatters
ENOUGH = 20  # windows of moving balls, without which those of resting ones count too
BENT = 1e-6  # of the probability of so large a chi^2, below which a window holds a push or a hit
LEAST = 1e-10  # of the variance expected: perfect positions have some error yet
STRIDE = 94  # windows whose covariance is made in one go


class BallNoise(Protocol):
    """What is needed of a ball's positions: see `positions.BallTrack`."""

    @property
    def frame(self) -> Ints: ...
    @property
    def position(self) -> Floats: ...
    @property
    def cov(self) -> Floats: ...
    @property
    def fixed(self) -> Floats: ...
    @property
    def width(self) -> float: ...
    @property
    def drift(self) -> tuple[float, float]: ...
    def __len__(self) -> int: ...


@dataclass(frozen=True)
class ScatterRatio:
    """Variance of positions about smooth motion, over that expected; the degrees of freedom from which it was read."""

    ratio: float
    dof: float

    @property
    def sigmas(self) -> float:
        """By how many of its own standard errors the ratio's logarithm differs from that of one."""
        return float(np.log(self.ratio) / np.sqrt(2 / self.dof))


def measure_scatter(balls: Sequence[BallNoise]) -> ScatterRatio | None:
    """Read the size of the positions' errors from their scatter about cubics in windows of consecutive frames.

    Parameters
    ----------
    balls : sequence of Ball
        Their covariances say what is expected. Where enough of them move, only windows in which they do are used.

    Returns
    -------
    Size or None
        None where no ball is seen in WINDOW consecutive frames.
    """
    parts = [_windows(course) for course in balls]
    if sum(len(starts) for starts, _, _ in parts) == 0:
        return None
    if sum(int(moved.sum()) for _, _, moved in parts) >= ENOUGH:
        parts = [(starts[moved], left[moved], moved[moved]) for starts, left, moved in parts]
    left = np.concatenate([part[1] for part in parts])
    typical = float(np.median(left)) / chdtri(DOF, 0.5)
    kept = left[left <= typical * chdtri(DOF, 1 - KEPT)]
    # the mean of what is kept of a window with normal errors, over that of a whole one
    share = chdtr(DOF + 2, chdtri(DOF, 1 - KEPT)) / KEPT
    return ScatterRatio(max(float(kept.mean() / (DOF * share)), LEAST), SPARED * _freedom([part[0] for part in parts]))


def find_bent_windows(course: BallNoise) -> Ints:
    """First frames of the windows in which a ball's motion is no cubic, beside what its positions scatter: (m,)."""
    starts, left, _ = _windows(course)
    return starts[left > np.median(left) * chdtri(DOF, BENT) / chdtri(DOF, 0.5)] if len(left) else starts


def share_seen_by_scatter(rho: float) -> float:
    """Of the variance of errors that last by `rho` from frame to frame, the share that `measure_scatter` sees."""
    t = np.linspace(-1, 1, WINDOW)
    over = np.linalg.qr(np.vander(t, ORDER + 1), mode="complete")[0][:, ORDER + 1 :]
    lag = np.abs(np.subtract.outer(np.arange(WINDOW), np.arange(WINDOW)))
    return float(np.trace(over.T @ rho**lag @ over)) / OVER


def _windows(course: BallNoise) -> tuple[Ints, Floats, NDArray[np.bool_]]:
    """First frames (m,) of all whole windows; what cubics leave, chi^2 of DOF (m,); whether the ball moved (m,)."""
    count = len(course) - WINDOW + 1
    if count < 1:
        return np.empty(0, np.int64), np.empty(0), np.empty(0, dtype=bool)
    t = np.linspace(-1, 1, WINDOW)
    over = np.linalg.qr(np.vander(t, ORDER + 1), mode="complete")[0][:, ORDER + 1 :]  # (WINDOW, OVER)
    slide = np.lib.stride_tricks.sliding_window_view
    rest = (slide(course.position, WINDOW, axis=0) @ over).reshape(count, DOF)
    left = np.empty(count)
    for first in range(0, count, STRIDE):
        rows = slice(first, min(first + STRIDE, count))
        left[rows] = (rest[rows] * np.linalg.solve(_spread(course, rows, over), rest[rows, :, None])[..., 0]).sum(-1)
    whole = course.frame[WINDOW - 1 :] - course.frame[:count] == WINDOW - 1
    moved = np.hypot(*(course.position[WINDOW - 1 :] - course.position[:count]).T) > MOVED * course.width
    return course.frame[:count][whole], left[whole], moved[whole]


def _spread(course: BallNoise, windows: slice, over: Floats) -> Floats:
    """Covariances (k, DOF, DOF) expected of what cubics leave over, axis by axis."""
    k = windows.stop - windows.start
    rows = slice(windows.start, windows.stop + WINDOW - 1)
    out = np.zeros((k, 2, OVER, 2, OVER))
    if course.fixed.any() and course.width > 0:
        whole = position_covariance(
            course.position[rows], course.cov[rows], course.fixed[rows], course.width, course.drift
        )
        n = len(whole) // 2
        full = whole.reshape(n, 2, n, 2)
        each = np.arange(k)[:, None] + np.arange(WINDOW)
        blocks = full[each[:, :, None], :, each[:, None, :], :]  # (k, WINDOW, WINDOW, 2, 2)
        out += np.einsum("ia,kijxy,jb->kxayb", over, blocks, over)
    else:
        own = np.lib.stride_tricks.sliding_window_view(course.cov[rows], WINDOW, axis=0)  # (k, 2, 2, WINDOW)
        out += np.einsum("ia,kxyi,ib->kxayb", over, own, over)
    return out.reshape(k, DOF, DOF)


def _freedom(starts: list[Ints]) -> float:
    """Degrees of freedom of windows that overlap: twice the square of their sum's mean, over its variance."""
    t = np.linspace(-1, 1, WINDOW)
    q = np.linalg.qr(np.vander(t, ORDER + 1))[0]
    rest = np.eye(WINDOW) - q @ q.T
    total = sum(map(len, starts))
    square = float(total * OVER)
    for lag in range(1, WINDOW):
        pairs = sum(int(np.isin(first + lag, first).sum()) for first in starts)
        square += 2 * pairs * float((rest[lag:, lag:] * rest[:-lag, :-lag]).sum())
    return 2 * (OVER * total) ** 2 / square
