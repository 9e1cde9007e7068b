"""How well places are known, told by the places themselves: for tables that carry no errors.

A smooth motion is a cubic over a few frames, to far less than the noise of any detector; what a cubic leaves over
is noise. Contact and slide ends are no cubics: the few windows that hold one are left out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

Floats = NDArray[np.float64]
WINDOW, ORDER = 7, 3  # consecutive frames, order of the polynomial
DOF = 2 * (WINDOW - ORDER - 1)  # of a window, both axes
KEPT = 0.95  # quantile of an honest window beyond which a window is left out
FLOOR_PX = 1e-6


def scatter(frame: NDArray[np.int64], particle: NDArray[np.int64], xy: Floats) -> float:
    """Standard deviation, px an axis, of places (n, 2); NaN without WINDOW consecutive frames of one ball."""
    parts = []
    for ball in np.unique(particle):
        rows = np.flatnonzero(particle == ball)
        rows = rows[np.argsort(frame[rows], kind="stable")]
        parts.append(_left_over(frame[rows], xy[rows]))
    left = np.concatenate([*parts, np.empty(0)])
    if not len(left):
        return np.nan
    typical = float(np.median(left)) / chi2.ppf(0.5, DOF)
    kept = left[left <= typical * chi2.ppf(KEPT, DOF)]
    # the mean of what is kept of an honest window, over that of a whole one
    share = chi2.cdf(chi2.ppf(KEPT, DOF), DOF + 2) / KEPT
    return max(float(np.sqrt(kept.mean() / (DOF * share))), FLOOR_PX)


def _left_over(frame: NDArray[np.int64], xy: Floats) -> Floats:
    """Sums of squares (m,), px^2, that cubics leave over in every window of consecutive frames."""
    if len(frame) < WINDOW:
        return np.empty(0)
    whole = frame[WINDOW - 1 :] - frame[: -(WINDOW - 1)] == WINDOW - 1
    t = np.linspace(-1, 1, WINDOW)
    q = np.linalg.qr(np.vander(t, ORDER + 1))[0]
    rest = np.eye(WINDOW) - q @ q.T
    windows = np.lib.stride_tricks.sliding_window_view(xy, WINDOW, axis=0)[whole]  # (m, 2, WINDOW)
    return np.asarray(((windows @ rest) ** 2).sum(axis=(1, 2)), dtype=np.float64)
