"""Closed forms of motion on the plate, for many balls at once.

The state of a ball is nine numbers: position x, y, z (m), velocity vx, vy, vz (m/s), spin wx, wy, wz (rad/s).
On the plate z = R. The contact velocity u = v - R (w x z) is that of the ball's lowest point; rolling is u = 0.
Shapes: states (..., 9), radii and the like (...), elapsed times (..., m), results (..., m, 9).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Real = Any  # a float or an array


def contact_velocity(state: Array, radius: Real) -> Array:
    """u, shape (..., 2), of the lowest point of a ball."""
    return np.stack([state[..., 3] - radius * state[..., 7], state[..., 4] + radius * state[..., 6]], axis=-1)


def rolling_velocity(state: Array, radius: Real) -> Array:
    """(5 v + 2 R w x z)/7, shape (..., 2): the velocity left when sliding ends, whatever force at the lowest point."""
    return np.asarray(state[..., 3:5] - 2 / 7 * contact_velocity(state, radius))


def plate_state(position: Array, q: Array, u: Array, wz: Real, radius: Real) -> Array:
    """The state of a ball on the plate from q, the velocity it will roll with, and its contact velocity u, (..., 2).

    v = q + (2/7) u and R w x z = q - (5/7) u.
    """
    out = np.zeros((*np.broadcast_shapes(position.shape, q.shape)[:-1], 9))
    out[..., 0:2] = position
    out[..., 2] = radius
    out[..., 3:5] = q + 2 / 7 * u
    out[..., 6] = (5 / 7 * u[..., 1] - q[..., 1]) / radius
    out[..., 7] = (q[..., 0] - 5 / 7 * u[..., 0]) / radius
    out[..., 8] = wz
    return out


def rolling_state(position: Array, velocity: Array, wz: Real, radius: Real) -> Array:
    """The state of a ball that rolls; position, velocity (..., 2)."""
    return plate_state(position, velocity, np.zeros(2), wz, radius)


def push_back(state: Array, impulse: Real, radius: Real) -> Array:
    """The state after a friction impulse over the mass, (...), against the slip; no more than ends the slip."""
    u = contact_velocity(state, radius)
    speed = np.hypot(u[..., 0], u[..., 1])
    hat = u / np.where(speed > 0, speed, 1)[..., None]
    out = state.copy()
    given = np.minimum(impulse, speed / 3.5)[..., None] * hat
    out[..., 3:5] -= given
    out[..., 6] -= 2.5 / radius * given[..., 1]
    out[..., 7] += 2.5 / radius * given[..., 0]
    return out


def slide(state: Array, radius: Real, slowing: Real, elapsed: Array) -> Array:
    """Sliding with constant friction: a parabola. slowing: mu times the load over the mass, m/s^2."""
    u = contact_velocity(state, radius)
    a = -np.asarray(slowing)[..., None] * u / np.hypot(u[..., 0], u[..., 1])[..., None]
    dt = elapsed[..., None]
    out = np.repeat(state[..., None, :], elapsed.shape[-1], axis=-2)
    out[..., 0:2] += state[..., None, 3:5] * dt + 0.5 * a[..., None, :] * dt**2
    out[..., 3:5] += a[..., None, :] * dt
    turning = -2.5 / np.asarray(radius)[..., None] * np.stack([-a[..., 1], a[..., 0]], axis=-1)  # I dw/dt = -R z x F
    out[..., 6:8] += turning[..., None, :] * dt
    return out


def slide_time(state: Array, radius: Real, slowing: Real) -> Any:
    """How long a slide with constant friction lasts, s."""
    u = contact_velocity(state, radius)
    return np.hypot(u[..., 0], u[..., 1]) / (3.5 * slowing)


def roll(state: Array, radius: Real, drag: float, decel: float, elapsed: Array) -> Array:
    """Rolling on a straight line with the loss a = -(drag v + decel); elapsed may be negative. Speeds over zero."""
    slowing = decel / np.hypot(state[..., 3], state[..., 4])[..., None]
    decay, slack = _decay(drag, elapsed)
    start = state[..., None, 3:5]
    position = state[..., None, 0:2] + (decay - slowing * slack)[..., None] * start
    wz, size = state[..., None, 8], np.asarray(radius)[..., None]
    return rolling_state(position, (1 - (drag + slowing) * decay)[..., None] * start, wz, size)


def stop_time(speed: Real, drag: float, decel: float) -> Any:
    """Seconds until a rolling ball of this speed stops; infinite when decel is 0."""
    if decel == 0:
        return np.full(np.shape(speed), np.inf)
    x = drag * np.asarray(speed, dtype=float) / decel
    small = x < 1e-9
    return speed / decel * np.where(small, 1 - x / 2, np.log1p(x) / np.where(small, 1, x))


TERMS = 6


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
    out = 1 - x / (n + TERMS)
    for k in range(TERMS - 1, 0, -1):
        out *= -x / (n + k)
        out += 1
    return out if n == 1 else out / 2


def fly(state: Array, gravity: float, elapsed: Array) -> Array:
    """Free flight: no friction, spin kept."""
    dt = elapsed[..., None]
    out = np.repeat(state[..., None, :], elapsed.shape[-1], axis=-2)
    out[..., 0:3] += state[..., None, 3:6] * dt
    out[..., 2] -= 0.5 * gravity * elapsed**2
    out[..., 5] -= gravity * elapsed
    return out
