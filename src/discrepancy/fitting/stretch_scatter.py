"""Fits the scatter from one free stretch to the next: of friction, loss, acceleration, and smooth displacements.

Real cloth, air and cameras differ from place to place and from shot to shot by more than the noise of positions. No
parameter that all stretches share describes that. It is a random effect of each stretch (Pinheiro & Bates,
Mixed-Effects Models in S and S-PLUS, 2000). It therefore belongs to the covariance of the positions. Restricted maximum
likelihood gives its sizes, if the likelihood pays their price.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import V0
from discrepancy.fitting.air_scatter import AirScatterFits, guess_air_sizes
from discrepancy.fitting.model_fit import ModelFit, orthonormal_basis
from discrepancy.fitting.noise_refit import RestrictedResiduals
from discrepancy.fitting.scatter_tails import TailLikelihood
from discrepancy.fitting.stretch_moves import (
    DISPLACED,
    NO_SCATTER,
    ON_PLATE,
    Moves,
    ScatterSizes,
    StretchScatter,
    add_moves,
    correlate_displacements,
    find_moves,
)
from discrepancy.noise.model import Noise, finite_cost, minimise_cost
from discrepancy.noise.whitening import ClipWhitener
from discrepancy.policy import current_policy
from synthcam_shared.arrays import Array


def add_scatter(
    clips: Sequence[MeasuredCollision], fit: ModelFit, scatter: StretchScatter, noise: Noise
) -> list[MeasuredCollision]:
    """The clips with a scatter in the covariance of their positions, instead of any other.

    fit: of these clips, with `noise`. Its residuals show which stretches have large accelerations (`scatter_tails`).
    """
    if scatter.is_none:
        return [replace(clip, scatter=None) for clip in clips]
    moves: Sequence[Moves] = find_moves(clips, fit.model, fit.launches)
    if scatter.freedom:
        moves = TailLikelihood.of(clips, fit, noise, moves, range(len(clips))).grow(moves, scatter)
    return add_moves(clips, moves, scatter)


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
    more. Else each keeps its most likely value: without a real scatter of one size, claims would be too significant. On
    air, displacements hardly differ from accelerations. They are zero unless they gain as much beside these.
    """
    indices = np.unique(np.linspace(0, len(clips) - 1, min(max_clips, len(clips))).astype(int)).tolist()
    left = RestrictedResiduals.of(clips, fit, noise, indices)
    bare = [replace(clip, scatter=None) for clip in left.clips]
    moves: Sequence[Moves] = find_moves(bare, fit.model, fit.launches[indices])
    way = float(np.median([np.hypot(*np.ptp(clip.xy, axis=0)) for clip in bare]))
    noise_m = noise.scale * float(np.median(np.concatenate([clip.claimed_std() for clip in bare])))
    limits = max_to_noise * noise_m, (0.02 * way, 0.5 * way)
    if fit.model.sliding_friction:
        sizes = ScatterSizes(_guess_plate_sizes(fit, way, noise_m), *limits, 0.0)
        found = _fit_on_plate(left, moves, noise, sizes)
    else:
        start, speed = guess_air_sizes(left, moves, way, noise_m)
        sizes, tails = ScatterSizes(start, *limits, speed), TailLikelihood.of(clips, fit, noise, moves, indices)
        found = _fit_on_air(AirScatterFits(tails, sizes))
        moves = tails.grow(moves, found) if found.freedom else moves
    found = sizes.drop_negligible(found)
    if not found.displacement_m:
        return found
    some = _choose_evenly([len(clip.frame) for clip in bare], max_positions)
    columns = [RestrictedResiduals.of(clips, fit, noise, [indices[k]]).columns[0] for k in some]
    chosen, pushed = [bare[k] for k in some], [moves[k] for k in some]
    return replace(found, map_log_ratio=_compare_with_map(chosen, columns, pushed, found, noise))


def _guess_plate_sizes(fit: ModelFit, way: float, noise_m: float) -> dict[str, float]:
    """Guess the scatter on a plate; way: the median length of a path, m."""
    speed = float(np.median(np.abs(fit.launches[:, V0])))
    loss = 0.2 * max(float(fit.model.rolling_decel + fit.model.rolling_drag * speed), 1e-3)
    return {"displacement_m": noise_m, "reach_m": 0.2 * way, "friction": 0.05, "loss_m_s2": loss}


def _fit_on_plate(
    left: RestrictedResiduals, moves: Sequence[Moves], noise: Noise, sizes: ScatterSizes
) -> StretchScatter:
    """Fit the scatter on a plate by its restricted likelihood."""
    names = (*ON_PLATE, *DISPLACED)

    def cost(scatter: StretchScatter) -> float:
        return replace(left, clips=add_moves(left.clips, moves, scatter)).cost(noise)

    def price(x: Array) -> float:
        return cost(sizes.build(names, x))

    x = minimise_cost(price, np.zeros(len(names)))
    return sizes.build(names, x) if _gains_enough(cost(NO_SCATTER) - finite_cost(price, x), len(x)) else NO_SCATTER


def _fit_on_air(fits: AirScatterFits) -> StretchScatter:
    """Fit the scatter on air."""
    best = fits.find_best()
    return best.scatter if _gains_enough(fits.cost_without_scatter() - best.cost, len(best.x)) else NO_SCATTER


def _gains_enough(gain: float, count: int) -> bool:
    """Tell if a scatter of so many sizes gains enough in -2 log likelihood."""
    return gain >= current_policy().min_noise_gain + 2 * (count - 1)


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
    moves: Sequence[Moves],
    scatter: StretchScatter,
    noise: Noise,
) -> float:
    """The log likelihood ratio of displacements that all stretches share at a position to new ones in each stretch.

    columns (n, 2, p) of each clip, in claimed errors: what its fit absorbs, and its residuals last. Both kinds have the
    same size and reach. Neither model contains the other, so the ratio is not a sigma. If the displacements are new in
    each stretch, chance gives a ratio above x with a probability of at most 1 / x.
    """
    whites, left = list[Array](), list[Array]()
    for clip, own in zip(add_moves(clips, moves, replace(scatter, displacement_m=0.0)), columns, strict=True):
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
            displaced = (
                (by_place @ correlate_displacements(places[i], places[j], scatter))
                .transpose(0, 2, 1)
                .reshape(len(one), -1)
            )
            total[rows, ends[j] : ends[j + 1]] += displaced @ other.T
        new_cost += _cost_of_normal(total[rows, rows].copy(order="F"), left[i])
    return (new_cost - _cost_of_normal(total, every)) / 2


def _cost_of_normal(covariance: Array, values: Array) -> float:
    """-2 log likelihood of normal values. The covariance is given by its lower triangle, and is overwritten."""
    factor = cholesky(covariance, lower=True, overwrite_a=True, check_finite=False)
    unit = solve_triangular(factor, values, lower=True, check_finite=False)
    return float(unit @ unit + 2 * np.log(np.diag(factor)).sum())
