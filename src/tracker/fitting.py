"""Weighted least squares for motions: best parameters, their Fisher covariance, how well they fit.

The free quantities of a clip that hardly shows them would leave the normal equations singular. A broad prior,
far wider than any physics, keeps them regular; what it decides comes out with a standard error as wide as
itself, and is then not claimed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from .motion import FREE, TIED, path, release, release_slope
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
    """Best parameters (p,), covariance (p, p), chi^2 of the data alone, degrees of freedom.

    residuals: (n, 2) whitened, ball 1's rows then ball 2's; dropped: places left out as outliers.
    """

    parameters: Floats
    cov: Floats
    chi2: float
    dof: int
    residuals: Floats
    dropped: int = 0
    converged: bool = True


class Whitened:
    """The two balls' places, in units of their own error, against a motion: residuals and derivatives."""

    def __init__(self, struck: Course, striker: Course, diameter: float, tied: bool) -> None:
        self.balls = ((1, struck), (2, striker))
        self.diameter = diameter
        self.names = TIED if tied else FREE
        self.tied = tied
        self.weight = np.concatenate([whitener(course.cov) for _, course in self.balls])
        self.place = np.concatenate([course.place for _, course in self.balls])
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

    def _evaluate(self, x: Floats) -> tuple[Floats, Floats]:
        free = np.asarray(release(x), dtype=np.float64) if self.tied else x
        exposure = self.balls[0][1].exposure
        parts = [path(free, ball, course.start, exposure, self.diameter) for ball, course in self.balls]
        place, slope = (np.concatenate([p[i] for p in parts]) for i in (0, 1))
        if self.tied:
            slope = slope @ release_slope(x)
        residual = np.matmul(self.weight, (place - self.place)[..., None])[..., 0].ravel()
        rows = np.matmul(self.weight, slope).reshape(len(residual), len(x))
        residual = np.concatenate([residual, (x - self.prior) * self.prior_weight])
        rows = np.concatenate([rows, np.diag(self.prior_weight)])
        return np.clip(np.nan_to_num(residual, nan=1e9), -1e9, 1e9), np.nan_to_num(rows)


def whitener(cov: Floats) -> Floats:
    """Matrices W (n, 2, 2) with W^T W = cov^-1."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(cov)))


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


def fit_motion(struck: Course, striker: Course, diameter: float, tied: bool, starts: list[Floats]) -> Fit:
    """Tied (11) or free (18) motion of two balls; outliers are dropped once, if they are few."""
    problem = Whitened(struck, striker, diameter, tied)
    best, converged = fit(problem, starts)
    problem, dropped = _without_outliers(problem, best)
    if dropped:
        best, converged = fit(problem, [best])
    best, converged = _across_frame_edges(problem, best, converged)
    residual, rows = problem(best)
    n = len(problem.place) * 2
    cov, chi2, dof = covariance(rows), float(residual[:n] @ residual[:n]), n - len(best)
    if not struck.weighed:
        cov = cov * chi2 / max(dof, 1)
    return Fit(best, cov, chi2, dof, residual[:n].reshape(-1, 2), dropped, converged)


def covariance(rows: Floats) -> Floats:
    """(J^T J)^-1, columns scaled first: the parameters' units differ by many powers of ten."""
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0] = 1e-30
    inverse = np.linalg.pinv((rows / scale).T @ (rows / scale), rcond=1e-15, hermitian=True)
    return np.asarray(inverse / np.outer(scale, scale))


def _across_frame_edges(problem: Whitened, best: Floats, converged: bool) -> tuple[Floats, bool]:
    """chi^2 has a kink where t_c crosses an exposure: look at the other side when one is near."""
    struck = problem.balls[0][1]
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
    n = len(problem.place)
    distance = (problem(best)[0][: 2 * n].reshape(n, 2) ** 2).sum(axis=1)
    (_, struck), (_, striker) = problem.balls
    if not struck.weighed:  # the scale of the errors is not known: take the places' own
        distance = distance / max(float(np.median(distance)) / 1.39, 1e-12)
    far = distance > OUTLIER
    if not far.any() or far.sum() > OUTLIER_SHARE * n:
        return problem, 0
    near = ~far
    cut = len(struck)
    kept = struck.where(near[:cut]), striker.where(near[cut:])
    return Whitened(*kept, problem.diameter, problem.tied), int(far.sum())
