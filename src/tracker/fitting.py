"""Weighted least squares for motions: best parameters, their Fisher covariance, how well they fit.

The free quantities of a clip that hardly shows them would leave the normal equations singular. A broad prior,
far wider than any physics, keeps them regular; what it decides comes out with a standard error as wide as
itself, and is then not claimed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from .motion import FREE, TARGET, TIED, path, release, release_slope
from .places import Course

Floats = NDArray[np.float64]
OUTLIER = 36.0  # Mahalanobis distance squared: 6 sigma, one in 10^8 for an honest place
OUTLIER_SHARE = 0.05

# name: (centre, width). Wide enough to weigh nothing against data, stated here and nowhere else.
BROAD: Mapping[str, tuple[float, float]] = {
    "drag": (0.0, 20.0),
    "decel": (0.0, 2.0),
    "r": (0.5, 5.0),
    "C": (0.0, 5.0),
    "log_mu": (float(np.log(0.2)), 4.0),
    "log_tau1": (float(np.log(0.03)), 4.0),
    "log_tau2": (float(np.log(0.03)), 4.0),
    **dict.fromkeys(("v1x", "v1y", "f1x", "f1y", "v2x", "v2y", "f2x", "f2y"), (0.0, 10.0)),
}


@dataclass(frozen=True)
class Fit:
    """Best parameters (p,), covariance (p, p), zero where a parameter is held; chi^2 of the data alone, degrees of
    freedom; places dropped as outliers.
    """

    parameters: Floats
    cov: Floats
    chi2: float
    dof: int
    dropped: int = 0
    converged: bool = True


@dataclass(frozen=True, eq=False)
class Pair:
    """Two balls about one contact: their places, and what is known beforehand.

    diameter m; moving: whether ball 1 (struck) moves before the hit; spin m/s: see `release`.
    """

    struck: Course
    striker: Course
    diameter: float
    moving: bool = False
    spin: float = 0.0

    @property
    def balls(self) -> tuple[tuple[int, Course], tuple[int, Course]]:
        """(1, struck), (2, striker)."""
        return (1, self.struck), (2, self.striker)

    def __len__(self) -> int:
        return len(self.struck) + len(self.striker)


class Whitened:
    """The two balls' places, in units of their own error, against a motion: residuals and derivatives.

    x: the parameters that are fitted, all of TIED or FREE but, where ball 1 rests, its velocity.
    """

    def __init__(self, pair: Pair, tied: bool) -> None:
        self.pair, self.tied = pair, tied
        names = TIED if tied else FREE
        self.names = names if pair.moving else names[: -len(TARGET)]
        centres = np.array([BROAD.get(name, (0.0, np.inf)) for name in self.names])
        self.prior, self.prior_weight = centres[:, 0], 1.0 / centres[:, 1]
        self._last: tuple[bytes, Floats, Floats] | None = None

    def __call__(self, x: Floats) -> tuple[Floats, Floats]:
        """Residuals (2n + p,) and derivatives (2n + p, p), priors last; kept for the last x."""
        key = x.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = (key, *self._evaluate(x))
        return self._last[1], self._last[2]

    def residual(self, x: Floats) -> Floats:
        """Whitened residuals (2n + p,), priors last."""
        return self(x)[0]

    def slope(self, x: Floats) -> Floats:
        """Derivatives (2n + p, p) of `residual`."""
        return self(x)[1]

    def whole(self, x: Floats) -> Floats:
        """All parameters (13,) or (20,) from the fitted ones."""
        return x if self.pair.moving else np.concatenate([x, np.zeros(len(TARGET))])

    def _free(self, full: Floats) -> Floats:
        return np.asarray(release(full, self.pair.spin), dtype=np.float64) if self.tied else full

    def _evaluate(self, x: Floats) -> tuple[Floats, Floats]:
        full = self.whole(x)
        free = self._free(full)
        inner = release_slope(full, self.pair.spin) if self.tied else None
        residuals, rows = [], []
        for ball, course in self.pair.balls:
            place, slope = path(free, ball, course.start, course.exposure, self.pair.diameter)
            if inner is not None:
                slope = slope @ inner
            residuals.append(course.whiten(place - course.place))
            rows.append(course.whiten(slope[:, :, : len(x)]))
        residual = np.concatenate([*residuals, (x - self.prior) * self.prior_weight])
        slopes = np.concatenate([*rows, np.diag(self.prior_weight)])
        return np.clip(np.nan_to_num(residual, nan=1e9), -1e9, 1e9), np.nan_to_num(slopes)

    def distances(self, x: Floats) -> Floats:
        """Squared Mahalanobis distance (n,) of each place by itself, ball 1's first."""
        free = self._free(self.whole(x))
        parts = []
        for ball, course in self.pair.balls:
            place = path(free, ball, course.start, course.exposure, self.pair.diameter)[0]
            parts.append(course.whiten.distance(place - course.place))
        return np.concatenate(parts)


