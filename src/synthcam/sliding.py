"""Sliding without closed form: when an effect bends friction, load, the torque about the vertical, or pushes.

Integrated in q = (5 v + 2 R w x z)/7 and the contact velocity u = |u| (cos th, sin th), v = q + (2/7) u:
    q' = (5/7) p,   |u|' = -(7/2) mu N + p . u_hat = -A,   th' = (u_hat x p)/|u|,   x' = v
with p the push and N the load over the mass. Towards the end of the slide th' grows as 1/|u|; with ln|u| for the time
every right-hand side is smooth, and the slide's end is a known place instead of an event to search for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.kinematics import Array, contact_velocity, plate_state, rolling_velocity
from synthcam.model import Bodies, Model
from synthcam.spectral import RESOLVED, Path, integrate

FINISH = 1e-5  # of the first slip: the rest of the slide, a microsecond, is taken as a uniform deceleration
LAST = float(np.log(FINISH))
ROUGH = 1e-8  # of the last coefficients in the path of another ball: its kinks make pushes unsmooth, but hardly
LAWS = ("friction", "normal_load", "push", "drilling")
NOWHERE = np.full(2, np.inf)  # where the other ball is when there is none
Other = Callable[[Array, Any], Array]  # times (k, n), which k balls -> places of the other ball, (k, n, 2)


@dataclass(frozen=True)
class Slides:
    """k slides that begin together at elapsed time 0. path: (t, x, y, qx, qy, th, wz) against ln(|u|/|u0|).

    lasts (k,): how long, s. cut: when the uniform end begins; slowing (k,), push (k, 2), twist (k,) in it.
    """

    path: Path
    first: Array
    radius: Array
    cut: Array
    lasts: Array
    slowing: Array
    push: Array
    twist: Array

    def states(self, elapsed: Array) -> Array:
        """States (k, m, 9) at elapsed times (k, m) from 0 to `lasts`."""
        cut, radius = self.cut[:, None], self.radius[:, None]
        late = np.clip(elapsed - cut, 0.0, (self.lasts - self.cut)[:, None])
        log = self._when(np.minimum(elapsed, cut))
        y = self.path(log)
        left = self.first[:, None] * np.exp(log)
        slip = np.where(elapsed > cut, np.maximum(left - self.slowing[:, None] * late, 0.0), left)
        hat = np.stack([np.cos(y[..., 5]), np.sin(y[..., 5])], axis=-1)
        q = y[..., 3:5] + 5 / 7 * self.push[:, None] * late[..., None]
        mean = y[..., 3:5] + 5 / 14 * self.push[:, None] * late[..., None] + ((left + slip) / 7)[..., None] * hat
        spin = y[..., 6] + self.twist[:, None] * late
        return plate_state(y[..., 1:3] + mean * late[..., None], q, slip[..., None] * hat, spin, radius)

    def ends(self) -> Array:
        """States (k, 9) of the balls when they stop sliding."""
        return self.states(self.lasts[:, None])[:, 0]

    def _when(self, elapsed: Array) -> Array:
        """ln(|u|/|u0|) at which the slide has lasted `elapsed`: Newton on the path's own time, kept in brackets."""
        log = np.clip(np.log1p(-elapsed / self.cut[:, None] * (1 - FINISH)), LAST, 0.0)  # exact for constant friction
        low, high = np.full(elapsed.shape, LAST), np.zeros(elapsed.shape)
        times = self.path.with_slope(0)
        for _ in range(60):
            time, slope = np.moveaxis(times(log), -1, 0)
            late = time > elapsed
            low, high = np.where(late, log, low), np.where(late, high, log)
            new = log - (time - elapsed) / np.where(slope < 0, slope, -np.inf)
            new = np.where((new >= low) & (new <= high), new, (low + high) / 2)
            if np.all(np.abs(new - log) * np.exp(log) < 1e-14):
                return np.asarray(new)
            log = new
        return np.asarray(log)


def slides(model: Model, state: Array, bodies: Bodies, time: Array, other: Other | None) -> Slides:
    """The slides that start at `time` (k,) from states (k, 9). Raises ValueError when a slip would grow, not end."""
    radius = bodies.radius[:, None]
    u, q = contact_velocity(state, bodies.radius), rolling_velocity(state, bodies.radius)
    first = np.hypot(u[:, 0], u[:, 1])

    def forces(slip: Array, y: Array) -> tuple[Array, Array, Array, Array, Array]:
        """A, u_hat x p, p, v and dwz/dt for slip speeds (k, n) and y (k, n, 7)."""
        hat = np.stack([np.cos(y[..., 5]), np.sin(y[..., 5])], axis=-1)
        v = y[..., 3:5] + 2 / 7 * slip[..., None] * hat
        instant: dict[str, Any] = dict(slip_speed=slip, slip=hat, position=y[..., 1:3], velocity=v, spin=y[..., 6])
        instant |= dict(gravity=model.gravity, radius=radius, mass=bodies.mass[:, None], of_a=bodies.of_a[:, None])
        instant["other"] = NOWHERE if other is None else other(time[:, None] + y[..., 0], slice(None)) - y[..., 1:3]
        push = model.laws("push", np.zeros_like(v), instant)
        friction = model.laws("friction", model.sliding_friction, instant)
        load = model.laws("normal_load", model.gravity, instant)
        twist = np.asarray(model.laws("drilling", 0.0, instant | {"friction": friction}))
        slowing = 3.5 * friction * load - (push * hat).sum(axis=-1)
        if not np.all(slowing > 0):
            raise ValueError("sliding friction does not end the slide: the push along the slip is too strong")
        across = hat[..., 0] * push[..., 1] - hat[..., 1] * push[..., 0]
        return slowing, across, push, v, twist

    def right(log: Array, y: Array) -> Array:
        slip = first[:, None] * np.exp(log)
        slowing, across, push, v, twist = forces(slip, y)
        dt = -slip / slowing
        out = np.empty_like(y)
        out[..., 0], out[..., 5], out[..., 6] = dt, -across / slowing, twist * dt
        out[..., 1:3], out[..., 3:5] = v * dt[..., None], 5 / 7 * push * dt[..., None]
        return out

    start = np.column_stack([np.zeros(len(state)), state[:, 0:2], q, np.arctan2(u[:, 1], u[:, 0]), state[:, 8]])
    path = integrate(right, 0.0, LAST, start, RESOLVED if other is None else ROUGH)
    last = path(np.full((len(state), 1), LAST))
    slip = (first * FINISH)[:, None]
    slowing, _, push, _, twist = (np.broadcast_to(f, (*slip.shape, *f.shape[2:]))[:, 0] for f in forces(slip / 2, last))
    cut = last[:, 0, 0]
    return Slides(path, first, bodies.radius, cut, cut + slip[:, 0] / slowing, slowing, push, twist)
