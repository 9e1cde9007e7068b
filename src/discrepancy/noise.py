"""The noise of measured tracks, from the tracks themselves, and the filter that makes it white.

Within one phase of motion (before, sliding, rolling) a track is smooth; a cubic there leaves the noise, whatever the
physics. Its autocovariance is read off with the cubic's own correlation undone, pooled over clips, balls and axes; what
lies beyond the lags read off is taken from the autoregression that they make, until both agree.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz, toeplitz

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

ORDER = 5  # of the autoregression; Yule-Walker
SMOOTH = 4  # coefficients of the cubic
SHORTEST = 12  # frames: a shorter stretch says little about noise
LONG = 24  # frames: only a stretch as long as this can tell slow noise from motion
ROUNDS = 100  # of the lags beyond ORDER; .9 from frame to frame needs about 60
SETTLED = 1e-4  # of the variance


@dataclass(frozen=True)
class Noise:
    """Autocovariance at lags 0 to ORDER of residuals over their claimed standard deviation: (ORDER + 1,)."""

    covariance: Array

    @property
    def scale(self) -> float:
        """How many times larger the noise is than claimed."""
        return float(np.sqrt(self.covariance[0]))

    @property
    def correlation(self) -> float:
        """Between neighbouring frames."""
        return float(self.covariance[1] / self.covariance[0])

    def filter(self, frame: Ints, ball: Ints) -> Array:
        """The matrix (n, n) that whitens residuals of one axis; rows sorted by ball, then frame.

        Each row predicts its residual from up to ORDER unbroken predecessors, the exact best predictor of that length.
        """
        out = np.zeros((len(frame), len(frame)))
        predictors = [self._predictor(m) for m in range(ORDER + 1)]
        behind = 0
        for k in range(len(frame)):
            unbroken = k > 0 and ball[k] == ball[k - 1] and frame[k] == frame[k - 1] + 1
            behind = min(behind + 1, ORDER) if unbroken else 0
            weights, spread = predictors[behind]
            out[k, k] = 1 / spread
            out[k, k - behind : k] = -weights[::-1] / spread
        return out

    def _predictor(self, m: int) -> tuple[Array, float]:
        """Weights of the m residuals before, nearest first, and the standard deviation of what they leave."""
        if m == 0:
            return np.empty(0), float(np.sqrt(self.covariance[0]))
        weights = solve_toeplitz(self.covariance[:m], self.covariance[1 : m + 1])
        left = self.covariance[0] - weights @ self.covariance[1 : m + 1]
        return weights, float(np.sqrt(max(left, 1e-6 * self.covariance[0])))


def estimate(stretches: Iterable[tuple[Array, Array]]) -> Noise:
    """Noise from unbroken stretches, each within one phase: places (n, axes) and claimed standard deviations (n,).

    Raises ValueError when they are too few.
    """
    sums = np.zeros(ORDER + 1)
    mixing = np.zeros((ORDER + 1, ORDER + 1))
    removers: list[tuple[Array, int]] = []
    for places, claimed in stretches:
        n, axes = places.shape
        if n < SHORTEST:
            continue
        basis, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, n), SMOOTH) / claimed[:, None])
        scaled = (places - places.mean(axis=0)) / claimed[:, None]
        left = scaled - basis @ (basis.T @ scaled)
        sums += [(left[: n - lag] * left[lag:]).sum() for lag in range(ORDER + 1)]
        remover = np.eye(n) - basis @ basis.T
        mixing += axes * _mixing(remover)
        removers.append((remover, axes))
    if not removers:
        raise ValueError("too few unbroken frames to read the noise from")
    longest = max(len(r) for r, _ in removers)
    covariance = _definite(np.asarray(np.linalg.solve(mixing, sums)))
    change = np.inf
    for _ in range(ROUNDS if longest >= LONG else 0):
        beyond = _continued(covariance, longest)
        beyond[: ORDER + 1] = 0
        unread = sum((axes * _lags(r @ toeplitz(beyond[: len(r)]) @ r) for r, axes in removers), np.zeros(ORDER + 1))
        step = np.asarray(np.linalg.solve(mixing, sums - unread)) - covariance
        last, change = change, float(np.abs(step).max())
        if change > last:  # slow noise cannot be told from motion any further
            break
        covariance = _definite(covariance + step)
        if change < SETTLED * covariance[0]:
            break
    return Noise(covariance)


def _mixing(remover: Array) -> Array:
    """E[sum of r_i r_(i+lag)] = sum over m of mixing[lag, m] covariance[m], r what the remover leaves of noise."""
    n = len(remover)
    shifted = [np.eye(n) if m == 0 else np.eye(n, k=m) + np.eye(n, k=-m) for m in range(ORDER + 1)]
    return np.stack([_lags(remover @ s @ remover) for s in shifted], axis=1)


def _lags(matrix: Array) -> Array:
    """The sums along the diagonal and the ORDER diagonals beside it."""
    return np.array([np.trace(matrix, offset=lag) for lag in range(ORDER + 1)])


def _continued(covariance: Array, length: int) -> Array:
    """The autocovariance at lags 0 to length - 1 of the autoregression that has these first lags."""
    weights = solve_toeplitz(covariance[:-1], covariance[1:])[::-1]
    out = np.zeros(max(length, ORDER + 1))
    out[: ORDER + 1] = covariance
    for lag in range(ORDER + 1, length):
        out[lag] = weights @ out[lag - ORDER : lag]
    return out


def _definite(covariance: Array) -> Array:
    """Shrink the lags until the autocovariance is one that a process can have."""
    if not covariance[0] > 0:
        raise ValueError("no noise to be seen between the frames")
    lags = np.abs(np.subtract.outer(np.arange(ORDER + 1), np.arange(ORDER + 1)))
    out = covariance.copy()
    while np.linalg.eigvalsh(out[lags]).min() < 1e-3 * out[0]:
        out[1:] *= 0.95
    return out
