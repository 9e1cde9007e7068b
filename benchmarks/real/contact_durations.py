"""How long contacts of discs on air last, by the bend of their relative path: no diameter and no mass enters.

Before and after the contact the relative path has a constant acceleration, since discs on air lose speed. In between
a push bends it, whose force is half a sine as that of a linear spring. The fit has an instant, a duration, and for each
axis a position, a velocity, the push and both accelerations. If the force follows another law, the duration is some 6 %
off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from benchmarks.real.recordings import RecordedHit

Floats = NDArray[np.float64]
WINDOW_S = 0.12  # to either side of the contact
DURATIONS_S = np.arange(0.0, 0.04, 2e-4)
LAW_SHARE = 0.06  # error of a duration by the law of the force, over it
LEAST_SIGMA = 4.0  # by which the positions must reject an instant
MIN_POSITIONS = 20


@dataclass(frozen=True)
class ContactDuration:
    """The duration of a contact, s, with a flat prior from zero on.

    limit: that is exceeded with a probability of 5 %. sigma: standard errors by which the positions reject an instant.
    """

    duration: float
    std: float
    limit: float
    sigma: float

    @property
    def is_finite(self) -> bool:
        """Whether the positions reject an instant."""
        return self.sigma > LEAST_SIGMA


def measure_contact_duration(hit: RecordedHit) -> ContactDuration | None:
    """Measure how long the two bodies of a hit push each other; None of too few positions.

    The errors are those of the residuals, and are larger if neighbouring residuals correlate.
    """
    time, apart = _read_relative_path(hit.tracks)
    near = float(time[np.argmin(np.hypot(*apart.T))])
    rows = np.abs(time - near) < WINDOW_S
    if rows.sum() < MIN_POSITIONS:
        return None
    since, apart = time[rows] - near, apart[rows]
    squares, instants = np.array([_fit_instant(since, apart, each) for each in DURATIONS_S]).T
    best = int(np.argmin(squares))
    residuals = _find_residuals(since, apart, float(instants[best]), float(DURATIONS_S[best]))
    correlation = max(float((residuals[1:] * residuals[:-1]).sum() / (residuals**2).sum()), 0.0)
    free = 2 * (len(since) - 6)
    variance = squares[best] / free * (1 + correlation) / (1 - correlation)
    rise = (squares - squares[best]) / variance
    weights = np.exp(-rise / 2) / np.exp(-rise / 2).sum()
    mean = float(weights @ DURATIONS_S)
    limit = float(DURATIONS_S[np.searchsorted(np.cumsum(weights), 0.95)])
    std = float(np.sqrt(weights @ (DURATIONS_S - mean) ** 2 + (LAW_SHARE * mean) ** 2))
    return ContactDuration(mean, std, limit, float(np.sqrt(rise[0])))


def _read_relative_path(tracks: pd.DataFrame) -> tuple[Floats, Floats]:
    """Times (n,), s, and positions (n, 2) of particle 0 from particle 1, m, of frames that show both."""
    one, two = (tracks[tracks["particle"] == k] for k in (0, 1))
    both = one.merge(two, on="frame").sort_values("frame")
    apart = both[["x_x", "y_x"]].to_numpy(np.float64) - both[["x_y", "y_y"]].to_numpy(np.float64)
    return both["t_s_x"].to_numpy(np.float64), apart


def _fit_instant(since: Floats, apart: Floats, duration: float, within_s: float = 0.015) -> tuple[float, float]:
    """The least sum of squared residuals with a push of this duration, m^2, and the instant of its middle, s."""

    def price(middle: float) -> float:
        return float((_find_residuals(since, apart, middle, duration) ** 2).sum())

    rough = min(np.linspace(-within_s, within_s, 31).tolist(), key=price)
    bounds = (rough - 1e-3, rough + 1e-3)
    found = minimize_scalar(price, bounds=bounds, method="bounded", options={"xatol": 1e-6})
    return float(found.fun), float(found.x)


def _find_residuals(since: Floats, apart: Floats, middle: float, duration: float) -> Floats:
    """Residuals (n, 2) of the best path with such a push, m."""
    late = since - middle
    losses = np.minimum(late, 0) ** 2, np.maximum(late, 0) ** 2
    path = np.column_stack([np.ones_like(late), late, integrate_push(late, duration), *losses])
    basis, _ = np.linalg.qr(path)
    return np.asarray(apart - basis @ (basis.T @ apart))


def integrate_push(late: Floats, duration: float) -> Floats:
    """The way, s, that a push of unit impulse adds to a path, at times `late` after its middle, s."""
    if duration <= 0:
        return np.maximum(late, 0.0)
    done = np.clip(late / duration + 0.5, 0.0, 1.0)
    inside = duration * (done / 2 - np.sin(np.pi * done) / (2 * np.pi))
    return np.asarray(np.where(done < 1, inside, late))
