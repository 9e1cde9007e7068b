"""A fitted model: whitened clips, residuals, derivatives, and the directions that the derivatives absorb."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.parameters import parameter_limits
from discrepancy.fitting.predict import predict_tracks
from discrepancy.noise.model import Noise
from discrepancy.noise.whitening import ClipWhitener
from synthcam.model import Model
from synthcam_shared.arrays import Array


@dataclass(frozen=True)
class WhitenedClips:
    """Measured clips, with a whitener for the noise of each."""

    clips: tuple[MeasuredCollision, ...]
    whiteners: tuple[ClipWhitener, ...]

    @classmethod
    def of(cls, clips: Sequence[MeasuredCollision], noise: Noise) -> WhitenedClips:
        return cls(tuple(clips), tuple(ClipWhitener.of(c, noise) for c in clips))

    def whiten(self, columns: Sequence[Array]) -> tuple[Array, ...]:
        """Displacements of each clip, (n, 2, ...), m, as uncorrelated numbers in units of the noise, (2n, ...)."""
        return tuple(white(c) for white, c in zip(self.whiteners, columns, strict=True))

    def whitened_residuals(self, model: Model, launches: Array) -> tuple[Array, ...]:
        """Whitened residuals (2n,) of each clip. Raises ValueError if the model has no motion for a launch."""
        expected = predict_tracks(model, launches, self.clips)
        return self.whiten([c.xy - e for c, e in zip(self.clips, expected, strict=True)])


@dataclass(frozen=True)
class Linearisation:
    """Whitened derivatives of each clip's predicted track, taken at this model and these launches."""

    model: Model
    names: tuple[str, ...]  # the shared parameters
    launches: Array  # (clips, p)
    slopes: tuple[Array, ...]  # (2n, S): by the shared parameters
    launch_slopes: tuple[Array, ...]  # (2n, p): by the clip's own launch

    @cached_property
    def launch_bases(self) -> tuple[Array, ...]:
        """Orthonormal bases of each clip's derivatives by its launch, (2n, p)."""
        return tuple(orthonormal_basis(a) for a in self.launch_slopes)

    @cached_property
    def profiled_slopes(self) -> tuple[Array, ...]:
        """Derivatives by the shared parameters, projected off those by the launch, (2n, S) for each clip."""
        return tuple(s - q @ (q.T @ s) for q, s in zip(self.launch_bases, self.slopes, strict=True))

    @cached_property
    def parameter_bases(self) -> list[Array]:
        """The rows of each clip, (2n, s), of an orthonormal basis of `profiled_slopes`."""
        ends = np.cumsum([len(s) for s in self.slopes])
        return np.split(orthonormal_basis(np.concatenate(self.profiled_slopes)), ends[:-1])


