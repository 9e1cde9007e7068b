"""Exact motion: legs between events, and the trajectory they make up."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from synthcam.dynamics import kinematics
from synthcam.dynamics.kinematics import State

Array = NDArray[np.float64]
Motion = Literal["rest", "roll", "slide", "fly"]
GAUSS = 4  # nodes a span: exact for a parabola, 1e-15 m for a roll
CLOSE = 32  # likewise, where an event cuts or follows: the friction before a slide's end may change all but suddenly


class Leg(Protocol):
    """Motion of one ball without an event, from t0 to t1 (which may be infinite)."""

    @property
    def t0(self) -> float: ...

    @property
    def t1(self) -> float: ...

    @property
    def motion(self) -> Motion: ...

    def at(self, t: Array) -> Array:
        """States (len(t), 9) at times within the leg."""

    def now(self, t: float) -> State:
        """The state at one instant, nine floats."""

    def bound(self, t: float) -> float:
        """No acceleration after t within the leg is larger, m/s^2."""

    def spanning(self, t0: float, t1: float) -> Leg:
        """The same motion, between other times."""


class Rest(NamedTuple):
    """A ball that stays where it is; it may spin about the vertical. state: nine floats, here and below."""

    t0: float
    t1: float
    state: State
    motion: Motion = "rest"

    def at(self, t: Array) -> Array:
        return np.broadcast_to(np.array(self.state), (len(t), 9))

    def now(self, t: float) -> State:
        return self.state

    def bound(self, t: float) -> float:
        return 0.0

    def spanning(self, t0: float, t1: float) -> Rest:
        return self._replace(t0=t0, t1=t1)


class Roll(NamedTuple):
    """Rolling on a straight line with the loss a = -(drag v + decel); `time` is when `state` holds."""

    t0: float
    t1: float
    time: float
    state: State
    radius: float
    drag: float
    decel: float
    motion: Motion = "roll"

    def at(self, t: Array) -> Array:
        return kinematics.roll(np.array(self.state), self.radius, self.drag, self.decel, t - self.time)

    def now(self, t: float) -> State:
        return kinematics.after_rolling(self.state, self.radius, self.drag, self.decel, t - self.time)

    def bound(self, t: float) -> float:
        return float(self.drag * math.hypot(*self.now(t)[3:5]) + self.decel)

    def spanning(self, t0: float, t1: float) -> Roll:
        return self._replace(t0=t0, t1=t1)


class Slide(NamedTuple):
    """Sliding with constant friction: a parabola. `state` holds at `time`; `slowing` is mu g, m/s^2."""

    t0: float
    t1: float
    time: float
    state: State
    radius: float
    slowing: float
    motion: Motion = "slide"

    def at(self, t: Array) -> Array:
        return kinematics.slide(np.array(self.state), self.radius, self.slowing, t - self.time)

    def now(self, t: float) -> State:
        return kinematics.after_sliding(self.state, self.radius, self.slowing, t - self.time)

    def bound(self, t: float) -> float:
        return self.slowing

    def spanning(self, t0: float, t1: float) -> Slide:
        return self._replace(t0=t0, t1=t1)


class Fly(NamedTuple):
    """Free flight above the plate; `state` holds at `time`."""

    t0: float
    t1: float
    time: float
    state: State
    gravity: float
    motion: Motion = "fly"

    def at(self, t: Array) -> Array:
        return kinematics.fly(np.array(self.state), self.gravity, t - self.time)

    def now(self, t: float) -> State:
        return kinematics.after_flight(self.state, self.gravity, t - self.time)

    def bound(self, t: float) -> float:
        return self.gravity

    def spanning(self, t0: float, t1: float) -> Fly:
        return self._replace(t0=t0, t1=t1)


class Numeric(NamedTuple):
    """A leg without closed form: `states` maps times (m,) to states (m, 9)."""

    t0: float
    t1: float
    motion: Motion
    states: Callable[[Array], Array]
    steepest: float

    @classmethod
    def of(cls, t0: float, t1: float, motion: Motion, states: Callable[[Array], Array], lift: float = 0.0) -> Numeric:
        """No acceleration is larger than twice the largest found between samples, and a vertical `lift`."""
        times = np.linspace(t0, t1, 65)
        v = states(times)[:, 3:5]
        steepest = 2 * np.max(np.linalg.norm(np.diff(v, axis=0), axis=1)) / max(abs(t1 - t0) / 64, 1e-300)
        return cls(t0, t1, motion, states, lift + float(steepest))

    def at(self, t: Array) -> Array:
        return self.states(t)

    def now(self, t: float) -> State:
        return tuple(self.states(np.array([t]))[0].tolist())

    def bound(self, t: float) -> float:
        return self.steepest

    def spanning(self, t0: float, t1: float) -> Numeric:
        return self._replace(t0=t0, t1=t1)


@dataclass(frozen=True)
class Event:
    """Something that happens at one instant. before, after: states (2, 9) of balls i, j, or (1, 9) of i alone.

    n: unit vector (its horizontal part) from ball j's centre to ball i's, at a contact. impulse_n along n, impulse_t
    along t = z x n: on ball i, N s.
    """

    t: float
    kind: Literal["contact", "slide_end", "stop", "start", "land"]
    i: int
    j: int = -1
    before: Array | None = None
    after: Array | None = None
    n: tuple[float, float] = (np.nan, np.nan)
    impulse_n: float = np.nan
    impulse_t: float = np.nan


@dataclass(frozen=True)
class Trajectory:
    """The motion of all balls from t0 to t1. legs[i]: ball i's, in order; events in order of time."""

    t0: float
    t1: float
    legs: tuple[tuple[Leg, ...], ...]
    events: tuple[Event, ...]

    def at(self, t: ArrayLike) -> Array:
        """States (balls, len(t), 9) at any times; just after the event where one falls on an event.

        Raises ValueError outside [t0, t1].
        """
        times = np.atleast_1d(np.asarray(t, dtype=float))
        self._check(times)
        out = np.empty((len(self.legs), len(times), 9))
        for ball, legs in enumerate(self.legs):
            which = self._which(legs, times)
            for k in np.unique(which):
                here = which == k
                out[ball, here] = legs[k].at(times[here])
        return out

    def motion(self, t: ArrayLike) -> NDArray[np.str_]:
        """rest, roll, slide or fly: shape (balls, len(t))."""
        times = np.atleast_1d(np.asarray(t, dtype=float))
        self._check(times)
        return np.array([[legs[k].motion for k in self._which(legs, times)] for legs in self.legs])

    def average(self, spans: Array, of: Callable[[Array], Array]) -> Array:
        """Means over time spans (n, 2) of a function of the states: (balls, n, k).

        `of` maps states (balls, m, 9) to (balls, m, k). Gauss quadrature, split where an event falls into a span.
        """
        breaks = np.array([e.t for e in self.events])
        return average_over_spans(lambda t: self.at(np.clip(t, self.t0, self.t1)), breaks, spans, of)

    def first(self, kind: str, ball: int = -1, after: float = -np.inf) -> Event | None:
        """The first event of a kind (that ball i = `ball` suffers, if given) after a time."""
        for e in self.events:
            if e.kind == kind and e.t >= after and ball in (-1, e.i):
                return e
        return None

    def _check(self, times: Array) -> None:
        if not np.all((times >= self.t0) & (times <= self.t1)):
            raise ValueError(f"time outside the trajectory, {self.t0:g} s to {self.t1:g} s")

    @staticmethod
    def _which(legs: tuple[Leg, ...], times: Array) -> NDArray[np.intp]:
        return np.searchsorted([leg.t0 for leg in legs[1:]], times, side="right")


