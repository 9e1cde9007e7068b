"""Fits the scatter from one free stretch to the next: of friction, rolling loss, and smooth displacements.

Real cloth, air and cameras differ from place to place and from shot to shot by more than the noise of positions. No
parameter that all stretches share describes that. It is a random effect of each stretch (Pinheiro & Bates,
Mixed-Effects Models in S and S-PLUS, 2000). It therefore belongs to the covariance of the positions. Restricted maximum
likelihood gives its sizes, if the likelihood pays their price.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import V0
from discrepancy.fitting.jacobian import differentiate_tracks
from discrepancy.fitting.model_fit import ModelFit, orthonormal_basis
from discrepancy.fitting.noise_refit import RestrictedResiduals
from discrepancy.noise.model import Noise, finite_cost, minimise_cost
from discrepancy.noise.whitening import ClipWhitener
from discrepancy.policy import current_policy
from synthcam.model import Model
from synthcam_shared.arrays import Array

SIZES = ("friction", "loss_m_s2", "displacement_m", "reach_m")


@dataclass(frozen=True)
class StretchScatter:
    """Standard deviations of what differs from stretch to stretch; zero where nothing does."""

    friction: float = 0.0  # of the sliding friction, relative
    loss_m_s2: float = 0.0  # of the rolling loss
    displacement_m: float = 0.0  # of each axis, as of a camera's map
    reach_m: float = 0.0  # over which a displacement stays the same
    map_log_ratio: float = 0.0  # log likelihood ratio of displacements by one map to new ones in each stretch

    @property
    def is_none(self) -> bool:
        """True if nothing differs."""
        return not (self.friction or self.loss_m_s2 or self.displacement_m)

    def is_close_to(self, other: StretchScatter, tolerance: float = 0.15) -> bool:
        """True if no size differs from the other's by more than this share of the larger one."""
        pairs = ((getattr(self, name), getattr(other, name)) for name in SIZES)
        return all(abs(a - b) <= tolerance * max(a, b) for a, b in pairs)

    def add_to(self, clips: Sequence[MeasuredCollision], model: Model, launches: Array) -> list[MeasuredCollision]:
        """The clips with this scatter in the covariance of their positions, instead of any other."""
        if self.is_none:
            return [replace(clip, scatter=None) for clip in clips]
        return _add_scatter(clips, _differentiate_losses(clips, model, launches), self)


NO_SCATTER = StretchScatter()


def fit_scatter(
    clips: Sequence[MeasuredCollision],
    fit: ModelFit,
    noise: Noise,
    max_clips: int = 40,
    max_to_noise: float = 10.0,
    max_positions: int = 2500,
) -> StretchScatter:
    """Fit the scatter from stretch to stretch to the residuals of a fit of these clips that was made with `noise`.

    max_clips: evenly spread, they determine the sizes well enough.
    max_to_noise: the largest displacement; what exceeds it is motion that the model lacks.
    max_positions: of stretches that are compared with a map; memory grows as the square.

    All are zero if together they gain less in -2 log likelihood than `SearchPolicy.min_noise_gain`, and 2 for each size
    more. Else each keeps its most likely value: without a real scatter of one size, claims would be too significant.
    """
    indices = np.unique(np.linspace(0, len(clips) - 1, min(max_clips, len(clips))).astype(int)).tolist()
    left = RestrictedResiduals.of(clips, fit, noise, indices)
    bare = [replace(clip, scatter=None) for clip in left.clips]
    moves = _differentiate_losses(bare, fit.model, fit.launches[indices])
    way = float(np.median([np.hypot(*np.ptp(clip.xy, axis=0)) for clip in bare]))
    noise_m = noise.scale * float(np.median(np.concatenate([clip.claimed_std() for clip in bare])))
    speed = np.median(np.abs(fit.launches[:, V0]))
    start = {
        "friction": 0.05,
        "loss_m_s2": 0.2 * max(float(fit.model.rolling_decel + fit.model.rolling_drag * speed), 1e-3),
        "displacement_m": noise_m,
        "reach_m": 0.2 * way,
    }

    names = [name for name in SIZES if name != "friction" or fit.model.sliding_friction]

    def build(x: Array) -> StretchScatter:
        values = {name: start[name] * float(np.exp(np.clip(v, -7, 7))) for name, v in zip(names, x, strict=True)}
        values["displacement_m"] = min(values["displacement_m"], max_to_noise * noise_m)
        values["reach_m"] = min(max(values["reach_m"], 0.02 * way), 0.5 * way)
        return StretchScatter(**values)

    def cost(scatter: StretchScatter) -> float:
        return replace(left, clips=_add_scatter(bare, moves, scatter)).cost(noise)

    def price(x: Array) -> float:
        return cost(build(x))

    x = minimise_cost(price, np.zeros(len(names)))
    least = current_policy().min_noise_gain + 2 * (len(names) - 1)
    if cost(NO_SCATTER) - finite_cost(price, x) < least:
        return NO_SCATTER
    found = build(x)
    silent = [n for n in names if n != "reach_m" and getattr(found, n) < 0.02 * start[n]]
    found = replace(found, **dict.fromkeys(silent, 0.0))
    if not found.displacement_m:
        return found
    some = _choose_evenly([len(clip.frame) for clip in bare], max_positions)
    columns = [RestrictedResiduals.of(clips, fit, noise, [indices[k]]).columns[0] for k in some]
    chosen, pushed = [bare[k] for k in some], [moves[k] for k in some]
    return replace(found, map_log_ratio=_compare_with_map(chosen, columns, pushed, found, noise))


