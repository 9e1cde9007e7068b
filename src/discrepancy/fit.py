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

from discrepancy.measured import Measured
from discrepancy.noise import Noise
from synthcam.dynamics import solve
from synthcam.effect import library
from synthcam.launch import Launch
from synthcam.model import Model

Array = NDArray[np.float64]

LAUNCH = ("x", "y", "t_c", "v0", "heading", "b")  # the contact's place, m; s; m/s; rad; over the diameter
LAUNCH_STEP = np.array([1e-6, 1e-6, 1e-6, 1e-5, 1e-5, 1e-5])
BASE_STEP = {
    "restitution": 1e-5,
    "sliding_friction": 1e-5,
    "spin_transfer": 1e-5,
    "rolling_drag": 1e-4,
    "rolling_decel": 1e-5,
}
BASE = tuple(BASE_STEP)
ITERATIONS = 25
SETTLED = 1e-3  # of chi^2


def predict(model: Model, launch: Array, clip: Measured) -> Array:
    """Centres averaged over each exposure, where the clip has measurements: (n, 2), m."""
    start = Launch.pair(model.ball.radius, launch[2], launch[3], launch[5], launch[4], launch[:2])
    opens = clip.frame / clip.fps
    first, last = min(float(opens.min()), launch[2]), float(opens.max()) + clip.exposure
    motion = solve(model, start, first, last)
    frames, where = np.unique(clip.frame, return_inverse=True)
    spans = np.stack([frames / clip.fps, frames / clip.fps + clip.exposure], axis=1)
    return motion.mean(spans, lambda states: states[..., :2])[clip.ball, where]


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
    return (0.0, 1.0) if name in ("restitution", "spin_transfer") else (0.0, np.inf)


def derivative(model: Model, launch: Array, clip: Measured, name: str) -> Array:
    """d prediction / d a shared parameter, (n, 2): central, one-sided at a limit.

    A limit may also be where the motion ends to exist, as when a tilt sets the resting ball rolling; zero when there is
    none to either side.
    """
    value, step, (low, high) = model.value(name), step_of(name), limits_of(name)
    ends = []
    for end in (min(value + step, high), max(value - step, low)):
        try:
            ends.append((end, predict(model.replace({name: end}), launch, clip)))
        except ValueError:
            ends.append((value, predict(model, launch, clip)))
    (up, ahead), (down, behind) = ends
    return (ahead - behind) / (up - down) if up > down else np.zeros_like(ahead)


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
    total = 0.0
    for clip, launch, white in zip(clips, launches, whiteners, strict=True):
        if not (abs(launch[5]) < 1 and launch[3] > 0):
            return np.inf
        try:
            left = white(clip.xy - predict(model, launch, clip))
        except ValueError:
            return np.inf
        total += float(left @ left)
    return total


def _linearise(
    clips: Sequence[Measured], model: Model, names: tuple[str, ...], launches: Array, whiteners: Sequence[Whitener]
) -> Fit:
    residuals, slopes, launch_slopes = [], [], []
    for clip, launch, white in zip(clips, launches, whiteners, strict=True):
        residuals.append(white(clip.xy - predict(model, launch, clip)))
        own = []
        for k, step in enumerate(LAUNCH_STEP):
            nudge = np.zeros(6)
            nudge[k] = step
            own.append((predict(model, launch + nudge, clip) - predict(model, launch - nudge, clip)) / (2 * step))
        launch_slopes.append(white(np.stack(own, axis=-1)))
        shared = [derivative(model, launch, clip, name) for name in names]
        slopes.append(white(np.stack(shared, axis=-1)) if names else np.zeros((2 * len(clip.frame), 0)))
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
