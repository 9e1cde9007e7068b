"""Compute the credible band of a fitted curve, which may be smooth or have a step.

A smooth curve cannot follow a step, and its covariance does not include that error. The band is therefore that of a
mixture: the smooth curve, and steps of many positions and widths, each weighted by its marginal likelihood. Curve and
step have the same prior probability, and so have all steps among themselves. The height of a step has a Gaussian
prior whose size maximises the likelihood, as for the coefficients of the curve. A height of z standard deviations then
costs 1 + ln z^2 in chi^2. The same weights rate the free law against the models of the library.

Bayesian model averaging: Hoeting et al., Statistical Science 14 (1999) 382.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import logsumexp, ndtr

from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.marginal_likelihood import maximise_evidence
from discrepancy.free_laws.ranges import Axis
from synthcam_shared.arrays import Array

MIN_WEIGHT = 1e-6  # components of a smaller weight are dropped


@dataclass(frozen=True)
class NormalMixture:
    """The posterior of a law at n points, as a mixture of k normal distributions."""

    weight: Array  # (k,), which add up to one
    mean: Array  # (k, n, parts), as is the std
    std: Array

    @classmethod
    def of(cls, fitted_law: FittedLaw, *x: Array) -> NormalMixture:
        """Evaluate the law at x. Maps, laws of an angle and numbers of each clip have no steps."""
        mean, covariance = fitted_law.curve(*x)
        std = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0)).T
        if not _can_have_step(fitted_law):
            return cls(np.ones(1), mean[None], std[None])
        odds, means, stds = _weigh_steps(fitted_law, x[0])
        odds = np.array([0.0, *odds])
        weight = np.exp(odds - logsumexp(odds))
        kept = weight > MIN_WEIGHT
        mean, std = np.concatenate([mean[None], means]), np.concatenate([std[None], stds])
        return cls(weight[kept] / weight[kept].sum(), mean[kept], std[kept])

    def quantile(self, deviations: float) -> Array:
        """Find by bisection the quantile, (n, parts), that a normal has at so many standard deviations."""
        ends = self.mean + deviations * self.std
        low, high = ends.min(axis=0), ends.max(axis=0)
        for _ in range(60 if len(self.weight) > 1 else 0):
            middle = (low + high) / 2
            spread = np.maximum(self.std, 1e-300)  # a centred law may have no error somewhere
            below = np.tensordot(self.weight, ndtr((middle - self.mean) / spread), 1) < ndtr(deviations)
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return np.asarray((low + high) / 2)


def gain_of_steps(fitted_law: FittedLaw) -> float:
    """Compute how much chi^2 a mixture of a smooth curve and steps gains over the smooth curve alone."""
    if not _can_have_step(fitted_law):
        return 0.0
    odds, _, _ = _weigh_steps(fitted_law, fitted_law.law.axes[0].grid(1))
    return float(2 * (logsumexp([0.0, *odds]) - np.log(2)))


def _can_have_step(fitted_law: FittedLaw) -> bool:
    return len(fitted_law.law.axes) == 1 and fitted_law.law.axes[0].kind == "line"


@dataclass(frozen=True)
class _StepAxis(Axis):
    """An axis whose series is steps. steps: (count, 2), positions and ln of widths, as shares of the range."""

    steps: Array | None = None

    def basis(self, x: Any) -> Array:
        assert self.steps is not None
        share = (np.asarray(x)[..., None] - self.low) / (self.high - self.low)
        return np.asarray((1 + np.tanh((share - self.steps[:, 0]) / np.exp(self.steps[:, 1]))) / 2)


def _weigh_steps(fitted_law: FittedLaw, x: Array) -> tuple[Array, Array, Array]:
    """Log odds (k,) of steps against the smooth curve, on a grid refined where the weight is; mean and std at x."""
    counts, batch = (40, 6), 60  # positions and widths of one grid; steps fitted at once, to limit memory
    widths = (0.004, 0.15)  # the smallest and the largest of a step's tanh, as shares of the range
    min_effective_steps, max_refinements = 12.0, 6  # that share the weight in the end, if it still halves
    bare = replace(fitted_law, fit=fitted_law.fit.subtract(fitted_law.slopes, -fitted_law.coefs))  # without curve
    smooth = maximise_evidence(fitted_law.law, *_reduce_to_columns(bare, fitted_law.slopes)[:2]).gain
    whole = box = np.array([[0.0, 1.0], np.log(widths)])
    for _ in range(max_refinements):
        cell = np.ptp(box, axis=1) / np.array(counts)
        sides = [low + side * (np.arange(n) + 0.5) for low, side, n in zip(box[:, 0], cell, counts, strict=True)]
        steps = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
        tried = [_fit_steps(bare, some, x) for some in np.array_split(steps, -(-len(steps) // batch))]
        gains, means, stds = (np.concatenate(each) for each in zip(*tried, strict=True))
        odds = (gains - smooth) / 2 + np.log(np.prod(cell / np.ptp(whole, axis=1)))
        weight = np.exp(odds - logsumexp(odds))
        heavy = steps[weight > MIN_WEIGHT]
        closer = np.clip(np.stack([heavy.min(axis=0) - cell, heavy.max(axis=0) + cell], 1), whole[:, :1], whole[:, 1:])
        shrinks = np.prod(np.ptp(closer, axis=1)) <= 0.5 * np.prod(np.ptp(box, axis=1))
        if 1 / (weight @ weight) > min_effective_steps or not shrinks:
            break
        box = closer
    return odds, means, stds


def _fit_steps(bare: FittedLaw, steps: Array, x: Array) -> tuple[Array, Array, Array]:
    """Fit each step alone with the law's own parameters: gain over no curve, less freedom; mean and std at x."""
    law, fit, axis = bare.law, bare.fit, bare.law.axes[0]
    step = replace(law, axes=(_StepAxis(axis.name, axis.unit, axis.low, axis.high, len(steps), steps=steps),))
    moves = bare.evidence.whiten(step.derivatives(fit.model, fit.launches, bare.evidence.clips))
    information, pull, own, spread, back = _reduce_to_columns(bare, moves)
    alone = sum((m**2).sum(axis=0) for m in moves) + np.finfo(float).tiny
    known = np.maximum(np.diag(information), 1e-6 * alone)  # below 1e-6 it is in the span of the rest, or rounding
    z2 = np.maximum(pull**2 / known, 1.0)
    size = (1 - 1 / z2) / known  # the height's variance; 0 for a step below one standard deviation
    here = np.array([x**power for _, power in bare.owners]).reshape(-1, len(x)).T
    in_model = law.value_in_model(fit.model, x)[:, 0]
    parts = [in_model + here @ own, here, step.basis(x) - here @ back]
    middle, base, curve = (p - p.mean(axis=0) for p in parts) if law.centred else parts
    mean = middle[:, None] + curve * (size * pull)
    std = np.sqrt(np.einsum("ni,ij,nj->n", base, spread, base)[:, None] + curve**2 * size)
    return z2 - 1 - np.log(z2), mean.T[..., None], std.T[..., None]


def _reduce_to_columns(fitted_law: FittedLaw, moves: Sequence[Array]) -> tuple[Array, Array, Array, Array, Array]:
    """Marginalise columns over the law's own parameters.

    Returns the columns' information and pull. Then follow the change and the covariance of the own parameters without
    the columns. Last comes by how much a unit of each column lowers the own parameters, (own, columns).
    """
    information, pull = fitted_law.information_with_owners(moves)
    first, rest = slice(len(fitted_law.owners)), slice(len(fitted_law.owners), None)
    spread = np.asarray(np.linalg.pinv(information[first, first], hermitian=True))
    back = np.asarray(spread @ information[first, rest])
    free = information[rest, rest] - information[rest, first] @ back
    return free, pull[rest] - pull[first] @ back, spread @ pull[first], spread, back
