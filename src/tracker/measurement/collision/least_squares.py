"""Weighted least squares for motions: best parameters, their Fisher covariance, how well they fit.

A clip that hardly shows the free quantities would make the normal equations singular. A prior far wider than any
physics keeps them regular. A quantity that only the prior determines has a standard error as wide as the prior, and is
then not reported.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from scipy.optimize import leastsq

from synthcam_shared.arrays import Array
from tracker.measurement.collision.collision_model import (
    FREE,
    SLIDING,
    SPIN,
    TARGET,
    TIED,
    mean_positions,
    tied_to_free,
    tied_to_free_jacobian,
)
from tracker.measurement.positions import BallTrack
from tracker.settings import FitSettings

FINE_TOLERANCE = 1e-10  # relative change of parameters and chi^2 that ends a descent
# the same where it is enough to compare minima; a descent that needs over 30 steps is then given up
ROUGH_TOLERANCE = 1e-4

# name: (centre, width). Wide enough to weigh nothing against data, stated here and nowhere else.
BROAD_PRIORS: Mapping[str, tuple[float, float]] = {
    "drag": (0.0, 20.0),
    "decel": (0.0, 2.0),
    "r": (0.5, 5.0),
    "C": (0.0, 5.0),
    "log_mu": (float(np.log(0.2)), 4.0),
    "log_tau1": (float(np.log(0.03)), 4.0),
    "log_tau2": (float(np.log(0.03)), 4.0),
    **dict.fromkeys(("v1x", "v1y", "f1x", "f1y", "v2x", "v2y", "f2x", "f2y", *SPIN), (0.0, 10.0)),
    **dict.fromkeys(SLIDING, (0.0, 100.0)),
}


@dataclass(frozen=True, eq=False)
class BallPair:
    """Two balls about one contact: their positions, and what is known in advance."""

    struck: BallTrack  # ball 1
    striker: BallTrack  # ball 2
    diameter: float  # m
    target_moves: bool = False  # whether ball 1 moves before the hit
    spin: float = 0.0  # m/s; see `tied_to_free`
    fitted_spin: tuple[str, ...] = ()  # names of SPIN that are fitted; the others are zero, as if the striker rolled
    settings: FitSettings = field(default_factory=FitSettings)

    @property
    def striker_slides(self) -> bool:
        """True if the striker slides up to the contact."""
        return "ux" in self.fitted_spin

    @property
    def zero_parameters(self) -> set[str]:
        """Parameters of TIED and FREE that are zero."""
        fitted = {*self.fitted_spin, *(TARGET * self.target_moves), *(SLIDING * self.striker_slides)}
        return {*TARGET, *SPIN, *SLIDING} - fitted

    @property
    def balls(self) -> tuple[tuple[int, BallTrack], tuple[int, BallTrack]]:
        """(1, struck), (2, striker)."""
        return (1, self.struck), (2, self.striker)

    def __len__(self) -> int:
        return len(self.struck) + len(self.striker)


class Evaluation(NamedTuple):
    """A motion at one x."""

    position: Array  # (n, 2) m, of both balls, ball 1's first
    residual: Array  # (2n + p,) of the positions, then of the priors
    slope: Array  # (2n + p, p) its derivatives


class PairResiduals(ABC):
    """Residuals of two balls' positions from a motion, in units of their errors, and derivatives.

    x holds the fitted parameters: those of `every` that are not held at zero.
    """

    prior: Array  # (p,) centres of the parameters' priors
    prior_weight: Array

    def __init__(self, pair: BallPair, every: tuple[str, ...], held: Collection[str]) -> None:
        self.pair, self.size = pair, len(every)
        self.names = tuple(name for name in every if name not in held)
        self.index = np.array([every.index(name) for name in self.names])
        self._evaluated: dict[bytes, Evaluation] = {}  # of the last x, oldest first
        tracks = [track for _, track in pair.balls]
        self.ball = np.repeat([1, 2], [len(track) for track in tracks])
        self.start = np.concatenate([track.start for track in tracks])
        self.seen = np.concatenate([track.position for track in tracks])

    @abstractmethod
    def displace(self, x: Array) -> tuple[Array, Array]:
        """Positions (n, 2) of both balls, ball 1's first, and derivatives (p, n, 2)."""

    def __call__(self, x: Array) -> tuple[Array, Array]:
        """Residuals (2n + p,) and derivatives (2n + p, p), priors last."""
        found = self.evaluate(x)
        return found.residual, found.slope

    def evaluate(self, x: Array) -> Evaluation:
        """Evaluate the motion at x. The last two are kept: a descent that rejects its last step returns that before."""
        key = x.tobytes()
        if key not in self._evaluated:
            with np.errstate(all="ignore"):  # a long step may overflow
                position, slopes = self.displace(x)
                white = self.whiten(np.concatenate([(position - self.seen)[None], slopes]))
                residual = np.concatenate([white[0], (x - self.prior) * self.prior_weight])
                columns = np.concatenate([white[1:], np.diag(self.prior_weight)], axis=1)
                if not (np.isfinite(residual).all() and np.isfinite(columns).all()):
                    residual, columns = np.nan_to_num(residual, nan=1e9), np.nan_to_num(columns)
                if len(self._evaluated) > 1:
                    del self._evaluated[next(iter(self._evaluated))]
                self._evaluated[key] = Evaluation(position, np.clip(residual, -1e9, 1e9), columns.T)
        return self._evaluated[key]

    def residual(self, x: Array) -> Array:
        """Whitened residuals (2n + p,), priors last."""
        return self(x)[0]

    def slope(self, x: Array) -> Array:
        """Derivatives (2n + p, p) of `residual`."""
        return self(x)[1]

    def whole(self, x: Array) -> Array:
        """All parameters from the fitted ones (p,)."""
        out = np.zeros(self.size)
        out[self.index] = x
        return out

    def whole_cov(self, cov: Array) -> Array:
        """Covariance of all parameters from that of the fitted ones (p, p): zero where one is held."""
        out = np.zeros((self.size, self.size))
        out[np.ix_(self.index, self.index)] = cov
        return out

    def whiten(self, rows: Array) -> Array:
        """Shifts (k, n, 2) of the positions, ball 1's first, in units of their errors, (k, 2n)."""
        cut = len(self.pair.struck)
        return np.concatenate([self.pair.struck.whiten(rows[:, :cut]), self.pair.striker.whiten(rows[:, cut:])], axis=1)