@dataclass(frozen=True)
class ModelFit:
    """A fitted model."""

    model: Model
    names: tuple[str, ...]  # the shared parameters fitted
    launches: Array  # (clips, p), columns as in `discrepancy.data.launch`
    residuals: tuple[Array, ...]  # (2n,) of each clip, whitened
    linearisation: Linearisation  # the derivatives that it was found with

    @property
    def slopes(self) -> tuple[Array, ...]:
        """Whitened derivatives by the shared parameters, (2n, S) for each clip."""
        return self.linearisation.slopes

    @property
    def launch_slopes(self) -> tuple[Array, ...]:
        """Whitened derivatives by the clip's own launch, (2n, p) for each clip."""
        return self.linearisation.launch_slopes

    @property
    def is_linearised_here(self) -> bool:
        """True if the derivatives were taken at this fit's values, by all its parameters."""
        there = self.linearisation
        same = there.names == self.names and there.model == self.model
        return same and np.array_equal(there.launches, self.launches)

    def values(self, names: Sequence[str] | None = None) -> Array:
        """Values of these shared parameters, or of all fitted ones."""
        return np.array([self.model.value(n) for n in (self.names if names is None else names)])

    def columns_of(self, names: Sequence[str]) -> list[int]:
        """Indices of these shared parameters among the fitted ones."""
        return [self.names.index(n) for n in names]

    def step_bounds(self) -> tuple[Array, Array]:
        """Bounds (S,) and (S,) of a step: the distances of the shared parameters from their limits.

        The sliding friction keeps its half or more. Without any, no ball slides, and no later step brings it back.
        """
        values = self.values()
        low, high = np.array([parameter_limits(self.model, n) for n in self.names]).reshape(-1, 2).T
        keeps = np.array([name == "sliding_friction" for name in self.names], dtype=bool)
        return np.where(keeps, np.maximum(low, values / 2), low) - values, high - values

    def subtract(self, moves: Sequence[Array], coefs: Array) -> ModelFit:
        """The fit with columns (2n, k) of each clip, times coefficients (k,), subtracted from its residuals."""
        left = tuple(r - m @ coefs for r, m in zip(self.residuals, moves, strict=True))
        return dataclasses.replace(self, residuals=left)

    @property
    def chi2(self) -> float:
        return float(sum(r @ r for r in self.residuals))

    @property
    def points(self) -> int:
        """The number of measured coordinates."""
        return sum(len(r) for r in self.residuals)

    @property
    def parameters(self) -> int:
        return len(self.names) + self.launches.size

    @property
    def profiled_slopes(self) -> tuple[Array, ...]:
        """Derivatives by the shared parameters, projected off those by the launch, (2n, S) for each clip."""
        return self.linearisation.profiled_slopes

    def added_names(self, base: ModelFit) -> dict[str, list[str]]:
        """The parameters fitted here but not in the base, by effect; a base parameter has its own name as key."""
        found: dict[str, list[str]] = {}
        for name in self.names:
            if name not in base.names:
                found.setdefault(name.rpartition(".")[0] or name, []).append(name)
        return found

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the shared parameters, (S, S), with the launches profiled out; zero for one without effect."""
        if not self.names:
            return np.zeros((0, 0))
        cleaned = self.profiled_slopes
        scale = np.sqrt(sum((c**2).sum(axis=0) for c in cleaned))
        units = (c / np.where(scale > 0, scale, 1) for c in cleaned)
        inverse = np.linalg.pinv(sum(u.T @ u for u in units), hermitian=True)
        return np.asarray(inverse / np.outer(*[np.where(scale > 0, scale, np.inf)] * 2))

    @property
    def std(self) -> dict[str, float]:
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def information(self, columns: Sequence[Array]) -> tuple[Array, Array]:
        """Fisher information (k, k) of further parameters, and their gradient (k,), for a first-order fit.

        The columns, whitened derivatives (2n, k) of each clip's track by these parameters, are first projected off the
        fit's own parameters and launches. Information and gradient are their products with themselves and with the
        residuals. All is done clip by clip, to save memory.
        """
        shared, launches = self.linearisation.parameter_bases, self.linearisation.launch_bases
        taken = np.asarray(sum(q.T @ c for q, c in zip(shared, columns, strict=True)))  # q is off the launches already
        gram, pull = np.zeros((len(taken.T), len(taken.T))), np.zeros(len(taken.T))
        for q, a, c, r in zip(shared, launches, columns, self.residuals, strict=True):
            left = c - a @ (a.T @ c) - q @ taken
            gram += left.T @ left
            pull += left.T @ r
        return gram, pull

    def extend(self, model: Model, names: Sequence[str], columns: Sequence[Array]) -> ModelFit:
        """The fit with further shared parameters, before it is fitted again; `is_linearised_here` is then False.

        The model has them at their start values. columns: whitened derivatives (2n, k) of each clip by them.
        """
        slopes = tuple(np.concatenate(both, axis=1) for both in zip(self.slopes, columns, strict=True))
        linearisation = dataclasses.replace(self.linearisation, slopes=slopes)
        return dataclasses.replace(self, model=model, names=(*self.names, *names), linearisation=linearisation)

    def drop(self, model: Model, names: Sequence[str]) -> ModelFit:
        """The fit with a model that lacks the shared parameters `names`, before it is fitted again."""
        kept = tuple(n for n in self.names if n not in names)
        slopes = tuple(s[:, self.columns_of(kept)] for s in self.slopes)
        linearisation = dataclasses.replace(self.linearisation, names=kept, slopes=slopes)
        return dataclasses.replace(self, model=model, names=kept, linearisation=linearisation)


def orthonormal_basis(columns: Array) -> Array:
    """Compute an orthonormal basis of the span of a fit's derivatives, columns (n, k)."""
    scale = np.linalg.norm(columns, axis=0)
    return np.asarray(np.linalg.qr(columns[:, scale > 0] / scale[scale > 0])[0])


def project_out(absorbing: Array, columns: Array) -> Array:
    """Subtract from derivatives, columns (n, k), what the other derivatives of a fit, (n, p), absorb."""
    q = orthonormal_basis(absorbing)
    return np.asarray(columns - q @ (q.T @ columns))
