"""Moves of a free stretch by what differs from stretch to stretch, and the covariance of its positions by them.

A body that glides on air has no friction that holds it to a law. It may touch the plate for part of a stretch, and then
it loses speed and changes course. So both its loss and its acceleration across the motion are random, and they change
with time: they are Ornstein-Uhlenbeck processes (Uhlenbeck & Ornstein, Phys. Rev. 36 (1930) 823), whose size is
proportional to a power of the speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtri

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import X, Y
from discrepancy.fitting.jacobian import differentiate_launches, differentiate_tracks
from synthcam.model import Model
from synthcam_shared.arrays import Array

ON_PLATE = ("friction", "loss_m_s2")
ON_AIR = ("loss_m_s2", "across_m_s2", "lasts_s")
DISPLACED = ("displacement_m", "reach_m")
MAX_LOG_GROWTH = 7.0  # of a size, over the one from which its fit starts


@dataclass(frozen=True)
class StretchScatter:
    """Standard deviations of what differs from stretch to stretch; zero where nothing does."""

    friction: float = 0.0  # of the sliding friction, relative
    loss_m_s2: float = 0.0  # of the rolling loss; on air of the loss at `speed_m_s`
    displacement_m: float = 0.0  # of each axis, as of a camera's map
    reach_m: float = 0.0  # over which a displacement stays the same
    map_log_ratio: float = 0.0  # log likelihood ratio of displacements by one map to new ones in each stretch
    # The others are only of bodies that glide on air.
    across_m_s2: float = 0.0  # of the acceleration across the motion, at `speed_m_s`
    lasts_s: float = 0.0  # the time in which the correlation of either acceleration with itself falls by a factor e
    speed_power: int = 0  # the power of the speed to which both accelerations are proportional
    speed_m_s: float = 0.0  # the median speed
    # Degrees of freedom of Student's t, by which both accelerations of a stretch are larger or smaller than those of
    # others; 0: they are normal, and as large in all.
    freedom: float = 0.0
    unlimited: tuple[str, ...] = ()  # sizes with the largest value that the fit allows, because no data limit them
    is_displaced_most: bool = False  # true if the displacements are the largest that the fit allows

    @property
    def is_none(self) -> bool:
        """True if nothing differs."""
        return not (self.friction or self.loss_m_s2 or self.across_m_s2 or self.displacement_m)

    @property
    def is_implausible(self) -> bool:
        """True if it is so large that the model seems to lack motion.

        Either the displacements are the largest that the fit allows, or 3 standard deviations less than the mean
        friction is below zero.
        """
        return self.is_displaced_most or self.friction > 1 / 3

    def without_tails(self) -> StretchScatter:
        """The normal scatter with the accelerations of the median stretch, if the tails are those of Student's t."""
        if not self.freedom:
            return self
        factor = math.sqrt(self.freedom / float(chdtri(self.freedom, 0.5)))
        return replace(self, loss_m_s2=factor * self.loss_m_s2, across_m_s2=factor * self.across_m_s2, freedom=0.0)

    def is_close_to(self, other: StretchScatter, tolerance: float = 0.15) -> bool:
        """True if no size differs from the other's by more than this share of the larger one."""
        pairs = ((getattr(self, name), getattr(other, name)) for name in {*ON_PLATE, *ON_AIR, *DISPLACED})
        same_law = self.speed_power == other.speed_power and bool(self.freedom) == bool(other.freedom)
        return same_law and all(abs(a - b) <= tolerance * max(a, b) for a, b in pairs)


NO_SCATTER = StretchScatter()


@dataclass(frozen=True)
class ScatterSizes:
    """The sizes from which a fit of the scatter starts, by name, and their limits."""

    start: Mapping[str, float]
    max_displacement_m: float
    reaches_m: tuple[float, float]  # the shortest and the longest
    speed_m_s: float  # the median on air; 0 on a plate

    def build(self, names: Sequence[str], x: Array, speed_power: int = 0) -> StretchScatter:
        """The scatter whose sizes of these names have these logarithms over those of the start."""
        logs = dict(zip(names, np.clip(x, -MAX_LOG_GROWTH, MAX_LOG_GROWTH).tolist(), strict=True))
        values: dict[str, Any] = {name: self.start[name] * float(np.exp(log)) for name, log in logs.items()}
        unlimited = tuple(n for n in ("friction", "loss_m_s2", "across_m_s2") if logs.get(n, 0.0) == MAX_LOG_GROWTH)
        most = "displacement_m" in names and values["displacement_m"] >= self.max_displacement_m
        if "displacement_m" in names:
            shortest, longest = self.reaches_m
            values["displacement_m"] = min(values["displacement_m"], self.max_displacement_m)
            values["reach_m"] = min(max(values["reach_m"], shortest), longest)
        values |= {"speed_power": speed_power, "speed_m_s": self.speed_m_s}
        return StretchScatter(**values, unlimited=unlimited, is_displaced_most=most)

    def drop_negligible(self, scatter: StretchScatter) -> StretchScatter:
        """The same scatter without sizes that are far below those of the start."""
        sizes = [n for n in ("friction", "loss_m_s2", "across_m_s2", "displacement_m") if n in self.start]
        silent: dict[str, Any] = {n: 0.0 for n in sizes if getattr(scatter, n) < 0.02 * self.start[n]}
        return replace(scatter, **silent)


