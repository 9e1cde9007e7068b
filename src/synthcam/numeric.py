"""Legs without closed form: sliding and rolling when an effect bends friction, load, rolling loss, or pushes.

Sliding is integrated in q = (5 v + 2 R w x z)/7 and the contact velocity u = |u| (cos th, sin th), v = q + (2/7) u:
    q' = (5/7) p,   |u|' = -(7/2) mu N + p . u_hat = -A,   th' = (u_hat x p)/|u|,   x' = v
with p the push and N the load over the mass. Towards the end of the slide th' grows as 1/|u|; with ln|u| for the time
every right-hand side is smooth, and the slide's end is a known place instead of an event to search for.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from synthcam.model import Model
from synthcam.spectral import Path, integrate
from synthcam.trajectory import Array, Numeric, contact_velocity, rolling_state, rolling_velocity

FINISH = 1e-4  # of the first slip: the rest of the slide, some us, is taken as a uniform deceleration
SLOWEST = 1e-7  # m/s: the rest of a roll likewise
PIECE = 0.2  # s of rolling solved beyond what was asked for


def numeric_slide(model: Model, state: Array, t: float) -> Numeric:
    """The slide that starts at t from `state` (9,). Raises ValueError when the slip would grow instead of end."""
    radius, wz = model.ball.radius, float(state[8])
    u, q = contact_velocity(state, radius), rolling_velocity(state, radius)
    first = float(np.hypot(*u))

    def forces(slip: Array, y: Array) -> tuple[Array, Array, Array]:
        """A, p and v for the slip speeds (n,) and y (n, 6)."""
        hat = np.stack([np.cos(y[:, 5]), np.sin(y[:, 5])], axis=1)
        v = y[:, 3:5] + 2 / 7 * slip[:, None] * hat
        instant = dict(slip_speed=slip, slip=hat, position=y[:, 1:3], velocity=v, spin=wz, gravity=model.gravity)
        push = model.laws("push", np.zeros_like(v), instant)
        drive = model.laws("friction", model.sliding_friction, instant)
        load = model.laws("normal_load", model.gravity, instant)
        slowing = 3.5 * drive * load - (push * hat).sum(axis=1)
        if not np.all(slowing > 0):
            raise ValueError("sliding friction does not end the slide: the push along the slip is too strong")
        across = hat[:, 0] * push[:, 1] - hat[:, 1] * push[:, 0]
        return np.stack([slowing, across], axis=1), push, v

    def right(log: Array, y: Array) -> Array:
        slip = first * np.exp(log)
        rates, push, v = forces(slip, y)
        dt = -slip / rates[:, 0]
        turn = -rates[:, 1] / rates[:, 0]
        return np.column_stack([dt, v * dt[:, None], 5 / 7 * push * dt[:, None], turn])

    start = np.array([0.0, *state[0:2], *q, np.arctan2(u[1], u[0])])
    path = integrate(right, 0.0, np.log(FINISH), start)
    last = path(np.array([np.log(FINISH)]))
    slip = np.array([first * FINISH])
    slowing = forces(slip / 2, last)[0][0, 0]
    cut, end = float(last[0, 0]), float(last[0, 0] + slip[0] / slowing)
    tail_push = forces(slip / 2, last)[1][0]

    def states(times: Array) -> Array:
        elapsed = times - t
        late = np.clip(elapsed - cut, 0.0, end - cut)
        log = _when(path, np.minimum(elapsed, cut))
        y = path(log)
        left = first * np.exp(log)
        hat = np.stack([np.cos(y[:, 5]), np.sin(y[:, 5])], axis=1)
        contact = np.where(elapsed > cut, np.maximum(left - slowing * late, 0.0), left)[:, None] * hat
        drift = y[:, 3:5] + 5 / 7 * tail_push * late[:, None]
        middle = y[:, 3:5] + 5 / 14 * tail_push * late[:, None] + 1 / 7 * (left[:, None] * hat + contact)
        return _sliding_state(y[:, 1:3] + middle * late[:, None], drift, contact, wz, radius)

    return Numeric(t, t + end, "slide", states, _steepest(states, t, end))


def numeric_roll(model: Model, state: Array, t: float, until: float) -> Numeric:
    """The roll from t until the ball stops, or a little past `until`; with until < t, back to `until`."""
    radius, wz = model.ball.radius, float(state[8])

    def acceleration(y: Array) -> Array:
        v = y[:, 2:4]
        speed = np.hypot(v[:, 0], v[:, 1])
        instant = dict(speed=speed, position=y[:, :2], velocity=v, gravity=model.gravity)
        loss = model.laws("rolling", model.rolling_drag * speed + model.rolling_decel, instant)
        push = model.laws("push", np.zeros_like(v), instant)
        return np.asarray(5 / 7 * push - (loss / np.maximum(speed, 1e-300))[:, None] * v)

    def right(_: Array, y: Array) -> Array:
        return np.column_stack([y[:, 2:4], acceleration(y)])

    y, now = np.array([*state[0:2], *state[3:5]]), t
    pieces: list[Path] = []
    target = until if until < t else until + PIECE
    while now != target and (not pieces or np.hypot(y[2], y[3]) > SLOWEST):
        stopping = 0.5 * np.hypot(y[2], y[3]) / max(np.hypot(*acceleration(y[None])[0]), 1e-300)
        step = max(target - now, -stopping) if target < now else min(target - now, stopping)
        end = target if step == target - now else now + float(step)
        pieces.append(integrate(right, now, end, y))
        y, now = pieces[-1](np.array([end]))[0], end
    path = Path(np.concatenate([[t], *[p.ends[1:] for p in pieces]]), np.concatenate([p.coefficients for p in pieces]))

    speed = np.hypot(y[2], y[3])
    slowing = -float(acceleration(y[None])[0] @ y[2:4]) / max(speed, 1e-300)
    rest = speed / slowing if until >= t and speed <= SLOWEST and slowing > 0 else 0.0

    def states(times: Array) -> Array:
        y = path(times if until < t else np.minimum(times, now))
        if rest > 0:
            late = np.clip(times - now, 0.0, rest)[:, None]
            y[:, :2] += y[:, 2:] * late * (1 - late / (2 * rest))
            y[:, 2:] *= 1 - late / rest
        return rolling_state(y[:, :2], y[:, 2:], wz, radius)

    return Numeric(min(t, now), max(t, now) + rest, "roll", states, _steepest(states, t, now + rest - t))


def _sliding_state(position: Array, q: Array, contact: Array, wz: float, radius: float) -> Array:
    """States (n, 9) from v = q + (2/7) u and R w x z = q - (5/7) u."""
    out = rolling_state(position, q, wz, radius)
    out[:, 3:5] += 2 / 7 * contact
    out[:, 6] += 5 / 7 * contact[:, 1] / radius
    out[:, 7] -= 5 / 7 * contact[:, 0] / radius
    return out


def _when(path: Path, elapsed: Array) -> Array:
    """The ln|u| at which the slide has lasted `elapsed`: Newton on the path's own time, kept in brackets."""
    low = np.full(elapsed.shape, path.ends[-1])
    high = np.zeros(elapsed.shape)
    total = float(path(path.ends[-1:])[0, 0])
    log = np.clip(np.log1p(-elapsed / total * (1 - FINISH)), low, high)  # exact for constant friction
    for _ in range(50):
        time = path(log)[:, 0]
        late = time > elapsed
        low, high = np.where(late, log, low), np.where(late, high, log)
        h = 1e-6 * np.where(log < path.ends[-1] / 2, 1.0, -1.0)
        slope = (path(log + h)[:, 0] - time) / h
        new = log - (time - elapsed) / slope
        new = np.where((new >= low) & (new <= high), new, (low + high) / 2)
        if np.all(np.abs(new - log) * np.exp(log) < 1e-14):
            return np.asarray(new)
        log = new
    return np.asarray(log)


def _steepest(states: Any, t: float, lasts: float) -> float:
    """A bound of the acceleration along a leg: twice the largest found between samples."""
    times = np.linspace(t, t + lasts, 65)
    v = states(times)[:, 3:5]
    return float(2 * np.max(np.linalg.norm(np.diff(v, axis=0), axis=1)) / max(abs(lasts) / 64, 1e-300))
