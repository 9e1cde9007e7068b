"""Compute the ranges that the tracks cover, and the axes of free laws over them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import T_C, B
from synthcam.dynamics.batch import solve_collisions
from synthcam.dynamics.kinematics import contact_velocity
from synthcam.model import Model
from synthcam_shared.arrays import Array


@dataclass(frozen=True)
class Axis:
    """The quantity that a free law depends on, with the series over it: smooth terms, as the integration of motion
    requires.

    kind: "line", cosines over 1.2 times the range, so that the slope at its ends is free; "circle", sines and cosines
    of an angle, rad; "set", a number for each clip.
    """

    name: str
    unit: str
    low: float  # end of the covered range, as is high
    high: float
    count: int  # coefficients
    kind: str = "line"
    letter: str = ""  # for formulas

    @property
    def _waves(self) -> Array:
        """Wave numbers, (count,)."""
        if self.kind == "circle":
            return np.asarray((np.arange(self.count) + 1) // 2, dtype=float)
        return np.asarray(np.arange(self.count) * np.pi / (1.2 * max(self.high - self.low, 1e-12)), dtype=float)

    def basis(self, x: Any) -> Array:
        """Evaluate all terms at x, (..., count)."""
        x = np.asarray(x)[..., None]
        if self.kind == "set":
            return np.asarray(x == np.arange(self.count), dtype=float)
        if self.kind == "circle":
            return np.asarray(np.cos(self._waves * x - np.pi / 2 * (np.arange(self.count) % 2)))
        start = (self.low + self.high) / 2 - 1.2 * (self.high - self.low) / 2
        return _cosines(self._waves[1] * (x[..., 0] - start), self.count)

    def prior_variances(self, length: float) -> Array:
        """Prior variances (count,) of the coefficients of a curve whose own variance is about one.

        They are the spectrum of a Gaussian process with a squared exponential covariance: Solin & Saerkkae, Statistics
        and Computing 30 (2020) 419. length: over which the curve changes, in ranges or in radians.
        """
        if self.kind == "set":
            return np.ones(self.count)
        range_ = 1.0 if self.kind == "circle" else self.high - self.low
        out = np.exp(-((self._waves * length * range_) ** 2) / 2) + 1e-6  # no coefficient is excluded
        return np.asarray(out / out.sum())

    def grid(self, count: int) -> Array:
        """Evenly spaced coordinates (count,) over the range, or every member of a set."""
        if self.kind == "set":
            return np.arange(self.count, dtype=float)
        return np.linspace(self.low, self.high, count)


def _cosines(angle: Array, count: int) -> Array:
    """cos(k angle), (..., count), by Chebyshev's recurrence, which is ten times faster than as many cosines."""
    out = np.ones((count, *angle.shape))
    out[1] = np.cos(angle)
    twice = 2 * out[1]
    for k in range(2, count):
        out[k] = twice * out[k - 1] - out[k - 2]
    return np.moveaxis(out, 0, -1)


@dataclass(frozen=True)
class CoveredRanges:
    """The motion of a fit, sampled and flattened over clips and instants, of both balls or of one ball; m and m/s."""

    launches: Array  # (clips, p), columns as in `discrepancy.data.launch`
    clips: Sequence[MeasuredCollision]
    slips: Array  # (m,): contact speeds while sliding
    slip_places: Array  # (m, 2)
    places: Array  # (p, 2), of moving balls; velocities and speeds too
    velocities: Array
    speeds: Array  # (p,)
    roll_speeds: Array  # (q,): while rolling
    roll_places: Array  # (q, 2)


def compute_ranges(model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> dict[str, CoveredRanges]:
    """Compute the ranges that the motion of a fit covers, by ball: "" for both together, "a" and "b"."""
    samples = 300  # instants, evenly spaced over the longest clip, or over each stretch
    min_speed = 1e-5  # m/s; a ball that is slower rests, and one whose contact point is slower rolls
    free = np.array([c.is_stretch for c in clips])
    first = np.array([int(c.frame.min()) / c.fps for c in clips])
    last = np.array([(int(c.frame.max()) + 1) / c.fps for c in clips])
    first = np.where(free, launches[:, T_C], min(first.min(), launches[:, T_C].min()))
    last = np.where(free, last, last.max())
    times = np.linspace(first, last, samples, axis=1)
    a_strikes = np.array([c.striker == "a" for c in clips])
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        motion = solve_collisions(model, launches, first.min(), last.max(), a_strikes, last)
        states = np.nan_to_num(motion.at(np.tile(times, (2, 1))))
    slip = np.hypot(*np.moveaxis(contact_velocity(states, model.ball.radius), -1, 0))
    place, velocity = states[..., :2], states[..., 3:5]

    def cover(slip: Array, velocity: Array, place: Array) -> CoveredRanges:
        speed = np.hypot(velocity[..., 0], velocity[..., 1])
        slides, moves = slip > min_speed, speed > min_speed
        rolls = moves & ~slides
        return CoveredRanges(
            launches=launches,
            clips=clips,
            slips=slip[slides],
            slip_places=place[slides],
            places=place[moves],
            velocities=velocity[moves],
            speeds=speed[moves],
            roll_speeds=speed[rolls],
            roll_places=place[rolls],
        )

    is_a = np.stack([~a_strikes, a_strikes])
    rows = {"": np.ones_like(is_a), "a": is_a, "b": ~is_a}
    return {ball: cover(slip[own], velocity[own], place[own]) for ball, own in rows.items()}


def over_range(
    name: str, letter: str, values: Array, low: float | None = None, unit: str = "m/s", count: int = 20
) -> tuple[Axis, ...]:
    """Make the axis of a curve over covered values (n,), from the least of them or from `low`; empty without values.

    The 20 cosines resolve a step of a tenth of the range; the prior decides how many of them count.
    """
    if not len(values):
        return ()
    least = float(values.min()) if low is None else low
    return (Axis(name, unit, least, float(values.max()), count, letter=letter),)


def over_heading(values: Array | None = None, count: int = 9) -> tuple[Axis, ...]:
    """Make the axis of a curve over all directions, rad, up to the fourth harmonic; empty if `values` is."""
    if values is not None and not len(values):
        return ()
    return (Axis("heading", "rad", -np.pi, np.pi, count, "circle", "th"),)


def over_obliqueness(covered: CoveredRanges) -> tuple[Axis, ...]:
    """Make the axis of a curve over the covered |b|, the size of the impact parameter, from 0 to at least 0.1."""
    return over_range("obliqueness", "|b|", np.append(np.abs(covered.launches[:, B]), 0.1), 0.0, unit="1")


def over_clips(count: int) -> tuple[Axis, ...]:
    """Make the axis of a number for each clip; none for more than 120 clips, whose fit would take too long."""
    return (Axis("clip", "1", 0.0, count - 1.0, count, "set"),) if count <= 120 else ()


def over_plane(values: Array, unit: str = "m", count: int = 8) -> tuple[Axis, ...]:
    """Make two axes of a map over covered vectors (n, 2), with `count` coefficients a side; empty without vectors."""
    if not len(values):
        return ()
    ends = zip("xy", values.min(axis=0).tolist(), values.max(axis=0).tolist(), strict=True)
    return tuple(Axis(name, unit, low, high, count) for name, low, high in ends)