def correlate_displacements(one: Array, other: Array, scatter: StretchScatter) -> Array:
    """The covariance (n, k) of the displacements of one axis at positions (n, 2) and (k, 2), m^2."""
    apart = ((one[:, None] - other) ** 2).sum(axis=-1)
    return np.asarray(scatter.displacement_m**2 * np.exp(-apart / (2 * scatter.reach_m**2)))


@dataclass(frozen=True)
class PlateMoves:
    """Displacements (2n, 2) of a ball on a plate, m: by twice the friction, and by a further loss of 1 m/s^2."""

    by_loss: Array

    def spread(self, scatter: StretchScatter) -> Array:
        """The covariance (2n, 2n), m^2."""
        columns = self.by_loss * [scatter.friction, scatter.loss_m_s2]
        return np.asarray(columns @ columns.T)


@dataclass(frozen=True)
class AirMoves:
    """Displacements (2n, n) of a body on air, m, by 1 m/s^2 at each of its times, along the motion and across it."""

    times: Array  # (n,) s
    speeds: Array  # (n,) m/s
    along: Array
    across: Array

    @classmethod
    def of(cls, clip: MeasuredCollision, image: Array) -> AirMoves:
        """Integrate twice. Velocities are those of a parabola through the measured positions.

        The model's own path would not do: where accelerations scatter much, its fit hardly holds to the positions.
        image (n, 2, 2): derivatives of positions by those on the plate, which a lens of the model changes.
        """
        times = clip.frame / clip.fps
        curve, slope, _ = np.polyfit(times, clip.xy, 2)
        velocity = np.linalg.solve(image, (2 * times[:, None] * curve + slope)[..., None])[..., 0]
        speeds = np.maximum(np.hypot(*velocity.T), 1e-9)
        ahead = velocity / speeds[:, None]
        left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
        since = np.maximum(times[:, None] - times, 0.0) * np.gradient(times)
        both = (image @ (since[:, None] * way.T) for way in (ahead, left))  # (n, 2, n)
        along, across = (moves.reshape(2 * len(times), -1) for moves in both)
        return cls(times, speeds, along, across)

    def spread(self, scatter: StretchScatter) -> Array:
        """The covariance (2n, 2n), m^2."""
        grown = (self.speeds / scatter.speed_m_s) ** scatter.speed_power
        kernel = np.exp(-np.abs(self.times[:, None] - self.times) / scatter.lasts_s) * np.outer(grown, grown)
        both = ((scatter.loss_m_s2, self.along), (scatter.across_m_s2, self.across))
        return np.asarray(sum(size**2 * moves @ kernel @ moves.T for size, moves in both))

    def project(self, rows: Array) -> AirMoves:
        """The moves of combinations of the coordinates, rows (k, 2n), so that their covariance is (k, k)."""
        return replace(self, along=rows @ self.along, across=rows @ self.across)

    def grow(self, factor: float) -> AirMoves:
        """The moves by accelerations that are larger by a factor."""
        return replace(self, along=factor * self.along, across=factor * self.across)


Moves = PlateMoves | AirMoves


def find_moves(clips: Sequence[MeasuredCollision], model: Model, launches: Array) -> list[Moves]:
    """Find how friction, loss and acceleration of its own displace each stretch."""
    if not model.sliding_friction:
        _, slopes = differentiate_launches(model, launches, clips)
        return [AirMoves.of(clip, own[..., [X, Y]]) for clip, own in zip(clips, slopes, strict=True)]
    friction = differentiate_tracks(model, launches, clips, "sliding_friction")
    loss = differentiate_tracks(model, launches, clips, "rolling_decel")
    both = zip(friction, loss, strict=True)
    return [PlateMoves(np.stack([f * model.sliding_friction, d], axis=-1).reshape(-1, 2)) for f, d in both]


def add_moves(
    clips: Sequence[MeasuredCollision], moves: Sequence[Moves], scatter: StretchScatter
) -> list[MeasuredCollision]:
    """The clips with this scatter in the covariance of their positions, instead of any other."""
    out = list[MeasuredCollision]()
    for clip, move in zip(clips, moves, strict=True):
        n = len(clip.frame)
        moved = scatter.friction or scatter.loss_m_s2 or scatter.across_m_s2
        total = (move.spread(scatter) if moved else np.zeros((2 * n, 2 * n))).reshape(n, 2, n, 2)
        if scatter.displacement_m:
            kernel = correlate_displacements(clip.xy, clip.xy, scatter)
            for axis in range(2):
                total[:, axis, :, axis] += kernel
        out.append(replace(clip, scatter=total))
    return out