def _choose_evenly(sizes: Sequence[int], most: int) -> list[int]:
    """Choose, evenly spread, as many stretches of these sizes as have at most so many positions together, or one."""
    for count in range(len(sizes), 1, -1):
        chosen = np.linspace(0, len(sizes) - 1, count).astype(int).tolist()
        if sum(sizes[k] for k in chosen) <= most:
            return list(chosen)
    return [int(np.argmin(sizes))]


def _compare_with_map(
    clips: Sequence[MeasuredCollision],
    columns: Sequence[Array],
    moves: Sequence[Array],
    scatter: StretchScatter,
    noise: Noise,
) -> float:
    """The log likelihood ratio of displacements that all stretches share at a position to new ones in each stretch.

    columns (n, 2, p) of each clip, in claimed errors: what its fit absorbs, and its residuals last. Both kinds have the
    same size and reach. Neither model contains the other, so the ratio is not a sigma. If the displacements are new in
    each stretch, chance gives a ratio above x with a probability of at most 1 / x.
    """
    whites, left = list[Array](), list[Array]()
    for clip, own in zip(_add_scatter(clips, moves, replace(scatter, displacement_m=0.0)), columns, strict=True):
        white = ClipWhitener.of(clip, noise)
        seen = white.decorrelate(own)
        q = orthonormal_basis(seen[:, :-1])
        unit = white(np.eye(2 * len(own)).reshape(len(own), 2, -1))
        whites.append(unit - q @ (q.T @ unit))
        left.append(seen[:, -1] - q @ (q.T @ seen[:, -1]))
    every, places = np.concatenate(left), [clip.xy for clip in clips]
    ends = np.cumsum([0, *map(len, left)])
    total, new_cost = np.eye(len(every), order="F"), 0.0
    for i, one in enumerate(whites):
        rows = slice(ends[i], ends[i + 1])
        by_place = one.reshape(len(one), -1, 2).transpose(0, 2, 1)  # (2n, 2, n): each axis by itself
        for j, other in enumerate(whites[: i + 1]):
            displaced = (by_place @ _kernel(places[i], places[j], scatter)).transpose(0, 2, 1).reshape(len(one), -1)
            total[rows, ends[j] : ends[j + 1]] += displaced @ other.T
        new_cost += _cost_of_normal(total[rows, rows].copy(order="F"), left[i])
    return (new_cost - _cost_of_normal(total, every)) / 2


def _cost_of_normal(covariance: Array, values: Array) -> float:
    """-2 log likelihood of normal values. The covariance is given by its lower triangle, and is overwritten."""
    factor = cholesky(covariance, lower=True, overwrite_a=True, check_finite=False)
    unit = solve_triangular(factor, values, lower=True, check_finite=False)
    return float(unit @ unit + 2 * np.log(np.diag(factor)).sum())


def _kernel(one: Array, other: Array, scatter: StretchScatter) -> Array:
    apart = ((one[:, None] - other) ** 2).sum(axis=-1)
    return np.asarray(scatter.displacement_m**2 * np.exp(-apart / (2 * scatter.reach_m**2)))


def _differentiate_losses(clips: Sequence[MeasuredCollision], model: Model, launches: Array) -> list[Array]:
    """Displacements (n, 2, 2) of each clip, m: by twice the friction, and by a further loss of 1 m/s^2."""
    friction = differentiate_tracks(model, launches, clips, "sliding_friction")
    loss = differentiate_tracks(model, launches, clips, "rolling_decel")
    return [np.stack([f * model.sliding_friction, d], axis=-1) for f, d in zip(friction, loss, strict=True)]


def _add_scatter(
    clips: Sequence[MeasuredCollision], moves: Sequence[Array], scatter: StretchScatter
) -> list[MeasuredCollision]:
    sizes, out = np.array([scatter.friction, scatter.loss_m_s2]), []
    for clip, move in zip(clips, moves, strict=True):
        columns = (move * sizes).reshape(-1, 2)
        total = (columns @ columns.T).reshape(len(move), 2, len(move), 2)
        if scatter.displacement_m:
            kernel = _kernel(clip.xy, clip.xy, scatter)
            for axis in range(2):
                total[:, axis, :, axis] += kernel
        out.append(replace(clip, scatter=total))
    return out
