"""The motion of a run: legs between events, and the trajectory that they make up."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from synthcam.dynamics import kinematics
from synthcam.dynamics.kinematics import Real, State
from synthcam_shared.arrays import Array, Index, list_gauss_nodes

ArrayFunction = Callable[[Array], Array]
Motion = Literal["rest", "roll", "slide", "fly", "glide", "push"]
OneBodyEvent = Literal["wall", "slide_end", "stop", "start", "land", "launch", "release", "stretch"]
EventKind = Literal["contact", "contact_end", "together", "apart"] | OneBodyEvent


@dataclass(slots=True)
class Leg:
    """The motion of one ball between two of its events, from t0 to t1 (which may be infinite).

    A run makes several for each event, so legs are not frozen: that would take three times as long. Only the run that
    makes a leg changes it: it sets t0 and t1 to the events between which the leg holds.
    """

    t0: float
    t1: float
    motion: Motion = field(kw_only=True)
    is_straight: ClassVar[bool] = False  # the path, at any speed

    def at(self, t: Array) -> Array:
        """Return states (len(t), 9) at times within the leg."""
        raise NotImplementedError

    def now(self, t: float) -> State:
        """Return the state at one instant, nine floats."""
        raise NotImplementedError

    def bound(self, t: float) -> float:
        """Return an upper bound of the acceleration after t within the leg, m/s^2."""
        raise NotImplementedError


@dataclass(slots=True)
class RestLeg(Leg):
    """A ball at rest, which may spin about the vertical. state: nine floats, here and below."""

    state: State
    motion: Motion = field(default="rest", kw_only=True)
    is_straight: ClassVar[bool] = True

    def at(self, t: Array) -> Array:
        return np.broadcast_to(np.array(self.state), (len(t), 9))

    def now(self, t: float) -> State:
        return self.state

    def bound(self, t: float) -> float:
        return 0.0


@dataclass(slots=True)
class ClosedLeg(Leg):
    """Motion in closed form: `state` holds at `time`."""

    time: float
    state: State

    def at(self, t: Array) -> Array:
        state = kinematics.split_components(np.array(self.state))
        return kinematics.stack_components(self.after(state, t - self.time), t)

    def now(self, t: float) -> State:
        return self.after(self.state, t - self.time)

    def after(self, state: State, elapsed: Real) -> State:
        """Return what becomes of a state in a time, s; all are floats, or arrays that broadcast."""
        raise NotImplementedError


@dataclass(slots=True)
class RollLeg(ClosedLeg):
    """Rolling on a straight line with a = -(drag v + decel)."""

    radius: float
    drag: float
    decel: float
    motion: Motion = field(default="roll", kw_only=True)
    is_straight: ClassVar[bool] = True

    def after(self, state: State, elapsed: Real) -> State:
        return kinematics.after_rolling(state, self.radius, self.drag, self.decel, elapsed)

    def bound(self, t: float) -> float:
        state = self.state if t >= self.time else self.now(t)  # it slows down
        return self.drag * math.hypot(state[3], state[4]) + self.decel


@dataclass(slots=True)
class SlideLeg(ClosedLeg):
    """Sliding with constant friction: a parabola. `slowing` is mu g, m/s^2."""

    radius: float
    slowing: float
    inertia: float
    motion: Motion = field(default="slide", kw_only=True)
    _rates: tuple[float, float, float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        across, along = kinematics.find_slowing(self.state, self.radius, self.slowing)
        self._rates = across, along, 1 / self.inertia / self.radius

    def after(self, state: State, elapsed: Real) -> State:
        return kinematics.after_sliding(state, self.radius, self.slowing, elapsed, self.inertia)

    def now(self, t: float) -> State:
        return kinematics.after_slowing(self.state, *self._rates, t - self.time)

    def bound(self, t: float) -> float:
        return self.slowing


@dataclass(slots=True)
class FlightLeg(ClosedLeg):
    """Free flight above the plate."""

    gravity: float
    motion: Motion = field(default="fly", kw_only=True)

    def after(self, state: State, elapsed: Real) -> State:
        return kinematics.after_flight(state, self.gravity, elapsed)

    def bound(self, t: float) -> float:
        return self.gravity


@dataclass(slots=True)
class GlideLeg(ClosedLeg):
    """Gliding on air, v' = -(decel + drag v) v/|v| + curl z x v."""

    drag: float
    decel: float
    curl: float
    spin_drag: float
    motion: Motion = field(default="glide", kw_only=True)

    @classmethod
    def of(cls, t: float, state: State, decel: float, drag: float, curl: float, spin_drag: float) -> Self:
        """Glide from the time t, s, until the body stops."""
        lasts = kinematics.stop_time(math.hypot(state[3], state[4]), drag, decel)
        return cls(t, t + lasts, t, state, drag, decel, curl, spin_drag)

    def at(self, t: Array) -> Array:
        return kinematics.stack_components(self.after(self.state, t - self.time), t)

    def after(self, state: State, elapsed: Real) -> State:
        if self.motion == "rest":
            exp = np.exp if isinstance(elapsed, np.ndarray) else math.exp
            return (*state[:8], state[8] * exp(-self.spin_drag * elapsed))
        return kinematics.after_gliding(state, self.drag, self.decel, self.curl, self.spin_drag, elapsed)

    def bound(self, t: float) -> float:
        if self.motion == "rest":
            return 0.0
        state = self.state if t >= self.time else self.now(t)  # it slows down
        speed = math.hypot(state[3], state[4])
        return math.hypot(self.drag * speed + self.decel, self.curl * speed)


