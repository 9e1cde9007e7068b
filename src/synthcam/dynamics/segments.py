"""Segments of motion of many balls at once: states at given times and mean positions over exposures.

Each class holds balls that move in one way (at rest, sliding, rolling, flying, integrated). A `CollisionBatch` is a
list of such segments.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from synthcam.dynamics.integrated_motion import IntegratedMotion, snap_to_goal
from synthcam.dynamics.kinematics import Real, contact_velocity, fly, integrate_drag, roll, slide
from synthcam.dynamics.trajectory import Trajectory
from synthcam_shared.arrays import Array, Flags, Index


class PackedRows:
    """The true entries of a mask (k, m) packed to the left, so that each row's work is done and no other.

    inside : (k, most in a row) bool array
        Which entries of the packed array are in use.
    any : bool
        Whether the mask has a true entry.
    """

    def __init__(self, mask: Flags) -> None:
        counts = mask.sum(axis=1)
        most = int(counts.max()) if len(counts) else 0
        self.mask, self.any = mask, most > 0
        self.inside = np.arange(most) < counts[:, None]

    def gather(self, values: Array) -> Array:
        """Pack values (k, m) into (k, most in a row); zeros fill the shorter rows."""
        out = np.zeros(self.inside.shape)
        out[self.inside] = values[self.mask]
        return out


@dataclass(frozen=True)
class Segment(ABC):
    """Balls `who` (k,) from the times `begins` to `ends`, (k,). All methods take times within these."""

    who: Index
    begins: Array
    ends: Array

    @property
    def aloft(self) -> bool:
        """Tell whether a ball may be off the plate."""
        return False

    @abstractmethod
    def states(self, times: Array) -> Array:
        """Return states (k, m, 9) at times (k, m)."""

    @abstractmethod
    def average_centres(self, middle: Array, wide: Real) -> Array:
        """Average the centres, (2, k, m), over spans of the width `wide`, a number or (k, m), about `middle` (k, m)."""


@dataclass(frozen=True)
class RestSegment(Segment):
    """Balls at rest in `state` (k, 9)."""

    state: Array

    def states(self, times: Array) -> Array:
        return np.repeat(self.state[:, None], times.shape[1], axis=1)

    def average_centres(self, middle: Array, wide: Real) -> Array:
        return np.broadcast_to(self.state[:, :2].T[..., None], (2, *middle.shape))


@dataclass(frozen=True)
class SlideSegment(Segment):
    """Slides in closed form, parabolas, from the states `state` (k, 9) at `begins`; slowing (k,): mu g, m/s^2."""

    state: Array
    radius: Array
    slowing: Array
    inertia: Array

    def states(self, times: Array) -> Array:
        return slide(self.state, self.radius, self.slowing, times - self.begins[:, None], self.inertia)

    def average_centres(self, middle: Array, wide: Real) -> Array:
        t, u = middle - self.begins[:, None], contact_velocity(self.state, self.radius)
        bend = -0.5 * (self.slowing / np.hypot(u[:, 0], u[:, 1]))[:, None] * u
        x, v, bend = (_with_axes_first(a) for a in (self.state[:, :2], self.state[:, 3:5], bend))
        return np.asarray(x + (v + bend * t) * t + bend * (wide * wide / 12))


@dataclass(frozen=True)
class RollSegment(Segment):
    """Straight rolls in closed form; the balls are in `state` (k, 9), not at rest, at `time` (k,).

    drag, decel: one number for all balls, or (k,).
    """

    time: Array
    state: Array
    radius: Array
    drag: Real
    decel: Real

    def states(self, times: Array) -> Array:
        return roll(self.state, self.radius, self.drag, self.decel, times - self.time[:, None])

    def average_centres(self, middle: Array, wide: Real) -> Array:
        slowing = (self.decel / np.hypot(self.state[:, 3], self.state[:, 4]))[:, None]
        drag = self.drag[:, None] if isinstance(self.drag, np.ndarray) else self.drag
        decay, slack = integrate_drag(drag, middle - self.time[:, None])
        path = decay - slowing * slack
        z = drag * wide / 2  # the mean of an exponential is sinh(z)/z times that in the middle
        mean = wide * wide / 24 * (1 + z * z / 20 * (1 + z * z / 42 * (1 + z * z / 72)))
        path -= (drag + slowing) * (1 - drag * decay) * mean
        return np.asarray(_with_axes_first(self.state[:, :2]) + path * _with_axes_first(self.state[:, 3:5]))


@dataclass(frozen=True)
class FlightSegment(Segment):
    """Free flights from `state` (k, 9) at `begins`."""

    state: Array
    gravity: float
    aloft = True

    def states(self, times: Array) -> Array:
        return fly(self.state, self.gravity, times - self.begins[:, None])

    def average_centres(self, middle: Array, wide: Real) -> Array:
        x, v = _with_axes_first(self.state[:, :2]), _with_axes_first(self.state[:, 3:5])
        return np.asarray(x + v * (middle - self.begins[:, None]))


@dataclass(frozen=True)
class IntegratedSegment(Segment):
    """Motion without closed form, integrated numerically."""

    motion: IntegratedMotion

    @classmethod
    def of(cls, who: Index, motion: IntegratedMotion, goal: Array | float) -> list[Self]:
        """Make a segment of each piece of a motion towards the time `goal`, which some reach but for rounding."""
        knots, parts = motion.split_pieces()
        knots = snap_to_goal(knots, goal)
        spans = zip(np.minimum(knots[:-1], knots[1:]), np.maximum(knots[:-1], knots[1:]), parts, strict=True)
        return [cls(who, *span) for span in spans]

    @property
    def aloft(self) -> bool:
        return bool(self.motion.airborne.any())

    def states(self, times: Array) -> Array:
        return self.motion.at(times)

    def average_centres(self, middle: Array, wide: Real) -> Array:
        return self.motion.average_centres(middle, wide)


@dataclass(frozen=True)
class TrajectorySegment(Segment):
    """One ball whose whole motion the event loop of `solve` has found."""

    motion: Trajectory
    aloft = True

    def states(self, times: Array) -> Array:
        return self.motion.at(times[0])

    def average_centres(self, middle: Array, wide: Real) -> Array:
        half = wide / 2 + 0 * middle[0]
        spans = np.clip(np.stack([middle[0] - half, middle[0] + half], axis=1), self.motion.t0, self.motion.t1)
        return np.asarray(self.motion.average(spans, lambda states: states[..., :2])[0].T[:, None])


def _with_axes_first(vectors: Array) -> Array:
    """Turn (k, 2) into (2, k, 1)."""
    return np.asarray(vectors.T[..., None])


def split_segment(segment: Segment, most: int) -> list[Segment]:
    """Split a segment into segments of at most so many balls; an integrated one stays whole."""
    count = len(segment.who)
    if count <= most or isinstance(segment, IntegratedSegment):
        return [segment] if count else []
    of_balls = {f.name: v for f in fields(segment) if isinstance(v := getattr(segment, f.name), np.ndarray)}
    rows = [slice(k, k + most) for k in range(0, count, most)]
    return [replace(segment, **{name: values[some] for name, values in of_balls.items()}) for some in rows]


def drop_balls(segment: Segment, gone: Flags) -> Segment:
    """Empty a segment of the balls that are `gone`: no time is left in it for them."""
    return replace(segment, ends=np.where(gone, segment.begins, segment.ends)) if np.any(gone) else segment


def write_states(segment: Segment, times: Array, out: Array, part: slice) -> None:
    """Write a part of the states of a segment's balls into `out` (2n, m, ...), at the times (2n, m) within it."""
    mine, begins, ends = times[segment.who], segment.begins[:, None], segment.ends[:, None]
    here = PackedRows((mine >= begins) & (mine <= ends))
    if here.any:
        states = segment.states(np.clip(here.gather(mine), begins, ends))
        rows, columns = np.nonzero(here.mask)
        out[segment.who[rows], columns] = states[here.inside, part]
