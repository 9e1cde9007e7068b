"""One model, all clips: shared physics and each clip's own launch, by Gauss-Newton on whitened residuals.

The normal equations have an arrow's shape: the launches are eliminated clip by clip (variable projection), so the cost
grows linearly with the number of clips.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from discrepancy.forecast import forecast
from discrepancy.measured import Measured
from discrepancy.noise import Noise
from synthcam.effect import library
from synthcam.model import Model

Array = NDArray[np.float64]

LAUNCH_STEP = np.array([1e-6, 1e-6, 1e-6, 1e-5, 1e-5, 1e-5])
BASE_STEP = {
    "restitution": 1e-5,
    "sliding_friction": 1e-5,
    "spin_transfer": 1e-5,
    "rolling_drag": 1e-4,
    "rolling_decel": 1e-5,
}
BASE = tuple(BASE_STEP)
_LIMITS = {"restitution": (0.0, 1.0), "spin_transfer": (0.0, 5 / 7)}
ITERATIONS = 25
SETTLED = 1e-3  # of chi^2


@dataclass(frozen=True)
class Whitener:
    """Turns residuals of one clip into numbers that noise alone would draw from N(0, 1)."""

    roots: Array  # (n, 2, 2): inverse Cholesky factors of the claimed covariances
    filter: Array  # (n, n)

    @classmethod
    def of(cls, clip: Measured, noise: Noise) -> Whitener:
        return cls(np.linalg.inv(np.linalg.cholesky(clip.covariance)), noise.filter(clip.frame, clip.ball))

    def __call__(self, residuals: Array) -> Array:
        """(n, 2, ...) -> (2 n, ...)"""
        scaled = np.einsum("nij,nj...->ni...", self.roots, residuals)
        white = np.tensordot(self.filter, scaled, axes=1)
        return np.asarray(white.reshape(-1, *residuals.shape[2:]))


@dataclass(frozen=True)
class Fit:
    """A fitted model. For each clip: its launch (6,), whitened residuals (2n,), and their derivatives.

    names: the shared parameters fitted, covariance (S, S) theirs. slopes[k]: (2n, S); launch_slopes[k]: (2n, 6).
    """

    model: Model
    names: tuple[str, ...]
    launches: Array
    residuals: tuple[Array, ...]
    slopes: tuple[Array, ...]
    launch_slopes: tuple[Array, ...]
    covariance: Array

    @property
    def chi2(self) -> float:
        return float(sum(r @ r for r in self.residuals))

    @property
    def points(self) -> int:
        """Measured coordinates."""
        return sum(len(r) for r in self.residuals)

    @property
    def parameters(self) -> int:
        return len(self.names) + self.launches.size

    def projected(self, columns: Sequence[Array]) -> Array:
        """Columns (2n, k) of every clip with all that the fit can absorb taken out, stacked: (points, k)."""
        cleaned = [_off(launch, c) for launch, c in zip(self.launch_slopes, columns, strict=True)]
        stacked = np.concatenate(cleaned)
        if not self.names:
            return stacked
        shared = np.concatenate([_off(a, s) for a, s in zip(self.launch_slopes, self.slopes, strict=True)])
        return _off(shared, stacked)


def _off(basis: Array, columns: Array) -> Array:
    """Columns less their projection on the span of a basis."""
    scale = np.linalg.norm(basis, axis=0)
    q, _ = np.linalg.qr(basis / np.where(scale > 0, scale, 1))
    return np.asarray(columns - q @ (q.T @ columns))


def step_of(name: str) -> float:
    """A step for the numerical derivative by a shared parameter."""
    effect, dot, parameter = name.rpartition(".")
    if not dot:
        return BASE_STEP[name]
    return 1e-2 * next(p.scale for p in library()[effect].parameters() if p.name == parameter)


def limits_of(name: str) -> tuple[float, float]:
    """What values a shared parameter may have."""
    effect, dot, parameter = name.rpartition(".")
    if dot:
        return next((p.low, p.high) for p in library()[effect].parameters() if p.name == parameter)
    return _LIMITS.get(name, (0.0, np.inf))


def derivative(model: Model, launches: Array, clips: Sequence[Measured], name: str) -> list[Array]:
    """d forecast / d a shared parameter, (n_k, 2) each: central, one-sided at a limit.

    A limit may also be where the motion ends to exist, as when a tilt sets the resting ball rolling; zero when there is
    none to either side.
    """
    value, step, (low, high) = model.value(name), step_of(name), limits_of(name)
    ends = []
    for end in (min(value + step, high), max(value - step, low)):
        try:
            ends.append((end, forecast(model.replace({name: end}), launches, clips)))
        except ValueError:
            ends.append((value, forecast(model, launches, clips)))
    (up, ahead), (down, behind) = ends
    return [(a - b) / (up - down) if up > down else 0 * a for a, b in zip(ahead, behind, strict=True)]


def launch_derivatives(model: Model, launches: Array, clips: Sequence[Measured]) -> tuple[list[Array], list[Array]]:
    """The forecast (n_k, 2) and its derivatives (n_k, 2, 6) by each clip's own launch, all in one batch."""
    k = len(clips)
    nudges = np.concatenate([np.zeros((1, 6)), np.diag(LAUNCH_STEP), -np.diag(LAUNCH_STEP)])
    many = (launches[None] + nudges[:, None]).reshape(-1, 6)
    all_ = forecast(model, many, list(clips) * len(nudges))
    slopes = [
        np.stack([(all_[(1 + j) * k + i] - all_[(7 + j) * k + i]) / (2 * LAUNCH_STEP[j]) for j in range(6)], axis=-1)
        for i in range(k)
    ]
    return all_[:k], slopes