class Problem(Protocol):
    """What can be fitted: weighted residuals (m,) and their derivatives (m, p)."""

    def residual(self, x: Floats) -> Floats: ...
    def slope(self, x: Floats) -> Floats: ...


def fit(problem: Problem, starts: Iterable[Floats]) -> tuple[Floats, bool]:
    """The best of several descents: parameters, and whether that descent converged."""
    best, cost, converged = None, np.inf, False
    for start in starts:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a long step may overflow
            found = least_squares(
                problem.residual, start, jac=problem.slope, method="lm", x_scale="jac",
                xtol=1e-10, ftol=1e-10, gtol=1e-10, max_nfev=100,
            )  # fmt: skip
        if found.cost < cost:
            best, cost, converged = np.asarray(found.x, dtype=np.float64), found.cost, bool(found.success)
    assert best is not None
    return best, converged


def fit_motion(pair: Pair, tied: bool, starts: list[Floats]) -> Fit:
    """Tied (13) or free (20) motion of two balls, from starts of that length; a few outliers are dropped once."""
    problem = Whitened(pair, tied)
    p = len(problem.names)
    best, converged = fit(problem, [start[:p] for start in starts])
    problem, dropped = _without_outliers(problem, best)
    if dropped:
        best, converged = fit(problem, [best])
    best, converged = _across_frame_edges(problem, best, converged)
    residual, rows = problem(best)
    n = 2 * len(problem.pair)
    cov, chi2, dof = covariance(rows), float(residual[:n] @ residual[:n]), n - p
    whole = problem.whole(best)
    full = np.zeros((len(whole), len(whole)))
    full[:p, :p] = cov
    return Fit(whole, full, chi2, dof, dropped, converged)


def covariance(rows: Floats) -> Floats:
    """(J^T J)^-1, columns scaled first: the parameters' units differ by many powers of ten."""
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0] = 1e-30
    inverse = np.linalg.pinv((rows / scale).T @ (rows / scale), rcond=1e-15, hermitian=True)
    return np.asarray(inverse / np.outer(scale, scale))


def _across_frame_edges(problem: Whitened, best: Floats, converged: bool) -> tuple[Floats, bool]:
    """chi^2 has a kink where t_c crosses an exposure: look at the other side when one is near."""
    struck = problem.pair.struck
    residual, rows = problem(best)
    reach = max(8 * float(np.sqrt(covariance(rows)[0, 0])), 1e-6)
    edges = np.concatenate([struck.start, struck.start + struck.exposure])
    near = edges[np.abs(edges - best[0]) < reach]
    if not len(near):
        return best, converged
    other = best.copy()
    other[0] = 2 * near[0] - best[0]
    found, fine = fit(problem, [other])
    better = problem(found)[0]
    return (found, fine) if better @ better < residual @ residual else (best, converged)


def _without_outliers(problem: Whitened, best: Floats) -> tuple[Whitened, int]:
    distance = problem.distances(best)
    far = distance > OUTLIER
    if not far.any() or far.sum() > OUTLIER_SHARE * len(far):
        return problem, 0
    cut, pair = len(problem.pair.struck), problem.pair
    kept = replace(pair, struck=pair.struck.where(~far[:cut]), striker=pair.striker.where(~far[cut:]))
    return Whitened(kept, problem.tied), int(far.sum())
