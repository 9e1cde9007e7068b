"""Long tails of the scatter of bodies on air: Student's t, by which some stretches are pushed far more than others.

A body that touches the plate, or a hand that still pushes, gives one stretch accelerations many times those of others.
If all stretches had accelerations of one size, that stretch alone would decide it, and hide what the others show. So
the variance of the accelerations of a stretch is the common one times a number of its own, with the prior of Student's
t (inverse gamma; Lange, Little & Taylor, J. Am. Stat. Assoc. 84 (1989) 881). The likelihood averages over that number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.special import logsumexp

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.fitting.noise_refit import RestrictedResiduals
from discrepancy.fitting.stretch_moves import AirMoves, Moves, StretchScatter, correlate_displacements
from discrepancy.noise.model import Noise
from discrepancy.noise.whitening import ClipWhitener
from synthcam_shared.arrays import Array

FREEDOMS = (8.0, 4.0, 2.0)  # degrees of freedom that are tried, from nearly normal to long tails
MULTIPLES = np.exp(0.7 * np.arange(-6, 14))  # of the common variance, over which the likelihood averages
ROUNDS = 3  # of the multiples and the shared parameters, each by the other


@dataclass(frozen=True)
class FreeResiduals:
    """What the launch of one stretch cannot absorb of its residuals: k numbers that noise makes independent, of size 1.

    rows (k, 2n) times displacements, m, are such numbers.
    """

    rows: Array
    residuals: Array  # (k,)
    slopes: Array  # (k, S): their derivatives by the shared parameters
    xy: Array  # (n, 2) positions, m
    moves: AirMoves  # of these numbers

    @classmethod
    def of(cls, clip: MeasuredCollision, columns: Array, own: int, noise: Noise, moves: AirMoves) -> FreeResiduals:
        """columns (n, 2, own + S + 1): those of `RestrictedResiduals`, with `own` numbers of a launch."""
        white, n = ClipWhitener.of(replace(clip, scatter=None), noise), len(columns)
        seen = white.decorrelate(columns)
        launch = seen[:, :own][:, seen[:, :own].any(axis=0)]
        launch = launch / np.linalg.norm(launch, axis=0)
        free = np.linalg.qr(launch, mode="complete")[0][:, launch.shape[1] :].T
        rows = free @ white(np.eye(2 * n).reshape(n, 2, 2 * n))
        left = free @ seen[:, own:]
        return cls(rows, left[:, -1], left[:, :-1], clip.xy, moves.project(rows))

    def rotate(self, scatter: StretchScatter) -> RotatedResiduals:
        """Rotate the numbers so that a scatter, too, makes them independent."""
        moved, seen, volume = self.moves.spread(scatter), np.column_stack([self.slopes, self.residuals]), 0.0
        if scatter.displacement_m:
            kernel = correlate_displacements(self.xy, self.xy, scatter)
            displaced = sum(self.rows[:, axis::2] @ kernel @ self.rows[:, axis::2].T for axis in range(2))
            factor = cholesky(np.eye(len(self.rows)) + displaced, lower=True)
            half = solve_triangular(factor, moved, lower=True)
            moved, seen = (solve_triangular(factor, each, lower=True) for each in (half.T, seen))
            volume = 2 * float(np.log(np.diag(factor)).sum())
        variances, axes = np.linalg.eigh((moved + moved.T) / 2)
        seen = axes.T @ seen
        return RotatedResiduals(np.maximum(variances, 0.0), seen[:, -1], seen[:, :-1], volume)


@dataclass(frozen=True)
class RotatedResiduals:
    """Numbers whose variances are 1 and, times the multiple of the stretch, those of its accelerations."""

    variances: Array  # (k,) by accelerations
    residuals: Array  # (k,)
    slopes: Array  # (k, S)
    volume: float  # the log determinant of their covariance before the rotation, without accelerations

    def log_likelihoods(self, shared: Array) -> Array:
        """The log likelihood of each of MULTIPLES; shared (S,): changes of the shared parameters."""
        total = 1 + MULTIPLES[:, None] * self.variances
        left = self.residuals - self.slopes @ shared
        return np.asarray(-(np.log(total) + left**2 / total).sum(axis=1) - self.volume) / 2


def weigh_multiples(freedom: float) -> Array:
    """The logarithm of the prior of each of MULTIPLES; with a freedom of 0 all have the multiple 1."""
    logs = np.log(MULTIPLES)
    if not freedom:
        return np.where(logs == 0.0, 0.0, -np.inf)
    density = -freedom / 2 * (logs + 1 / MULTIPLES)
    return np.asarray(density - logsumexp(density))


@dataclass(frozen=True)
class TailLikelihood:
    """The likelihood of a scatter with long tails, by the residuals of stretches on air."""

    stretches: Sequence[FreeResiduals]

    @classmethod
    def of(
        cls,
        clips: Sequence[MeasuredCollision],
        fit: ModelFit,
        noise: Noise,
        moves: Sequence[Moves],
        indices: Sequence[int],
    ) -> TailLikelihood:
        """The likelihood by the residuals of a fit of these clips, of those with these indices, whose moves are given.

        The coefficients of a free law stay at their fit: without its prior they would absorb the scatter. A name with a
        space is that of such a coefficient.
        """
        fit = fit.drop(fit.model, [name for name in fit.names if " " in name])
        left = RestrictedResiduals.of(clips, fit, noise, indices)
        every = zip(left.clips, left.columns, moves, strict=True)
        return cls([FreeResiduals.of(c, x, left.own, noise, m) for c, x, m in every if isinstance(m, AirMoves)])

    def cost(self, scatter: StretchScatter, shared: Array) -> float:
        """-2 log likelihood; shared (S,): changes of the shared parameters."""
        prior = weigh_multiples(scatter.freedom)
        table = [stretch.rotate(scatter).log_likelihoods(shared) + prior for stretch in self.stretches]
        return -2 * float(logsumexp(np.array(table), axis=1).sum())

    def find_multiples(self, scatter: StretchScatter) -> tuple[Array, Array]:
        """Find the multiple of each stretch, and the changes (S,) of the shared parameters that fit best with them.

        A multiple is one over the mean of 1 / multiple, by which the likelihood weighs a stretch.
        """
        rotated, prior = [stretch.rotate(scatter) for stretch in self.stretches], weigh_multiples(scatter.freedom)
        multiples, shared = np.ones(len(rotated)), np.zeros(rotated[0].slopes.shape[1])
        for _ in range(ROUNDS):
            shared = _fit_shared(rotated, multiples)
            logs = np.array([stretch.log_likelihoods(shared) for stretch in rotated]) + prior
            odds = np.exp(logs - logsumexp(logs, axis=1, keepdims=True))
            multiples = 1 / (odds / MULTIPLES).sum(axis=1)
        return multiples, _fit_shared(rotated, multiples)

    def grow(self, moves: Sequence[Moves], scatter: StretchScatter) -> list[Moves]:
        """The moves of these stretches, each by accelerations as large as its own."""
        every = zip(moves, self.find_multiples(scatter)[0], strict=True)
        return [move.grow(float(np.sqrt(m))) for move, m in every if isinstance(move, AirMoves)]


def _fit_shared(rotated: Sequence[RotatedResiduals], multiples: Array) -> Array:
    """Fit the changes (S,) of the shared parameters to stretches with these multiples."""
    roots = [np.sqrt(1 + m * one.variances)[:, None] for one, m in zip(rotated, multiples, strict=True)]
    slopes = np.concatenate([one.slopes / root for one, root in zip(rotated, roots, strict=True)])
    left = np.concatenate([one.residuals / root[:, 0] for one, root in zip(rotated, roots, strict=True)])
    return np.asarray(np.linalg.lstsq(slopes, left, rcond=None)[0])
