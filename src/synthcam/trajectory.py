"""Exact motion: legs between events, and the trajectory they make up.

The state of a ball is nine numbers: position x, y, z (m), velocity vx, vy, vz (m/s), spin wx, wy, wz (rad/s).
On the plate z = R. The contact velocity u = v - R (w x z) is that of the ball's lowest point; rolling is u = 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Motion = Literal["rest", "roll", "slide", "fly"]
GAUSS = 4  # nodes a span: exact for a parabola, 1e-15 m for a roll


def contact_velocity(state: Array, radius: float) -> Array:
    """u, shape (..., 2), of the lowest point of a ball on the plate."""
    return np.stack([state[..., 3] - radius * state[..., 7], state[..., 4] + radius * state[..., 6]], axis=-1)


def rolling_velocity(state: Array, radius: float) -> Array:
    """(5 v + 2 R w x z)/7, shape (..., 2): the velocity left when sliding ends, whatever force at the lowest point."""
    return np.asarray(state[..., 3:5] - 2 / 7 * contact_velocity(state, radius))


def rolling_state(position: Array, velocity: Array, wz: float | Array, radius: float) -> Array:
    """The state (..., 9) of a ball that rolls; position, velocity (..., 2)."""
    out = np.zeros((*np.broadcast_shapes(position.shape, velocity.shape)[:-1], 9))
    out[..., 0:2] = position
    out[..., 2] = radius
    out[..., 3:5] = velocity
    out[..., 6] = -velocity[..., 1] / radius
    out[..., 7] = velocity[..., 0] / radius
    out[..., 8] = wz
    return out


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

    def bound(self, t: float) -> float:
        """No acceleration after t within the leg is larger, m/s^2."""


@dataclass(frozen=True)
class Rest:
    """A ball that stays where it is; it may spin about the vertical."""

    t0: float
    t1: float
    state: Array
    motion: Motion = "rest"

    def at(self, t: Array) -> Array:
        return np.broadcast_to(self.state, (len(t), 9))

    def bound(self, t: float) -> float:
        return 0.0


@dataclass(frozen=True)
class Roll:
    """Rolling on a straight line with the loss a = -(drag v + decel); `time` is when `state` holds."""

    t0: float
    t1: float
    time: float
    state: Array
    radius: float
    drag: float
    decel: float
    motion: Motion = "roll"

    def at(self, t: Array) -> Array:
        speed = float(np.hypot(self.state[3], self.state[4]))
        along = self.state[3:5] / speed
        dt = t - self.time
        decay, slack = _decay(self.drag, dt)
        path = speed * decay - self.decel * slack
        v = speed * (1 - self.drag * decay) - self.decel * decay
        return rolling_state(self.state[:2] + path[:, None] * along, v[:, None] * along, self.state[8], self.radius)

    def bound(self, t: float) -> float:
        speed = float(np.hypot(*self.at(np.array([t]))[0, 3:5]))
        return self.drag * speed + self.decel

    @staticmethod
    def stop_after(speed: float, drag: float, decel: float) -> float:
        """Seconds until a ball of this speed stops; infinite when decel is 0."""
        if decel == 0:
            return np.inf
        x = drag * speed / decel
        return float(speed / decel * (np.log1p(x) / x if x > 0 else 1.0))


def _decay(drag: float, t: Array) -> tuple[Array, Array]:
    """(1 - e^(-drag t))/drag and its integral, without cancellation at small drag t."""
    x = drag * t
    small = np.abs(x) < 1e-2
    safe = np.where(small, 1.0, x)
    one = np.where(small, _series(x, 1), -np.expm1(-safe) / safe)
    two = np.where(small, _series(x, 2), (safe + np.expm1(-safe)) / safe**2)
    return t * one, t**2 * two


def _series(x: Array, n: int) -> Array:
    """Sum of (-x)^k / (k + n)!, good to the last bit for |x| < 0.01."""
    out = np.zeros_like(x)
    term = np.ones_like(x) / (1 if n == 1 else 2)
    for k in range(8):
        out = out + term
        term = -term * x / (k + n + 1)
    return out


@dataclass(frozen=True)
class Slide:
    """Sliding with constant friction: a parabola. `slowing` is mu g, m/s^2."""

    t0: float
    t1: float
    state: Array
    radius: float
    slowing: float
    motion: Motion = "slide"

    def at(self, t: Array) -> Array:
        u = contact_velocity(self.state, self.radius)
        a = -self.slowing * u / np.hypot(*u)
        dt = (t - self.t0)[:, None]
        out = np.repeat(self.state[None], len(t), axis=0)
        out[:, 0:2] += self.state[3:5] * dt + 0.5 * a * dt**2
        out[:, 3:5] += a * dt
        turning = -2.5 / self.radius * np.array([-a[1], a[0]])  # I dw/dt = -R z x F
        out[:, 6:8] += turning * dt
        return out

    def bound(self, t: float) -> float:
        return self.slowing


@dataclass(frozen=True)
class Numeric:
    """A leg without closed form: a dense numerical solution, `states(t)`."""

    t0: float
    t1: float
    motion: Motion
    states: Callable[[Array], Array]
    steepest: float

    def at(self, t: Array) -> Array:
        return self.states(t)

    def bound(self, t: float) -> float:
        return self.steepest


@dataclass(frozen=True)
class Event:
    """Something that happens at one instant. before, after: states (2, 9) of balls i, j, or (1, 9) of i alone.

    n: unit vector from ball j's centre to ball i's, at a contact. The impulses, over the mass (m/s), on ball i:
    along n, and along t = z x n.
    """

    t: float
    kind: Literal["contact", "slide_end", "stop", "land"]
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

    def mean(self, spans: Array, of: Callable[[Array], Array]) -> Array:
        """Means over time spans (n, 2) of a function of the states: (balls, n, k).

        `of` maps states (balls, m, 9) to (balls, m, k). Gauss quadrature, split where an event falls into a span.
        """
        nodes, weights = np.polynomial.legendre.leggauss(GAUSS)
        breaks = np.array([e.t for e in self.events])
        split = np.searchsorted(breaks, spans[:, 0], "right") < np.searchsorted(breaks, spans[:, 1], "left")
        cuts, owners = [spans[~split]], [np.flatnonzero(~split)]
        for k in np.flatnonzero(split):
            a, b = spans[k]
            inner = np.concatenate([[a], breaks[(breaks > a) & (breaks < b)], [b]])
            cuts.append(np.stack([inner[:-1], inner[1:]], axis=1))
            owners.append(np.full(len(inner) - 1, k))
        pieces, owner = np.concatenate(cuts), np.concatenate(owners)
        width = np.diff(pieces)
        times = pieces.mean(axis=1)[:, None] + width / 2 * nodes
        whole = np.diff(spans)[owner]
        share = np.where(whole > 0, width / np.where(whole > 0, whole, 1), 1.0) * weights / 2
        values = of(self.at(np.clip(times.ravel(), self.t0, self.t1)))
        parts = (values.reshape(len(values), *times.shape, -1) * share[..., None]).sum(axis=2)
        out = np.zeros((len(values), len(spans), parts.shape[-1]))
        for ball in range(len(values)):
            np.add.at(out[ball], owner, parts[ball])
        return out

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