@dataclass(slots=True)
class PushLeg(ClosedLeg):
    """Moving with a constant acceleration (x, y), m/s^2, as a hand pushes.

    rolling_radius, m: the spin changes as that of a ball that rolls; infinite: it stays.
    """

    acceleration: tuple[float, float]
    rolling_radius: float
    motion: Motion = field(default="push", kw_only=True)

    def after(self, state: State, elapsed: Real) -> State:
        (x, y, z, vx, vy, vz, wx, wy, wz), (ax, ay), s = state, self.acceleration, elapsed
        place = x + (vx + ax * s / 2) * s, y + (vy + ay * s / 2) * s, z
        turn = s / self.rolling_radius
        return *place, vx + ax * s, vy + ay * s, vz, wx - ay * turn, wy + ax * turn, wz

    def bound(self, t: float) -> float:
        return math.hypot(*self.acceleration)


@dataclass(slots=True)
class CarriedLeg(Leg):
    """The motion of one of several bodies that move as one rigid body, whose centre of mass has the leg `centre`.

    offset: from the centre of mass at `time`, m. spin_drag: rate at which the common spin decays, 1/s.
    """

    centre: Leg
    time: float
    offset: tuple[float, float]
    height: float
    spin_drag: float

    def at(self, t: Array) -> Array:
        return kinematics.stack_components(self._around(tuple(self.centre.at(t).T), t), t)

    def now(self, t: float) -> State:
        return self._around(self.centre.now(t), t)

    def _around(self, centre: State, t: Real) -> State:
        x, y, _, vx, vy, _, _, _, wz = centre
        (dx, dy), elapsed = self.offset, t - self.time
        turned = self.centre.now(self.time)[8] * kinematics.integrate_drag(self.spin_drag, elapsed)[0]
        c, s = (np.cos(turned), np.sin(turned)) if isinstance(t, np.ndarray) else (math.cos(turned), math.sin(turned))
        ox, oy = c * dx - s * dy, s * dx + c * dy
        return x + ox, y + oy, self.height, vx - wz * oy, vy + wz * ox, 0.0, 0.0, 0.0, wz

    def bound(self, t: float) -> float:
        spin, far = abs(float(self.centre.now(t)[8])), math.hypot(*self.offset)
        return self.centre.bound(t) + (spin + self.spin_drag) * spin * far


@dataclass(slots=True)
class NumericLeg(Leg):
    """A leg without closed form: `states` maps times (m,) to states (m, 9); `steepest` bounds the acceleration."""

    states: ArrayFunction
    steepest: float

    @classmethod
    def of(cls, t0: float, t1: float, motion: Motion, states: ArrayFunction, lift: float = 0.0) -> Self:
        """Bound the acceleration by twice the largest one found between 65 samples, plus a vertical `lift`."""
        times = np.linspace(t0, t1, 65)
        v = states(times)[:, 3:5]
        steepest = 2 * np.max(np.linalg.norm(np.diff(v, axis=0), axis=1)) / max(abs(t1 - t0) / 64, 1e-300)
        return cls(t0, t1, states, lift + float(steepest), motion=motion)

    def at(self, t: Array) -> Array:
        return self.states(t)

    def now(self, t: float) -> State:
        return tuple(self.states(np.array([t]))[0].tolist())

    def bound(self, t: float) -> float:
        return self.steepest


@dataclass(slots=True)
class Event:
    """Something that happens to one ball, or to two, at one instant. Not to be changed; see `Leg`."""

    t: float  # s
    kind: EventKind
    i: int  # the ball, or the first of two
    j: int = -1  # the second ball, or the number of the wall; -1 where the event has one ball
    before: Array | None = None  # states (2, 9) of i and j, or (1, 9) of i alone
    after: Array | None = None
    # at a contact: horizontal part of the unit vector from the centre of ball j, or from the wall, to that of ball i
    n: tuple[float, float] = (np.nan, np.nan)
    impulse_n: float = np.nan  # at a contact: on ball i along n, N s
    impulse_t: float = np.nan  # at a contact: on ball i along t = z x n, N s
    drawn: Mapping[str, float] = field(default_factory=dict)  # by chance, by the names of columns of events.parquet


