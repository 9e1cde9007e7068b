"""The band of a fitted curve: the law is smooth, or it has a step; the data weigh which.

A smooth curve cannot follow a step, and its covariance does not know that. So the band is that of a mixture: the
smooth curve, and steps at many places and of some widths, each with its marginal likelihood for a weight. Either sort
is as likely beforehand, and so is every step of its sort. A step's height has a Gaussian prior of the size that makes
the data likeliest, as the curve's coefficients have: z standard deviations from zero, it costs 1 + ln z^2 of chi^2.
The same weights say what the free law as a whole is worth beside the library's models.
Bayesian model averaging: Hoeting et al., Statistical Science 14 (1999) 382.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import logsumexp, ndtr

from discrepancy.arrays import Array
from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.marginal_likelihood import maximise_evidence

PLACES, WIDTHS = 40, 6  # of steps that are tried at once
WIDTH = (0.004, 0.15)  # of a step's tanh, from, to: shares of the range; by its logarithm
AT_ONCE = 60  # columns
ENOUGH = 12.0  # steps that share the weight: the tries are close enough
ZOOMS = 6  # at most, into where the weight is
LEAST = 1e-6  # of the weight: components with less have no part
SEEN = 1e-6  # of a step's information were all else known: with less it is in the span of all else, or error of slopes
HALVINGS = 60  # of an interval in which a quantile lies


@dataclass(frozen=True)
class NormalMixture:
    """A law at n places by normal components. weight: (k,), of sum one; mean, std: (k, n, parts)."""

    weight: Array
    mean: Array
    std: Array

    @classmethod
    def of(cls, fitted_law: FittedLaw, *x: Array) -> NormalMixture:
        """The law at x. Maps, laws of an angle and numbers of each clip have no steps."""
        mean, covariance = fitted_law.curve(*x)
        std = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0)).T
        if not _can_have_step(fitted_law):
            return cls(np.ones(1), mean[None], std[None])
        odds, means, stds = _weigh_steps(fitted_law, x[0])
        odds = np.array([0.0, *odds])
        weight = np.exp(odds - logsumexp(odds))
        kept = weight > LEAST
        mean, std = np.concatenate([mean[None], means]), np.concatenate([std[None], stds])
        return cls(weight[kept] / weight[kept].sum(), mean[kept], std[kept])

    def quantile(self, deviations: float) -> Array:
        """(n, parts): below it lies as much as of a normal below so many standard deviations."""
        ends = self.mean + deviations * self.std
        low, high = ends.min(axis=0), ends.max(axis=0)
        for _ in range(HALVINGS if len(self.weight) > 1 else 0):
            middle = (low + high) / 2
            spread = np.maximum(self.std, 1e-300)  # of a centred law some place may have none
            below = np.tensordot(self.weight, ndtr((middle - self.mean) / spread), 1) < ndtr(deviations)
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return np.asarray((low + high) / 2)


def gain_of_steps(fitted_law: FittedLaw) -> float:
    """How much likelier, in chi^2, the clips are where the law may be smooth or have a step than where it is smooth."""
    if not _can_have_step(fitted_law):
        return 0.0
    odds, _, _ = _weigh_steps(fitted_law, fitted_law.law.axes[0].grid(1))
    return float(2 * (logsumexp([0.0, *odds]) - np.log(2)))


def _can_have_step(fitted_law: FittedLaw) -> bool:
    return len(fitted_law.law.axes) == 1 and fitted_law.law.axes[0].kind == "line"


@dataclass(frozen=True)
class _StepAxis(Axis):
    """An axis whose series is steps. where: (count, 2), places and ln of widths, shares of the range."""

    where: Array | None = None

    def basis(self, x: Any) -> Array:
        assert self.where is not None
        share = (np.asarray(x)[..., None] - self.low) / (self.high - self.low)
        return np.asarray((1 + np.tanh((share - self.where[:, 0]) / np.exp(self.where[:, 1]))) / 2)


def _weigh_steps(fitted_law: FittedLaw, x: Array) -> tuple[Array, Array, Array]:
    """ln of the odds (k,) of each step against the smooth curve; their laws at x: means and deviations, (k, n, 1).

    Tried anew within the box of places and widths that holds the weight, until that is shared by enough of them.
    """
    bare = replace(fitted_law, fit=fitted_law.fit.subtract(fitted_law.slopes, -fitted_law.coefs))  # of no curve
    smooth = maximise_evidence(fitted_law.law, *_reduce_to_columns(bare, fitted_law.slopes)[:2]).gain
    whole = box = np.array([[0.0, 1.0], np.log(WIDTH)])
    counts = np.array([PLACES, WIDTHS])
    for _ in range(ZOOMS):
        cell = np.ptp(box, axis=1) / counts
        sides = [low + side * (np.arange(n) + 0.5) for low, side, n in zip(box[:, 0], cell, counts, strict=True)]
        where = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
        tried = [_fit_steps(bare, some, x) for some in np.array_split(where, -(-len(where) // AT_ONCE))]
        gains, means, stds = (np.concatenate(each) for each in zip(*tried, strict=True))
        odds = (gains - smooth) / 2 + np.log(np.prod(cell / np.ptp(whole, axis=1)))
        weight = np.exp(odds - logsumexp(odds))
        heavy = where[weight > LEAST]
        closer = np.clip(np.stack([heavy.min(axis=0) - cell, heavy.max(axis=0) + cell], 1), whole[:, :1], whole[:, 1:])
        if 1 / (weight @ weight) > ENOUGH or np.prod(np.ptp(closer, axis=1)) > 0.5 * np.prod(np.ptp(box, axis=1)):
            break
        box = closer
    return odds, means, stds


def _fit_steps(bare: FittedLaw, where: Array, x: Array) -> tuple[Array, Array, Array]:
    """Of steps: what each gains over no curve, in chi^2, its freedom paid for; means and deviations, (k, n, 1), at x.

    Like the curve, a step stands on those of the law's own parameters that are fitted.
    """
    law, fit, axis = bare.law, bare.fit, bare.law.axes[0]
    step = replace(law, axes=(_StepAxis(axis.name, axis.unit, axis.low, axis.high, len(where), where=where),))
    moves = bare.evidence.whiten(step.derivatives(fit.model, fit.launches, bare.evidence.clips))
    information, pull, own, spread, back = _reduce_to_columns(bare, moves)
    alone = sum((m**2).sum(axis=0) for m in moves) + np.finfo(float).tiny
    seen = np.maximum(np.diag(information), SEEN * alone)
    z2 = np.maximum(pull**2 / seen, 1.0)
    size = (1 - 1 / z2) / seen  # the height's variance: none of a step that hardly shows
    here = np.array([x**power for _, power in bare.owners]).reshape(-1, len(x)).T
    known = law.value_in_model(fit.model, x)[:, 0]
    parts = [known + here @ own, here, step.basis(x) - here @ back]
    middle, base, curve = (p - p.mean(axis=0) for p in parts) if law.centred else parts
    mean = middle[:, None] + curve * (size * pull)
    std = np.sqrt(np.einsum("ni,ij,nj->n", base, spread, base)[:, None] + curve**2 * size)
    return z2 - 1 - np.log(z2), mean.T[..., None], std.T[..., None]


def _reduce_to_columns(fitted_law: FittedLaw, moves: Sequence[Array]) -> tuple[Array, Array, Array, Array, Array]:
    """Of columns, the law's own parameters marginal: information and pull; of those, without the columns: by how much
    they change, and covariance; and by how much a unit of each column makes them less, (own, columns).
    """
    fit, names = fitted_law.fit, [name for name, _ in fitted_law.owners]
    own = [s[:, fit.columns_of(names)] for s in fit.slopes]
    both = [np.concatenate(pair, axis=1) for pair in zip(own, moves, strict=True)]
    information, pull = fit.drop(fit.model, names).information(both)
    first, rest = slice(len(names)), slice(len(names), None)
    spread = np.asarray(np.linalg.pinv(information[first, first], hermitian=True))
    back = np.asarray(spread @ information[first, rest])
    free = information[rest, rest] - information[rest, first] @ back
    return free, pull[rest] - pull[first] @ back, spread @ pull[first], spread, back