class WhitenedResiduals(PairResiduals):
    """Residuals from a tied or a free motion: the fitted parameters are those that the pair does not hold at zero."""

    def __init__(self, pair: BallPair, tied: bool) -> None:
        super().__init__(pair, TIED if tied else FREE, pair.zero_parameters)
        self.tied = tied
        centres = np.array([BROAD_PRIORS.get(name, (0.0, np.inf)) for name in self.names])
        self.prior, self.prior_weight = centres[:, 0], 1.0 / centres[:, 1]

    def displace(self, x: Array) -> tuple[Array, Array]:
        full = self.whole(x)
        position, slope = self._path(full)
        slopes = slope.transpose(2, 0, 1)
        if not self.tied:
            return position, slopes[self.index]
        by = tied_to_free_jacobian(full, self.pair.spin)[:, self.index]
        return position, (by.T @ slopes.reshape(len(slopes), -1)).reshape(-1, *position.shape)

    def _path(self, full: Array) -> tuple[Array, Array]:
        """Positions (n, 2) of both balls, ball 1's first, and derivatives (n, 2, 22) by the free parameters."""
        free = np.asarray(tied_to_free(full, self.pair.spin), dtype=np.float64) if self.tied else full
        with np.errstate(over="ignore", invalid="ignore"):  # a slide without end
            return mean_positions(free, self.ball, self.start, self.pair.struck.exposure, self.pair.diameter)

    def distances(self, x: Array) -> Array:
        """Squared Mahalanobis distance (n,) of each position by itself, ball 1's first."""
        off, cut = self.evaluate(x).position - self.seen, len(self.pair.struck)
        one, two = self.pair.struck.whiten, self.pair.striker.whiten
        return np.concatenate([one.distance(off[:cut]), two.distance(off[cut:])])


@dataclass(frozen=True)
class CollisionFit:
    """Best parameters of one motion, and how well it fits."""

    parameters: Array  # (16,) of a tied fit, or (22,) of a free one
    cov: Array  # zero for parameters that are held at zero
    chi2: float  # of the data alone, without the prior
    dof: int
    pair: BallPair  # without the positions that were dropped as outliers
    dropped: int = 0  # number of those positions
    converged: bool = True

    @property
    def is_tied(self) -> bool:
        """True if restitution, friction and spin transfer determine the motion after the hit."""
        return len(self.parameters) == len(TIED)

    @cached_property
    def linearised(self) -> tuple[WhitenedResiduals, Array, Array, Array]:
        """The problem of the fit with residuals, derivatives and covariance of the fitted parameters at its minimum."""
        problem = WhitenedResiduals(self.pair, self.is_tied)
        fitted = problem.index
        return problem, *problem(self.parameters[fitted]), self.cov[np.ix_(fitted, fitted)]


