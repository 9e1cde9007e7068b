"""Fits the scatter from one free stretch to the next: of friction, loss, acceleration, and smooth displacements.

Real cloth, air and cameras differ from place to place and from shot to shot by more than the noise of positions. No
parameter that all stretches share describes that. It is a random effect of each stretch (Pinheiro & Bates,
Mixed-Effects Models in S and S-PLUS, 2000). It therefore belongs to the covariance of the positions. Restricted maximum
likelihood gives its sizes, if the likelihood pays their price.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import V0
from discrepancy.fitting.model_fit import ModelFit, orthonormal_basis
from discrepancy.fitting.noise_refit import RestrictedResiduals
from discrepancy.fitting.scatter_tails import FREEDOMS, TailLikelihood
from discrepancy.fitting.stretch_moves import (
    DISPLACED,
    NO_SCATTER,
    ON_AIR,
    ON_PLATE,
    AirMoves,
    Moves,
    StretchScatter,
    add_moves,
    correlate_displacements,
    find_moves,
)
from discrepancy.noise.model import Noise, finite_cost, minimise_cost
from discrepancy.noise.whitening import ClipWhitener
from discrepancy.policy import current_policy
from synthcam_shared.arrays import Array

SPEED_POWERS = (0, 1, 2)
MAX_LOG_GROWTH = 7.0  # of a size, over the one from which its fit starts
RESIDUAL_TO_PUSH = 27.0  # a constant acceleration a leaves an rms of a T^2 / 27 about a straight line, in a time T


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
    on_air = not fit.model.sliding_friction
    start, speed = _start_on_air(left, moves, way, noise_m) if on_air else (_start_on_plate(fit, way, noise_m), 0.0)
    reaches = 0.02 * way, 0.5 * way
    likelihood = _ScatterLikelihood(left, moves, noise, start, max_to_noise * noise_m, reaches, speed)
    least_gain = current_policy().min_noise_gain
    best = likelihood.maximise_on_air(least_gain) if on_air else likelihood.maximise([*ON_PLATE, *DISPLACED])
    if likelihood.cost(NO_SCATTER) - best.cost < least_gain + 2 * (len(best.x) - 1):
        return NO_SCATTER
    found = best.scatter
    if on_air:
        tails = TailLikelihood.of(clips, fit, noise, moves, indices)
        found = likelihood.lengthen_tails(found, tails)
        moves = tails.grow(moves, found) if found.freedom else moves
    found = likelihood.drop_negligible(found)
    if not found.displacement_m:
        return found
    some = _choose_evenly([len(clip.frame) for clip in bare], max_positions)
    columns = [RestrictedResiduals.of(clips, fit, noise, [indices[k]]).columns[0] for k in some]
    chosen, pushed = [bare[k] for k in some], [moves[k] for k in some]
    return replace(found, map_log_ratio=_compare_with_map(chosen, columns, pushed, found, noise))


Start = dict[str, float]  # sizes by name, from which a fit of the scatter starts


def _start_on_plate(fit: ModelFit, way: float, noise_m: float) -> Start:
    """Guess the scatter on a plate; way: the median length of a path, m."""
    speed = float(np.median(np.abs(fit.launches[:, V0])))
    loss = 0.2 * max(float(fit.model.rolling_decel + fit.model.rolling_drag * speed), 1e-3)
    return {"displacement_m": noise_m, "reach_m": 0.2 * way, "friction": 0.05, "loss_m_s2": loss}


def _start_on_air(left: RestrictedResiduals, moves: Sequence[Moves], way: float, noise_m: float) -> tuple[Start, float]:
    """Guess the scatter on air, and the median speed, m/s; way: the median length of a path, m."""
    lasts = np.array([np.ptp(clip.frame) / clip.fps for clip in left.clips])
    both = zip(left.columns, left.clips, strict=True)
    size = np.array([np.std(columns[..., -1]) * np.mean(clip.claimed_std()) for columns, clip in both])
    push = float(np.median(RESIDUAL_TO_PUSH * size / lasts**2))
    start = {"loss_m_s2": push, "across_m_s2": push, "lasts_s": float(np.median(lasts)) / 2}
    # Displacements over more are like accelerations; from small ones, a descent may end at a map of the noise.
    start |= {"displacement_m": 4 * noise_m, "reach_m": 0.06 * way}
    return start, float(np.median(np.concatenate([move.speeds for move in moves if isinstance(move, AirMoves)])))


class _ScatterFit(NamedTuple):
    """The most likely scatter of some sizes."""

    cost: float  # -2 log likelihood
    x: Array  # logarithms of the sizes over those of the start
    scatter: StretchScatter


@dataclass(frozen=True)
class _ScatterLikelihood:
    """The restricted likelihood of a scatter by the residuals of stretches."""

    left: RestrictedResiduals
    moves: Sequence[Moves]
    noise: Noise
    start: Start
    max_displacement_m: float
    reaches_m: tuple[float, float]  # the shortest and the longest
    speed_m_s: float  # the median on air; 0 on a plate

    def cost(self, scatter: StretchScatter) -> float:
        """-2 log likelihood."""
        return replace(self.left, clips=add_moves(self.left.clips, self.moves, scatter)).cost(self.noise)

    def maximise(self, names: Sequence[str], x: Array | None = None, speed_power: int = 0) -> _ScatterFit:
        """Find the most likely sizes of these names; x: where to start the first of them."""

        def price(x: Array) -> float:
            return self.cost(self._build(names, x, speed_power))

        x = np.zeros(0) if x is None else x
        x = minimise_cost(price, np.pad(x, (0, len(names) - len(x))))
        return _ScatterFit(finite_cost(price, x), x, self._build(names, x, speed_power))

    def maximise_on_air(self, least_gain: float) -> _ScatterFit:
        """Find the most likely accelerations with their power of the speed, and displacements if they gain enough.

        Without displacements, accelerations shorter than a frame take their place. From there no descent leads back to
        long ones, so the fit with displacements starts anew.
        """
        best = self.maximise(ON_AIR)
        for power in SPEED_POWERS[1:]:
            grown = self.maximise(ON_AIR, best.x, power)
            if not grown.cost < best.cost:
                break
            best = grown
        displaced = self.maximise([*ON_AIR, *DISPLACED], speed_power=best.scatter.speed_power)
        return displaced if displaced.cost < best.cost - least_gain else best

    def lengthen_tails(self, normal: StretchScatter, tails: TailLikelihood) -> StretchScatter:
        """The same scatter on air, or one with the tails of Student's t if that gains enough in likelihood.

        Sizes are fitted in the same way without tails and with them; they start from those of `normal`. Changes of the
        shared parameters follow from the fit before.
        """
        names = [n for n in (*ON_AIR, *DISPLACED) if getattr(normal, n)]
        found, x = normal, np.log([getattr(normal, n) / self.start[n] for n in names])
        costs = list[float]()  # without tails, then with longer and longer ones
        for freedom in (0.0, *FREEDOMS):
            tried = replace(found, freedom=freedom)
            for _ in range(2):
                shared = tails.find_multiples(tried)[1]

                def price(x: Array, freedom: float = freedom, shared: Array = shared) -> float:
                    scatter = self._build(names, x, normal.speed_power)
                    return tails.cost(replace(scatter, freedom=freedom), shared)

                x = minimise_cost(price, x)
                tried = replace(self._build(names, x, normal.speed_power), freedom=freedom)
            cost = tails.cost(tried, tails.find_multiples(tried)[1])
            if costs and not cost < costs[-1]:
                break
            found = tried
            costs.append(cost)
        return found if costs[-1] < costs[0] - current_policy().min_noise_gain - 2 else normal

    def drop_negligible(self, scatter: StretchScatter) -> StretchScatter:
        """The same scatter without sizes that are far below those of the start."""
        sizes = [n for n in ("friction", "loss_m_s2", "across_m_s2", "displacement_m") if n in self.start]
        silent: dict[str, Any] = {n: 0.0 for n in sizes if getattr(scatter, n) < 0.02 * self.start[n]}
        return replace(scatter, **silent)

    def _build(self, names: Sequence[str], x: Array, speed_power: int) -> StretchScatter:
        """The scatter with these logarithms of sizes over those of the start."""
        logs = dict(zip(names, np.clip(x, -MAX_LOG_GROWTH, MAX_LOG_GROWTH).tolist(), strict=True))
        values = {name: self.start[name] * float(np.exp(log)) for name, log in logs.items()}
        unlimited = tuple(n for n in ("friction", "loss_m_s2", "across_m_s2") if logs.get(n, 0.0) == MAX_LOG_GROWTH)
        if "displacement_m" in names:
            shortest, longest = self.reaches_m
            values["displacement_m"] = min(values["displacement_m"], self.max_displacement_m)
            values["reach_m"] = min(max(values["reach_m"], shortest), longest)
        return StretchScatter(**values, speed_power=speed_power, speed_m_s=self.speed_m_s, unlimited=unlimited)


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
