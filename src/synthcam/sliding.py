"""Sliding without closed form: when an effect bends friction, load, the torque about the vertical, or pushes.

Integrated in q = (5 v + 2 R w x z)/7 and the contact velocity u = |u| (cos th, sin th), v = q + (2/7) u:
    q' = (5/7) p,   |u|' = -(7/2) mu N + p . u_hat = -A,   th' = (u_hat x p)/|u|,   x' = v
with p the push, N the load over the mass, and cos th, sin th in place of th. Towards the end of the slide th' grows as
1/|u|; with ln|u| for the time every right-hand side is smooth, and the slide's end is a known place instead of an event
to search for. Where nothing can turn the slip and A depends on |u| alone, t and x are integrals over |u|.

Solved, the place is a series in w, the cube root of the share of time left: a direction that turns as ln w leaves only
terms as small as w^6 ln w in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from synthcam.kinematics import Array, contact_velocity, plate_state, rolling_velocity
from synthcam.model import Bodies, Model
from synthcam.packed import Packed
from synthcam.spectral import FEWEST, MOST, RESOLVED, Path, integrate, matrices, product, series

ROUNDING = 3e-16
FINISH = 1e-5  # of the first slip: the rest of the slide, a microsecond, is taken as a uniform deceleration
KNOTS = (0.0, -3.8, float(np.log(FINISH)))  # of ln(|u|/|u0|)
SHARES = (1.0, 0.0)  # of |u|/|u0|
ROUGH = 1e-8  # of the last coefficients in the path of another ball: its kinks make pushes unsmooth, but hardly
LAWS = ("friction", "normal_load", "push", "drilling")
STRAIGHT = {"slip_speed", "slip", "gravity", "radius"}  # friction and load that ask no more leave the slip's direction
NOWHERE = np.full(2, np.inf)  # where the other ball is when there is none
FEW = 28  # nodes of a logarithmic piece, first
SERIES = ((20, 0.0), (44, 0.0), (44, 0.35))  # nodes in w, and from where on: tried in this order
TRUE = 3e-14  # m, of the last coefficients in w
Other = Callable[[Array, Any], Array]  # times (k, n), which k balls -> places of the other ball, (k, n, 2)


@dataclass(frozen=True)
class Slides:
    """k slides that begin together at elapsed time 0, solved: (t, x, y, qx, qy, cos th, sin th, wz) against `knots`.

    lasts (k,): how long, s. cut: when the uniform end begins; slowing (k,), push (2, k), twist (k,) in it. of: what the
    path runs over, to |u|/|u0| and its logarithm.
    """

    path: Path
    straight: bool
    first: Array
    radius: Array
    cut: Array
    lasts: Array
    slowing: Array
    push: Array
    twist: Array

    def states(self, elapsed: Array) -> Array:
        """States (k, m, 9) at elapsed times (k, m) from 0 to `lasts`."""
        plane = self._exact(elapsed)
        x, q, u = (np.moveaxis(plane[i : i + 2], 0, -1) for i in (0, 2, 4))
        return plate_state(x, q, u, plane[6], self.radius[:, None])

    def ends(self) -> Array:
        """States (k, 9) of the balls when they stop sliding."""
        return self.states(self.lasts[:, None])[:, 0]

    def places(self, elapsed: Array) -> Array:
        """Centres (2, k, m)."""
        if self._series is None:
            return self._exact(elapsed)[:2]
        coefficients, least = self._series
        w = np.cbrt(1 - np.clip(elapsed / self.lasts[:, None], 0.0, 1.0))
        out = series(coefficients, (2 * np.maximum(w, least) - 1 - least) / (1 - least))
        if least > 0:
            late = Packed(w < least)
            if late.any:
                out[:, late.rows, late.columns] = self._exact(late.gather(elapsed))[:2, late.rows, late.places]
        return out

    @cached_property
    def _series(self) -> tuple[Array, float] | None:
        """The places' coefficients (2, k, nodes) in w and the least w, or None where they do not settle."""
        for size, least in SERIES:
            on = matrices(size)
            w = least + (1 - least) * (1 + on.nodes) / 2
            found = product(self._exact(self.lasts[:, None] * (1 - w**3))[:2], on.coefficients)
            if np.abs(found[..., -2:]).max() < TRUE + ROUNDING * np.abs(found[..., 0]).max():
                return found, least
        return None

    def _exact(self, elapsed: Array) -> Array:
        """(x, y, qx, qy, ux, uy, wz), (7, k, m)."""
        cut = self.cut[:, None]
        late = np.clip(elapsed - cut, 0.0, (self.lasts - self.cut)[:, None])
        along = self._when(np.minimum(elapsed, cut))
        y = self.path(along)
        left = self.first[:, None] * (along if self.straight else np.exp(along))
        slip = np.where(elapsed > cut, np.maximum(left - self.slowing[:, None] * late, 0.0), left)
        push = self.push[..., None] * late
        out = np.empty((7, *elapsed.shape))
        out[0:2] = y[1:3] + (y[3:5] + 5 / 14 * push + (left + slip) / 7 * y[5:7]) * late
        out[2:4], out[4:6], out[6] = y[3:5] + 5 / 7 * push, slip * y[5:7], y[7] + self.twist[:, None] * late
        return out

    def _when(self, elapsed: Array) -> Array:
        """Where on the path a slide has lasted `elapsed`: Newton on the path's own time, kept in brackets."""
        end = 0.0 if self.straight else FINISH
        left = 1 - elapsed / self.cut[:, None] * (1 - end)  # exact for constant friction
        low, high = np.full(elapsed.shape, self.path.ends[-1]), np.full(elapsed.shape, self.path.ends[0])
        along = np.clip(left if self.straight else np.log(np.maximum(left, end)), low, high)
        timing = Path(
            self.path.ends,
            tuple(_with_slope(c[0], np.diff(self.path.ends)[k]) for k, c in enumerate(self.path.coefficients)),
        )
        for _ in range(60):
            time, slope = timing(along)
            late = time > elapsed
            low, high = np.where(late, along, low), np.where(late, high, along)
            new = along - (time - elapsed) / np.where(slope < 0, slope, -np.inf)
            new = np.where((new >= low) & (new <= high), new, (low + high) / 2)
            if np.all(np.abs(new - along) * (1.0 if self.straight else np.exp(along)) < 1e-8):  # squared by this turn
                return np.asarray(new)
            along = new
        return np.asarray(along)