class LeastSquaresProblem(Protocol):
    """A least-squares problem: weighted residuals (m,) and their derivatives (m, p)."""

    def residual(self, x: Array) -> Array: ...
    def slope(self, x: Array) -> Array: ...


def find_best_minimum(
    problem: LeastSquaresProblem, starts: Sequence[Array], tolerance: float = FINE_TOLERANCE
) -> tuple[Array, bool]:
    """Find the best of several minima by Levenberg-Marquardt (MINPACK), and whether that descent converged.

    A relative change of parameters and chi^2 by `tolerance` ends a descent. The descents from all starts but the first
    are rough until one finds another, better minimum.
    """
    least_gain = 1e-3  # gain in half the chi^2 from which on another start has found another, better minimum
    best, cost, converged = _descend(problem, starts[0], tolerance)
    for start in starts[1:]:
        found, better, fine = _descend(problem, start, ROUGH_TOLERANCE)
        if better < cost - least_gain and tolerance < ROUGH_TOLERANCE:
            found, better, fine = _descend(problem, found, tolerance)
        if better < cost - least_gain:
            best, cost, converged = found, better, fine
    return best, converged


def _descend(problem: LeastSquaresProblem, start: Array, tolerance: float) -> tuple[Array, float, bool]:
    """Parameters, half their chi^2, whether a relative step or gain under `tolerance` ended the descent."""
    x, _, found, _, ended = leastsq(
        problem.residual, start, Dfun=lambda x: problem.slope(x).T, col_deriv=True, full_output=True, xtol=tolerance,
        ftol=tolerance, gtol=1e-10, maxfev=100 if tolerance < ROUGH_TOLERANCE else 30,
    )  # fmt: skip
    return np.asarray(x, dtype=np.float64), float(found["fvec"] @ found["fvec"]) / 2, ended in (1, 2, 3, 4)


def fit_motion(
    pair: BallPair, tied: bool, starts: list[Array], tolerance: float = FINE_TOLERANCE, whole: bool = False
) -> CollisionFit:
    """Fit a tied or free motion by least squares, from starts (16,) or (22,). A few outliers are dropped once.

    tolerance: as for `find_best_minimum`; whole: keep the outliers.
    """
    problem = WhitenedResiduals(pair, tied)
    best, converged = find_best_minimum(problem, [start[problem.index] for start in starts], tolerance)
    far = problem.distances(best) > pair.settings.outlier_sigma**2
    dropped = 0 if whole or far.sum() > pair.settings.max_outlier_share * len(far) else int(far.sum())
    if dropped:
        cut = len(pair.struck)
        pair = replace(pair, struck=pair.struck.where(~far[:cut]), striker=pair.striker.where(~far[cut:]))
        problem = WhitenedResiduals(pair, tied)
        best, converged = find_best_minimum(problem, [best], tolerance)
    best, converged = _try_across_frame_edge(problem, best, converged, tolerance)
    residual, rows = problem(best)
    n = 2 * len(pair)
    cov, chi2, dof = problem.whole_cov(covariance(rows)), float(residual[:n] @ residual[:n]), n - len(best)
    return CollisionFit(problem.whole(best), cov, chi2, dof, pair, dropped, converged)


def covariance(rows: Array) -> Array:
    """Compute the covariance (J^T J)^-1 of a least-squares fit, columns scaled first: units differ by powers of ten."""
    size = np.linalg.norm(rows, axis=0)
    size[size == 0] = 1e-30
    inverse = np.linalg.pinv((rows / size).T @ (rows / size), rcond=1e-15, hermitian=True)
    return np.asarray(inverse / np.outer(size, size))


def _try_across_frame_edge(
    problem: WhitenedResiduals, best: Array, converged: bool, tolerance: float
) -> tuple[Array, bool]:
    """chi^2 has a kink where t_c crosses an exposure: try the other side when one is near."""
    struck = problem.pair.struck
    residual, rows = problem(best)
    worse = max(1.0, float(residual @ residual) / len(residual))
    reach = max(8 * float(np.sqrt(covariance(rows)[0, 0] * worse)), 1e-6)
    edges = np.concatenate([struck.start, struck.start + struck.exposure])
    near = edges[np.abs(edges - best[0]) < reach]
    if not len(near):
        return best, converged
    other = best.copy()
    other[0] = 2 * near[0] - best[0]
    least = float(residual @ residual)
    found, half, fine = _descend(problem, other, ROUGH_TOLERANCE)
    if 2 * half < (1 + 10 * ROUGH_TOLERANCE) * least and tolerance < ROUGH_TOLERANCE:
        found, half, fine = _descend(problem, found, tolerance)
    return (found, fine) if 2 * half < least else (best, converged)
