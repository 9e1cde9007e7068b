"""Rolling and flying without closed form: when an effect bends the rolling loss or pushes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.kinematics import Array, rolling_state
from synthcam.model import Bodies, Model
from synthcam.sliding import NOWHERE, ROUGH, Other
from synthcam.spectral import DEEPEST, RESOLVED, Path, integrate

SLOWEST = 1e-7  # m/s: a ball slower than this has stopped
SHALLOW, SHORTEST = 7, 1e-4  # halvings of a piece; its share of what would stop the ball
MOST = 500  # pieces of a roll
LAWS = ("rolling", "push")


@dataclass(frozen=True)
class Piece:
    """Balls `who` from `begins` on for `spans` (both (k,), s); path: (x, y, vx, vy) against the share of the span."""

    who: Any
    begins: Array
    spans: Array
    path: Path


@dataclass(frozen=True)
class Rolls:
    """k rolls that begin at `time` (k,). until (k,): when each was solved to, or stopped. ends (k, 4): x, y, vx, vy.

    slow (k,): when the speed fell under SLOWEST; from there to `until` the deceleration is uniform.
    """

    time: Array
    until: Array
    slow: Array
    ends: Array
    pieces: tuple[Piece, ...]
    radius: Array
    wz: Array

    def plane(self, times: Array) -> Array:
        """(x, y, vx, vy) at times (k, m): (k, m, 4)."""
        out = np.repeat(self.ends[:, None], times.shape[1], axis=1)
        left = self.until - self.slow
        share = np.clip((times - self.slow[:, None]) / np.where(left > 0, left, 1)[:, None], 0.0, 1.0)[..., None]
        tail = np.where(left > 0, left, 0.0)[:, None, None] * self.ends[:, None, 2:] * (share - share**2 / 2)
        out[..., :2] += tail
        out[..., 2:] = np.where((left > 0)[:, None, None], out[..., 2:] * (1 - share), out[..., 2:])
        for piece in self.pieces:
            share = (times[piece.who] - piece.begins[:, None]) / piece.spans[:, None]
            here = (share >= 0) & (share <= 1)
            if np.any(here):
                values = piece.path(np.clip(share, 0, 1))
                out[piece.who] = np.where(here[..., None], values, out[piece.who])
        return out

    def states(self, times: Array) -> Array:
        """States (k, m, 9) of balls that roll."""
        y = self.plane(times)
        return rolling_state(y[..., :2], y[..., 2:], self.wz[:, None], self.radius[:, None])


def rolls(model: Model, state: Array, bodies: Bodies, time: Array, until: Array, other: Other | None = None) -> Rolls:
    """Rolls from `time` to `until` (k,), or to the stop; with until < time, back. States (k, 9), speeds over zero."""

    def acceleration(which: Any, t: Array, y: Array) -> Array:
        v = y[..., 2:4]
        speed = np.hypot(v[..., 0], v[..., 1])
        instant = _instant(model, bodies[which], t, y, other, which) | {"speed": speed}
        loss = model.laws("rolling", model.rolling_drag * speed + model.rolling_decel, instant)
        push = model.laws("push", np.zeros_like(v), instant)
        return np.asarray(5 / 7 * push - (loss / np.maximum(speed, 1e-300))[..., None] * v)

    return _march(acceleration, state, bodies, time, until, True, RESOLVED if other is None else ROUGH)


def flights(model: Model, state: Array, bodies: Bodies, time: Array, until: Array, other: Other | None = None) -> Rolls:
    """The plane part of flights from `time` to `until` (k,), with the push in full and no loss."""

    def acceleration(which: Any, t: Array, y: Array) -> Array:
        instant = _instant(model, bodies[which], t, y, other, which)
        return np.asarray(model.laws("push", np.zeros_like(y[..., 2:4]), instant))

    return _march(acceleration, state, bodies, time, until, False, RESOLVED if other is None else ROUGH)


def _instant(model: Model, bodies: Bodies, t: Array, y: Array, other: Other | None, which: Any) -> dict[str, Any]:
    instant: dict[str, Any] = dict(position=y[..., :2], velocity=y[..., 2:4], gravity=model.gravity)
    instant |= dict(radius=bodies.radius[:, None], mass=bodies.mass[:, None], of_a=bodies.of_a[:, None])
    instant["other"] = NOWHERE if other is None else other(t, which) - y[..., :2]
    return instant


def _march(
    acceleration: Any, state: Array, bodies: Bodies, time: Array, until: Array, stops: bool, resolved: float
) -> Rolls:
    """Pieces no longer than half of what would stop the ball, so that the speed never passes through zero in one."""
    y = np.concatenate([state[:, 0:2], state[:, 3:5]], axis=1)
    now, share_of_stop = time.astype(float).copy(), 0.5
    pieces: list[Piece] = []
    target = np.broadcast_to(until, now.shape).astype(float)
    # led by another ball, a path may lead nowhere: that is to be said soon
    shallow, deepest, most = (SHALLOW, DEEPEST, MOST) if resolved == RESOLVED else (4, 8, MOST // 10)
    while True:
        speed = np.hypot(y[:, 2], y[:, 3])
        who = np.flatnonzero((now != target) & ((speed > SLOWEST) | (not stops)))
        if len(who) == 0:
            break
        if len(pieces) > most:
            raise ValueError(f"a rolling ball does not settle: {most} pieces of its path")
        begins, goal = now[who], target[who]
        force = acceleration(who, begins[:, None], y[who][:, None])[:, 0]
        longest = share_of_stop * speed[who] / np.maximum(np.hypot(force[:, 0], force[:, 1]), 1e-300)
        longest = np.where(stops, longest, np.inf)
        last = np.abs(goal - begins) <= longest
        spans = np.where(last, goal - begins, np.sign(goal - begins) * np.where(last, 1.0, longest))

        def right(share: Array, z: Array, who: Any = who, begins: Any = begins, spans: Any = spans) -> Array:
            a = acceleration(who, begins[:, None] + spans[:, None] * share, z)
            return np.asarray(np.concatenate([z[..., 2:4], a], axis=-1) * spans[:, None, None])

        try:
            depth = deepest if share_of_stop < SHORTEST or not stops else shallow
            path = integrate(right, 0.0, 1.0, y[who], resolved, depth, few=True)
        except ValueError:
            if not stops or share_of_stop < SHORTEST:
                raise
            share_of_stop /= 4  # a force that grew has stopped a ball earlier than the one at the start would
            continue
        share_of_stop = min(2 * share_of_stop, 0.5)
        y[who] = path(np.ones((len(who), 1)))[:, 0]
        now[who] = np.where(last, goal, begins + spans)
        pieces.append(Piece(who, begins, spans, path))
    stopping = stops & (np.hypot(y[:, 2], y[:, 3]) <= SLOWEST) & (target > now)
    slow = now.copy()
    if np.any(stopping):
        who = np.flatnonzero(stopping)
        force = acceleration(who, now[who][:, None], y[who][:, None])[:, 0]
        now[who] += np.hypot(y[who, 2], y[who, 3]) / np.maximum(np.hypot(force[:, 0], force[:, 1]), 1e-300)
    return Rolls(time, now, slow, y, tuple(pieces), bodies.radius, state[:, 8])