@dataclass(frozen=True)
class Trajectory:
    """The motion of all balls from t0 to t1. legs[i]: those of ball i, in order; events: in order of time."""

    t0: float
    t1: float
    legs: tuple[tuple[Leg, ...], ...]
    events: tuple[Event, ...]

    def at(self, t: ArrayLike) -> Array:
        """Return states (balls, len(t), 9) at any times in [t0, t1]; at an event, the state just after it.

        Raises ValueError outside [t0, t1].
        """
        times = np.atleast_1d(np.asarray(t, dtype=float))
        return np.stack([self.at_one(ball, times) for ball in range(len(self.legs))])

    def at_one(self, ball: int, t: Array) -> Array:
        """Return the states (len(t), 9) of one ball, as of `at`."""
        self._check(t)
        legs, out = self.legs[ball], np.empty((len(t), 9))
        which = self._which(legs, t)
        for k in np.flatnonzero(np.bincount(which)):
            here = which == k
            out[here] = legs[k].at(t[here])
        return out

    def motion(self, t: ArrayLike) -> NDArray[np.str_]:
        """Return "rest", "roll", "slide" or "fly" for each ball and time, (balls, len(t))."""
        times = np.atleast_1d(np.asarray(t, dtype=float))
        self._check(times)
        return np.array([[legs[k].motion for k in self._which(legs, times)] for legs in self.legs])

    def average(self, spans: Array, of: ArrayFunction) -> Array:
        """Average a function of the states over time spans (n, 2): (balls, n, k). See `average_over_spans`."""
        breaks = np.array([e.t for e in self.events])
        return average_over_spans(lambda t: self.at(np.clip(t, self.t0, self.t1)), breaks, spans, of)

    def first(self, kind: str, ball: int = -1, after: float = -np.inf) -> Event | None:
        """Return the first event of a kind after a time, of ball i = `ball` alone if given."""
        for e in self.events:
            if e.kind == kind and e.t >= after and ball in (-1, e.i):
                return e
        return None

    def _check(self, times: Array) -> None:
        if not np.all((times >= self.t0) & (times <= self.t1)):
            raise ValueError(f"time outside the trajectory, {self.t0:g} s to {self.t1:g} s")

    @staticmethod
    def _which(legs: tuple[Leg, ...], times: Array) -> Index:
        return np.searchsorted([leg.t0 for leg in legs[1:]], times, side="right")


def average_over_spans(at: ArrayFunction, breaks: Array, spans: Array, of: ArrayFunction) -> Array:
    """Average a function of a trajectory's states over time spans by Gauss quadrature, split at each kink.

    at: maps times (m,) to states (balls, m, 9).
    breaks: (e,), times of the kinks, rising.
    spans: (n, 2), begins and ends, s.
    of: maps states (balls, m, 9) to (balls, m, k).

    Returns (balls, n, k).
    """
    after = 2 * spans[:, 1] - spans[:, 0]
    near = np.searchsorted(breaks, spans[:, 0], "right") < np.searchsorted(breaks, after, "left")
    cuts, owners = [], []
    for k in np.flatnonzero(near):
        a, b = spans[k]
        inner = np.concatenate([[a], breaks[(breaks > a) & (breaks < b)], [b]])
        cuts.append(np.stack([inner[:-1], inner[1:]], axis=1))
        owners.append(np.full(len(inner) - 1, k))
    smooth = _average_smooth(at, spans[~near], of, 4)  # exact for a parabola, 1e-15 m for a roll
    out = np.zeros((len(smooth), len(spans), smooth.shape[-1]))
    out[:, ~near] = smooth
    if np.any(near):
        pieces, owner = np.concatenate(cuts), np.concatenate(owners)
        width, whole = np.diff(pieces), np.diff(spans)[owner]
        # just before the end of a slide the friction may change all but suddenly, hence 32 nodes
        parts = _average_smooth(at, pieces, of, 32) * np.where(whole > 0, width / np.where(whole > 0, whole, 1), 1.0)
        for ball in range(len(out)):
            np.add.at(out[ball], owner, parts[ball])
    return out


def _average_smooth(at: ArrayFunction, spans: Array, of: ArrayFunction, count: int) -> Array:
    """Average over smooth spans (n, 2) by Gauss quadrature with `count` nodes: (balls, n, k)."""
    nodes, weights = list_gauss_nodes(count)
    times = spans.mean(axis=1)[:, None] + np.diff(spans) / 2 * nodes
    values = of(at(times.ravel()))
    values = values.reshape(len(values), *times.shape, values.shape[-1])
    return np.asarray(np.einsum("bmnk,n->bmk", values, weights / 2))