def _with_slope(c: Array, wide: float) -> Array:
    """A series (k, n) and its derivative: (2, k, n)."""
    return np.stack([c, product(c[None], matrices(c.shape[-1]).slope)[0] * (2 / wide)])


def slides(model: Model, state: Array, bodies: Bodies, time: Array, other: Other | None) -> Slides:
    """The slides that start at `time` (k,) from states (k, 9). Raises ValueError when a slip would grow, not end."""
    u, q = contact_velocity(state, bodies.radius), rolling_velocity(state, bodies.radius)
    first = np.hypot(u[:, 0], u[:, 1])
    laws, radius = model.laws, bodies.radius[:, None]
    pushes, drills = laws.bent("push"), laws.bent("drilling")
    fixed: dict[str, Any] = dict(gravity=model.gravity, radius=radius)
    fixed |= dict(mass=bodies.mass[:, None], of_a=bodies.of_a[:, None])

    def forces(slip: Array, y: Array) -> tuple[Array, Any, Any, Array, Any]:
        """A (k, n), u_hat x p, p (2, k, n), v (2, k, n) and dwz/dt for slip speeds (k, n) and y (8, k, n)."""
        hat = y[5:7]
        v = y[3:5] + (2 / 7 * slip) * hat
        instant = fixed | dict(slip_speed=slip, slip=_last(hat), position=_last(y[1:3]), velocity=_last(v), spin=y[7])
        friction = laws("friction", model.sliding_friction, instant)
        slowing = 3.5 * friction * laws("normal_load", model.gravity, instant) + np.zeros_like(slip)
        twist = laws("drilling", 0.0, instant | {"friction": friction}) if drills else 0.0
        push, across = 0.0, 0.0
        if pushes:
            instant["other"] = NOWHERE if other is None else other(time[:, None] + y[0], slice(None)) - _last(y[1:3])
            push = laws("push", _last(np.zeros_like(v)), instant).transpose(2, 0, 1)
            slowing -= push[0] * hat[0] + push[1] * hat[1]
            across = hat[0] * push[1] - hat[1] * push[0]
        if not np.all(slowing > 0):
            raise ValueError("sliding friction does not end the slide: the push along the slip is too strong")
        return slowing, across, push, v, twist

    def right(log: Array, y: Array) -> Array:
        slip = first[:, None] * np.exp(log)
        slowing, across, push, v, twist = forces(slip, y)
        out = np.empty_like(y)
        np.divide(-slip, slowing, out=out[0])
        out[1:3], out[3:5] = v * out[0], 5 / 7 * push * out[0]
        turn = across / slowing  # -dth/dln|u|
        np.multiply(turn, y[6], out=out[5])
        np.multiply(-turn, y[5], out=out[6])
        out[7] = twist * out[0]
        return out

    start = np.stack([np.zeros(len(state)), *state[:, 0:2].T, *q.T, *u.T / first, state[:, 8]])
    nothing = np.zeros_like(first)
    if not pushes and not drills and all(laws.asked(law) <= STRAIGHT for law in ("friction", "normal_load")):
        path = _straight(lambda slip, y: forces(slip, y)[0], first, start)
        if path is not None:
            lasts = path.last()[0]
            return Slides(path, True, first, bodies.radius, lasts, lasts, nothing, np.zeros((2, len(first))), nothing)
    slowing0, across0, push0, _, twist0 = forces(first[:, None], start[..., None])

    def guess(log: Array) -> Array:
        """The slide were all forces what they are at its start."""
        share = np.exp(log)
        t = first[:, None] * (1 - share) / slowing0
        th = -across0 / slowing0 * log
        y = np.repeat(start[..., None], len(log), axis=-1)
        y[0], y[7] = t, y[7] + twist0 * t
        y[1:3] += (y[3:5] + first[:, None] * (1 + share) / 7 * y[5:7]) * t
        y[3:5] += 5 / 7 * push0 * t
        y[5], y[6] = y[5] * np.cos(th) - y[6] * np.sin(th), y[6] * np.cos(th) + y[5] * np.sin(th)
        return y

    path = integrate(right, KNOTS, start, guess, RESOLVED if other is None else ROUGH, few=FEW)
    last, slip = path.last(), first * FINISH
    slowing, _, push, _, twist = forces(slip[:, None] / 2, last[..., None])
    push, twist = (np.broadcast_to(f, (*lead, len(slip), 1))[..., 0] for f, lead in ((push, (2,)), (twist, ())))
    cut, slowing = last[0], slowing[:, 0]
    return Slides(path, False, first, bodies.radius, cut, cut + slip / slowing, slowing, push, twist)


def _last(vectors: Array) -> Array:
    """(2, k, n) as effects want it: (k, n, 2)."""
    return vectors.transpose(1, 2, 0)


def _straight(slowing: Callable[[Array, Array], Array], first: Array, start: Array) -> Path | None:
    """The path over |u|/|u0| of slides whose A depends on |u| alone; None where that is not smooth."""
    for size in (FEWEST, MOST, 2 * MOST):
        on = matrices(size)
        slip = first[:, None] * (1 - on.nodes) / 2
        whole = np.repeat(start[..., None], size, axis=-1)
        rate = first[:, None] / 2 / slowing(slip, whole)
        last = np.abs(product(rate[None], on.coefficients[:, -3:])).max(axis=-1)
        if np.all(last < RESOLVED * rate.max(axis=-1)):
            time, path = product(np.stack([rate, rate * slip]), on.integral)
            whole[0] = time
            whole[1:3] += whole[3:5] * time + 2 / 7 * path * whole[5:7]
            return Path(np.array(SHARES), (product(whole, on.coefficients),))
    return None
