"""Closed forms of the simulated motion: sliding, rolling, gliding, flying, the slip, and impulses of friction.

The state of a ball is nine numbers: position x, y, z (m), velocity vx, vy, vz (m/s), spin wx, wy, wz (rad/s).
On the plate z = R. The contact velocity u = v - R (w x z) is the velocity of the ball's lowest point; rolling is u = 0.
`inertia` is I/(m R^2) everywhere: 2/5 for a solid ball, the default.

- `slip_velocity`, `after_sliding`, `after_rolling` and `after_flight` take the nine numbers as floats or as arrays.
  The event loop of one run uses floats, since numpy is slow on single numbers.
- The other functions take states (..., 9), radii (...) and elapsed times (..., m), and return states (..., m, 9).
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.model import SOLID_BALL
from synthcam_shared.arrays import Array, list_gauss_nodes

Real = Any  # a float or an array
State = tuple[Real, ...]  # nine of them
TOUCH_TOLERANCE = 1e-12  # of a radius


def slip_velocity(state: State, radius: Real) -> tuple[Real, Real]:
    """Return u, the slip: the velocity of the lowest point of one ball."""
    return state[3] - radius * state[7], state[4] + radius * state[6]


def slip_rate(inertia: Real = SOLID_BALL) -> Any:
    """Return how many times as fast as the speed friction changes the slip, 1 + 1/k: 7/2 for a solid ball."""
    return 1 + 1 / inertia


def push_share(inertia: Real = SOLID_BALL) -> Any:
    """Return the share of a push on its centre that accelerates a rolling ball, 1/(1 + k): 5/7 of a solid ball."""
    return 1 / inertia / (1 + 1 / inertia)


def after_sliding(state: State, radius: Real, slowing: Real, t: Real, inertia: Real = SOLID_BALL) -> State:
    """Slide for the time t under constant friction: the centre moves on a parabola.

    `slowing` is mu times the load over the mass, m/s^2. The slip must not be zero.
    """
    return after_slowing(state, *find_slowing(state, radius, slowing), 1 / inertia / radius, t)


def find_slowing(state: State, radius: Real, slowing: Real) -> tuple[Real, Real]:
    """Return the acceleration with which friction slows a ball that slides."""
    ux, uy = slip_velocity(state, radius)
    rate = -slowing / (ux * ux + uy * uy) ** 0.5
    return rate * ux, rate * uy


def after_slowing(state: State, ax: Real, ay: Real, turn: Real, t: Real) -> State:
    """Slide for the time t with the acceleration (ax, ay), which spins the ball `turn` = 1/(k R) as fast."""
    x, y, z, vx, vy, vz, wx, wy, wz = state
    turn = turn * t  # I dw/dt = -R z x F
    half = 0.5 * t * t
    out = (x + vx * t + ax * half, y + vy * t + ay * half, z)
    return (*out, vx + ax * t, vy + ay * t, vz, wx + turn * ay, wy - turn * ax, wz)


def after_rolling(state: State, radius: Real, drag: Real, decel: Real, t: Real) -> State:
    """Roll straight on for the time t, which may be negative, with a = -(drag v + decel). The speed must not be 0."""
    x, y, _, vx, vy, _, _, _, wz = state
    slowing = decel / (vx * vx + vy * vy) ** 0.5
    decay, slack = integrate_drag(drag, t)
    path, left = decay - slowing * slack, 1 - (drag + slowing) * decay
    return x + path * vx, y + path * vy, radius, left * vx, left * vy, 0.0, -left * vy / radius, left * vx / radius, wz


def after_flight(state: State, gravity: float, t: Real) -> State:
    """Fly freely for the time t: no friction, constant spin."""
    x, y, z, vx, vy, vz, *w = state
    return (x + vx * t, y + vy * t, z + vz * t - 0.5 * gravity * t * t, vx, vy, vz - gravity * t, *w)


def after_gliding(state: State, drag: float, decel: float, curl: float, spin_drag: float, t: Real) -> State:
    """Glide on air for the time t, a float or an array: v' = -(decel + drag v) v/|v| + curl z x v.

    The spin about the vertical decays at the rate `spin_drag`. The speed must not be 0.
    """
    x, y, z, vx, vy, vz, wx, wy, wz = state
    slowing = decel / (vx * vx + vy * vy) ** 0.5
    decay, slack = integrate_drag(drag, t)
    left = 1 - (drag + slowing) * decay
    exp, cos, sin = (np.exp, np.cos, np.sin) if isinstance(t, np.ndarray) else (math.exp, math.cos, math.sin)
    along, across, c, s = decay - slowing * slack, 0 * t, 1.0 + 0 * t, 0 * t
    if curl:
        path = _turning_path(drag, slowing, curl, np.asarray(t, dtype=float))
        c, s = cos(curl * t), sin(curl * t)
        along, across = (path.real, path.imag) if isinstance(t, np.ndarray) else (float(path.real), float(path.imag))
    spin = wz * exp(-spin_drag * t) if spin_drag else wz + 0 * t
    place = x + along * vx - across * vy, y + along * vy + across * vx, z + 0 * t
    return (*place, left * (c * vx - s * vy), left * (c * vy + s * vx), vz + 0 * t, wx + 0 * t, wy + 0 * t, spin)


def _turning_path(drag: float, slowing: float, curl: float, t: Array) -> NDArray[np.complex128]:
    """Integrate the speed over its first value, times exp(i curl t), from 0 to t."""
    if drag * np.abs(t).max(initial=0.0) > 1e-3:  # below it the difference would lose digits
        turn, fade = 1j * curl, 1j * curl - drag
        one, two = np.expm1(turn * t) / turn, np.expm1(fade * t) / fade
        return np.asarray(two - slowing * (one - two) / drag)
    panels = 1 + int(abs(curl) * np.abs(t).max(initial=0.0) / 10)
    nodes, weights = list_gauss_nodes(24)
    shares = ((np.arange(panels)[:, None] + (1 + nodes) / 2) / panels).ravel()
    times = t[..., None] * shares
    decay, _ = integrate_drag(drag, times)
    values = (1 - (drag + slowing) * decay) * np.exp(1j * curl * times)
    return np.asarray(values @ np.tile(weights / 2 / panels, panels) * t)


def to_rest(state: State, radius: Real) -> State:
    """Set a ball to rest when its motion stops; a spin about the vertical stays."""
    return state[0], state[1], radius, 0.0, 0.0, 0.0, 0.0, 0.0, state[8]


def to_rolling(state: State, radius: Real) -> State:
    """Let the ball roll with its own velocity; a vertical velocity stays."""
    x, y, _, vx, vy, vz, _, _, wz = state
    return x, y, radius, vx, vy, vz, -vy / radius, vx / radius, wz


def _for_vectors(numbers: Real) -> Any:
    """Let numbers (...) multiply vectors (..., 2)."""
    return numbers[..., None] if isinstance(numbers, np.ndarray) and numbers.ndim else numbers


def split_components(state: Array) -> State:
    """Split states (..., 9) into nine arrays that broadcast with times (..., m)."""
    last = state.ndim - 1
    return tuple(state.transpose(last, *range(last))[..., None])  # quicker than np.moveaxis


def stack_components(state: State, elapsed: Array) -> Array:
    """Stack nine numbers or arrays that broadcast with times (..., m) to states (..., m, 9)."""
    out = np.empty((*elapsed.shape, 9))
    for k, values in enumerate(state):
        out[..., k] = values
    return out


def contact_velocity(state: Array, radius: Real) -> Array:
    """Return u, the slip: the velocity (..., 2) of the lowest point of each of many balls."""
    out = np.empty((*state.shape[:-1], 2))
    out[..., 0] = state[..., 3] - radius * state[..., 7]
    out[..., 1] = state[..., 4] + radius * state[..., 6]
    return out


def rolling_velocity(state: Array, radius: Real, inertia: Real = SOLID_BALL) -> Array:
    """Return q = (v + k R w x z)/(1 + k), shape (..., 2): the velocity with which the ball rolls once sliding ends.

    No force at the lowest point can change q (conservation of angular momentum about that point).
    """
    return np.asarray(state[..., 3:5] - _for_vectors(1 / slip_rate(inertia)) * contact_velocity(state, radius))


def plate_state(position: Array, q: Array, u: Array, wz: Real, radius: Real, inertia: Real = SOLID_BALL) -> Array:
    """Return the state of a ball on the plate from its rolling velocity q and contact velocity u, both (..., 2).

    v = q + k/(1 + k) u and R w x z = q - u/(1 + k). For a solid ball the factors are 2/7 and 5/7.
    """
    slip, push = 1 / slip_rate(inertia), push_share(inertia)
    out = np.zeros((*np.broadcast_shapes(position.shape, q.shape)[:-1], 9))
    out[..., 0:2] = position
    out[..., 2] = radius
    out[..., 3:5] = q + _for_vectors(slip) * u
    out[..., 6] = (push * u[..., 1] - q[..., 1]) / radius
    out[..., 7] = (q[..., 0] - push * u[..., 0]) / radius
    out[..., 8] = wz
    return out


def rolling_state(position: Array, velocity: Array, wz: Real, radius: Real) -> Array:
    """Return the state of a rolling ball from position and velocity, both (..., 2)."""
    out = np.zeros((*np.broadcast_shapes(position.shape, velocity.shape)[:-1], 9))
    out[..., 0:2] = position
    out[..., 2] = radius
    out[..., 3:5] = velocity + 0.0  # a ball at rest has no negative zeros
    out[..., 6] = (0.0 - velocity[..., 1]) / radius
    out[..., 7] = velocity[..., 0] / radius
    out[..., 8] = wz
    return out


def apply_friction_impulse(state: Array, impulse: Real, radius: Real, inertia: Real = SOLID_BALL) -> Array:
    """Apply a friction impulse over the mass, (...), against the slip, but at most the impulse that ends the slip."""
    u = contact_velocity(state, radius)
    speed = np.hypot(u[..., 0], u[..., 1])
    hat = u / np.where(speed > 0, speed, 1)[..., None]
    out = state.copy()
    given = np.minimum(impulse, speed / slip_rate(inertia))[..., None] * hat
    out[..., 3:5] -= given
    out[..., 6] -= 1 / inertia / radius * given[..., 1]
    out[..., 7] += 1 / inertia / radius * given[..., 0]
    return out


def slide(state: Array, radius: Real, slowing: Real, elapsed: Array, inertia: Real = SOLID_BALL) -> Array:
    """Slide many balls, each to many times: see `after_sliding`."""
    radius, slowing, inertia = (np.asarray(x)[..., None] for x in (radius, slowing, inertia))
    return stack_components(after_sliding(split_components(state), radius, slowing, elapsed, inertia), elapsed)


def slide_time(state: Array, radius: Real, slowing: Real, inertia: Real = SOLID_BALL) -> Any:
    """Return how long a slide with constant friction lasts, s; without friction, years."""
    u = contact_velocity(state, radius)
    return np.hypot(u[..., 0], u[..., 1]) / np.where(slowing > 0, slip_rate(inertia) * slowing, 1e-9)


def roll(state: Array, radius: Real, drag: Real, decel: Real, elapsed: Array) -> Array:
    """Roll many balls, each to many times: see `after_rolling`. drag, decel: of all balls, or of each."""
    radius = np.asarray(radius)[..., None]
    drag, decel = (x[..., None] if isinstance(x, np.ndarray) else x for x in (drag, decel))
    return stack_components(after_rolling(split_components(state), radius, drag, decel, elapsed), elapsed)


def stop_time(speed: Real, drag: Real, decel: Real) -> Any:
    """Return the seconds until a rolling ball of this speed stops; infinite when decel is 0.

    All may be arrays; drag and decel are numbers where the speed is one.
    """
    if isinstance(speed, float):
        if decel == 0:
            return math.inf
        fast = drag * speed / decel
        return speed / decel * (math.log1p(fast) / fast if fast > 1e-9 else 1 - fast / 2)
    none = np.equal(decel, 0)
    if none.all():
        return np.full(np.shape(speed), np.inf)
    if none.any():
        return np.where(none, np.inf, stop_time(speed, drag, np.where(none, 1.0, decel)))
    x = drag * np.asarray(speed, dtype=float) / decel
    small = x < 1e-9
    return speed / decel * np.where(small, 1 - x / 2, np.log1p(x) / np.where(small, 1, x))


def integrate_drag(drag: Real, t: Real) -> tuple[Real, Real]:
    """Return the closed forms of a drag: (1 - e^(-drag t))/drag and its integral over t, accurate at small drag t.

    drag: a number, or an array where t is one.
    """
    x = drag * t
    weak = (drag <= 1e-3).any() if isinstance(drag, np.ndarray) else drag <= 1e-3  # 1/s: cancellation loses digits
    if isinstance(t, float):
        if drag == 0:
            return t, t * t / 2
        if weak and abs(x) < 1e-2:
            return t * _series(x, 1), t * t * _series(x, 2)
        decay = math.expm1(-x) / -drag
        return decay, (t - decay) / drag
    if not weak:
        decay = np.expm1(-x) / -drag
        return decay, (t - decay) / drag
    small = np.abs(x) < 1e-2
    safe = np.where(small, 1.0, x)
    one = np.where(small, _series(x, 1), -np.expm1(-safe) / safe)
    two = np.where(small, _series(x, 2), (safe + np.expm1(-safe)) / safe**2)
    return t * one, t**2 * two


def _series(x: Real, n: int) -> Any:
    """Sum (-x)^k / (k + n)!; six terms are exact to the last bit for |x| < 0.01."""
    terms = 6
    out = 1 - x / (n + terms)
    for k in range(terms - 1, 0, -1):
        out *= -x / (n + k)
        out += 1
    return out if n == 1 else out / 2


def fly(state: Array, gravity: float, elapsed: Array) -> Array:
    """Fly many balls, each to many times: see `after_flight`."""
    return stack_components(after_flight(split_components(state), gravity, elapsed), elapsed)


def flight_time(states: Array, radius: Array, gravity: float) -> Array:
    """Return how long balls that fly stay in the air, (m,) s."""
    up, height = states[:, 5], np.maximum(states[:, 2] - radius, 0.0)
    return np.asarray((up + np.sqrt(up * up + 2 * gravity * height)) / gravity)