def fit(
    clips: Sequence[Measured],
    model: Model,
    names: Sequence[str],
    noise: Noise,
    launches: Array | None = None,
    tick: Callable[[], None] = lambda: None,
) -> Fit:
    """Fit the shared parameters `names` and every launch. With no names only the launches are fitted.

    launches: (clips, 6) to start from; default: the clips' own first guesses. Levenberg's damping when a step fails.
    """
    names = tuple(names)
    places = np.array([c.launch for c in clips] if launches is None else launches, dtype=float)
    whiteners = [Whitener.of(c, noise) for c in clips]
    now = _linearise(clips, model, names, places, whiteners)
    damping = 0.0
    for _ in range(ITERATIONS):
        tick()
        shared, own = _solve(now, damping)
        values = {n: float(np.clip(model.value(n) + d, *limits_of(n))) for n, d in zip(names, shared, strict=True)}
        trial, moved = model.replace(values), now.launches + own
        chi2 = _chi2(clips, trial, moved, whiteners)
        if not chi2 <= now.chi2 * (1 + 1e-12):
            damping = max(10 * damping, 1e-3)
            if damping > 1e6:
                break
            continue
        gained, damping, model = now.chi2 - chi2, damping / 10 if damping > 1e-4 else 0.0, trial
        now = _linearise(clips, model, names, moved, whiteners)
        if gained < SETTLED:
            break
    return now


def _chi2(clips: Sequence[Measured], model: Model, launches: Array, whiteners: Sequence[Whitener]) -> float:
    """chi^2, or infinity where the model has no motion for such a launch."""
    if not (np.all(np.abs(launches[:, 5]) < 1) and np.all(launches[:, 3] > 0)):
        return np.inf
    try:
        expected = forecast(model, launches, clips)
    except ValueError:
        return np.inf
    left = [white(clip.xy - e) for clip, e, white in zip(clips, expected, whiteners, strict=True)]
    return float(sum(x @ x for x in left))


def _linearise(
    clips: Sequence[Measured], model: Model, names: tuple[str, ...], launches: Array, whiteners: Sequence[Whitener]
) -> Fit:
    expected, own = launch_derivatives(model, launches, clips)
    shared = [derivative(model, launches, clips, name) for name in names]
    residuals, slopes, launch_slopes = [], [], []
    for k, (clip, white) in enumerate(zip(clips, whiteners, strict=True)):
        residuals.append(white(clip.xy - expected[k]))
        launch_slopes.append(white(own[k]))
        columns = [s[k] for s in shared]
        slopes.append(white(np.stack(columns, axis=-1)) if names else np.zeros((2 * len(clip.frame), 0)))
    result = Fit(
        model, names, launches, tuple(residuals), tuple(slopes), tuple(launch_slopes), np.zeros((len(names),) * 2)
    )
    if not names:
        return result
    cleaned = np.concatenate([_off(a, s) for a, s in zip(result.launch_slopes, result.slopes, strict=True)])
    return dataclasses.replace(result, covariance=np.linalg.pinv(cleaned.T @ cleaned, hermitian=True))


def _solve(now: Fit, damping: float) -> tuple[Array, Array]:
    """The Gauss-Newton step: shared (S,), launches (clips, 6)."""
    size = len(now.names)
    matrix, right, blocks = np.zeros((size, size)), np.zeros(size), []
    for r, s, a in zip(now.residuals, now.slopes, now.launch_slopes, strict=True):
        own = a.T @ a
        own[np.diag_indices(6)] *= 1 + damping
        coupling, pull = a.T @ s, a.T @ r
        solved = np.linalg.solve(own, np.column_stack([coupling, pull]))
        blocks.append(solved)
        matrix += s.T @ s - coupling.T @ solved[:, :-1]
        right += s.T @ r - coupling.T @ solved[:, -1]
    matrix[np.diag_indices(size)] *= 1 + damping
    shared = np.linalg.lstsq(matrix, right, rcond=1e-14)[0] if size else np.zeros(0)
    own_steps = np.array([b[:, -1] - b[:, :-1] @ shared for b in blocks])
    return np.asarray(shared), own_steps