def average_over_spans(
    at: Callable[[Array], Array], breaks: Array, spans: Array, of: Callable[[Array], Array]
) -> Array:
    """Means over time spans (n, 2) of a function of the states `at` gives: (balls, n, k); see Trajectory.average."""
    after = 2 * spans[:, 1] - spans[:, 0]
    near = np.searchsorted(breaks, spans[:, 0], "right") < np.searchsorted(breaks, after, "left")
    cuts, owners = [], []
    for k in np.flatnonzero(near):
        a, b = spans[k]
        inner = np.concatenate([[a], breaks[(breaks > a) & (breaks < b)], [b]])
        cuts.append(np.stack([inner[:-1], inner[1:]], axis=1))
        owners.append(np.full(len(inner) - 1, k))
    smooth = _means(at, spans[~near], of, GAUSS)
    out = np.zeros((len(smooth), len(spans), smooth.shape[-1]))
    out[:, ~near] = smooth
    if np.any(near):
        pieces, owner = np.concatenate(cuts), np.concatenate(owners)
        width, whole = np.diff(pieces), np.diff(spans)[owner]
        parts = _means(at, pieces, of, CLOSE) * np.where(whole > 0, width / np.where(whole > 0, whole, 1), 1.0)
        for ball in range(len(out)):
            np.add.at(out[ball], owner, parts[ball])
    return out


def _means(at: Callable[[Array], Array], spans: Array, of: Callable[[Array], Array], count: int) -> Array:
    """Over smooth spans (n, 2), by Gauss quadrature: (balls, n, k)."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    times = spans.mean(axis=1)[:, None] + np.diff(spans) / 2 * nodes
    found = of(at(times.ravel()))
    found = found.reshape(len(found), *times.shape, found.shape[-1])
    return np.asarray(np.einsum("bmnk,n->bmk", found, weights / 2))
