"""Rolling and flying without closed form: when an effect bends the rolling loss or pushes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.dynamics.collocation import DEEPEST, Parts, integrate, matrices, product, series
from synthcam.dynamics.kinematics import Array, rolling_state
from synthcam.dynamics.sliding import NOWHERE
from synthcam.model import Bodies, Model

SLOWEST = 1e-7  # m/s: a ball slower than this has stopped
SHALLOW, SHORTEST = 7, 1e-4  # halvings of a piece; its share of what would stop the ball
MOST = 1000  # stretches of a roll
LAWS = ("rolling", "push")
SLIGHT = 1e-16  # m: coefficients of all balls that together are not worth their time


@dataclass(frozen=True)
class Stretch:
    """Balls `who` (indices (k,)) between the times `begins` and `ends`, (k,), in this order or the other.

    coefficients (4, k, n): x, y, vx, vy as Chebyshev series over that time.
    """

    who: Any
    begins: Array
    ends: Array
    coefficients: Array

    def plane(self, times: Array) -> Array:
        """(x, y, vx, vy) at times (k, m): (4, k, m)."""
        return series(self.coefficients, self._local(times))

    def places(self, times: Array) -> Array:
        """Centres (2, k, m)."""
        return series(self.coefficients[:2], self._local(times))

    def means(self, middle: Array, wide: float) -> Array:
        """Centres (2, k, m) averaged over the time `wide` about `middle` (k, m), exactly.

        The mean of f over x +- h is the sum of h^(2j)/(2j+1)! f^(2j)(x).
        """
        half = np.minimum(np.abs(wide / (self.ends - self.begins)), 1.0)[:, None]  # a longer one does not lie within
        worth = np.flatnonzero(_sizes(self.coefficients[:2]) > SLIGHT).max(initial=1)
        term = mean = self.coefficients[:2, :, : worth + 1]
        curvature = matrices(term.shape[-1]).curvature
        for j in range(1, (term.shape[-1] + 1) // 2):
            term = product(term, curvature) * (half * half / (2 * j * (2 * j + 1)))
            mean = mean + term
            if _sizes(term).max() < SLIGHT:
                break
        return series(mean, self._local(middle))

    def _local(self, times: Array) -> Array:
        return (2 * times - (self.begins + self.ends)[:, None]) / (self.ends - self.begins)[:, None]


def _sizes(coefficients: Array) -> Array:
    """(c, k, n) -> (n,): roots of sums of squares, no less than any; a maximum takes numpy longer."""
    return np.asarray(np.sqrt(np.einsum("ckn,ckn->n", coefficients, coefficients)))


@dataclass(frozen=True)
class Rolls:
    """k rolls that begin at `time` (k,). until (k,): when each was solved to, or stopped. ends (4, k): x, y, vx, vy."""

    time: Array
    until: Array
    ends: Array
    stretches: tuple[Stretch, ...]
    radius: Array
    wz: Array

    def plane(self, times: Array) -> Array:
        """(x, y, vx, vy) at times (k, m): (4, k, m)."""
        out = np.repeat(self.ends[..., None], times.shape[1], axis=-1)
        for stretch in self.stretches:
            mine, a, b = times[stretch.who], stretch.begins[:, None], stretch.ends[:, None]
            here = (mine >= np.minimum(a, b)) & (mine <= np.maximum(a, b))
            if np.any(here):
                values = stretch.plane(np.clip(mine, np.minimum(a, b), np.maximum(a, b)))
                out[:, stretch.who] = np.where(here, values, out[:, stretch.who])
        return out

    def states(self, times: Array) -> Array:
        """States (k, m, 9) of balls that roll."""
        return roller(self.plane(times), self.wz, self.radius)


def roller(plane: Array, wz: Array, radius: Array) -> Array:
    """States (k, m, 9) of balls that roll, from (x, y, vx, vy), (4, k, m); wz and radius (k,)."""
    x, v = np.moveaxis(plane[:2], 0, -1), np.moveaxis(plane[2:], 0, -1)
    return rolling_state(x, v, wz[:, None], radius[:, None])


def rolls(model: Model, state: Array, bodies: Bodies, time: Array, until: Array) -> Rolls:
    """Rolls from `time` to `until` (k,), or to the stop; with until < time, back. States (k, 9), speeds over zero."""

    def acceleration(which: Any, y: Array) -> Array:
        speed = np.hypot(y[2], y[3])
        instant = _instant(model, bodies[which], y) | {"speed": speed}
        loss = model.laws("rolling", model.rolling_drag * speed + model.rolling_decel, instant)
        out = y[2:4] * (-loss / np.maximum(speed, 1e-300))
        return np.asarray(out + 5 / 7 * _push(model, y, instant) if model.laws.bent("push") else out)

    placed = "position" in model.laws.asked("rolling") | model.laws.asked("push")
    return _march(acceleration, state, bodies, time, until, True, None if placed else 1)


def flights(model: Model, state: Array, bodies: Bodies, time: Array, until: Array) -> Rolls:
    """The plane part of flights from `time` to `until` (k,), with the push in full and no loss."""

    def acceleration(which: Any, y: Array) -> Array:
        return _push(model, y, _instant(model, bodies[which], y))

    return _march(acceleration, state, bodies, time, until, False)


def _push(model: Model, y: Array, instant: dict[str, Any]) -> Array:
    nothing = np.zeros_like(y[2:4]).transpose(1, 2, 0)
    return np.asarray(model.laws("push", nothing, instant)).transpose(2, 0, 1)


def _instant(model: Model, bodies: Bodies, y: Array) -> dict[str, Any]:
    place, velocity = y[:2].transpose(1, 2, 0), y[2:4].transpose(1, 2, 0)
    instant: dict[str, Any] = dict(position=place, velocity=velocity, gravity=model.gravity, other=NOWHERE)
    return instant | dict(
        ball=model.ball, radius=bodies.radius[:, None], mass=bodies.mass[:, None], of_a=bodies.of_a[:, None]
    )


def _march(
    acceleration: Any,
    state: Array,
    bodies: Bodies,
    time: Array,
    until: Array,
    stops: bool,
    feed: int | None = None,
) -> Rolls:
    """Pieces no longer than half of what would stop the ball, so that the speed never passes through zero in one."""
    y = np.stack([state[:, 0], state[:, 1], state[:, 3], state[:, 4]])
    now, share_of_stop = time.astype(float).copy(), 0.5
    stretches: list[Stretch] = []
    target = np.broadcast_to(until, now.shape).astype(float)
    while len(stretches) <= MOST:
        speed = np.hypot(y[2], y[3])
        who = np.flatnonzero((now != target) & ((speed > SLOWEST) | (not stops)))
        if len(who) == 0:
            break
        begins, goal, start = now[who], target[who], y[:, who]
        force = acceleration(who, start[..., None])
        longest = share_of_stop * speed[who] / np.maximum(np.hypot(force[0, :, 0], force[1, :, 0]), 1e-300)
        longest = np.where(stops, longest, np.inf)
        last = np.abs(goal - begins) <= longest
        spans = np.where(last, goal - begins, np.sign(goal - begins) * np.where(last, 1.0, longest))

        def right(_: Array, z: Array, who: Any = who, spans: Any = spans) -> Parts:
            yield slice(2, 4), acceleration(who, z) * spans[:, None]
            yield slice(0, 2), z[2:4] * spans[:, None]

        def guess(share: Array, start: Any = start, force: Any = force, spans: Any = spans) -> Array:
            t = spans[:, None] * share
            v = start[2:, :, None] + force * t
            return np.concatenate([start[:2, :, None] + (start[2:, :, None] + v) / 2 * t, v])

        try:
            depth = DEEPEST if share_of_stop < SHORTEST or not stops else SHALLOW
            path = integrate(right, (0.0, 1.0), start, guess, depth, feed=feed)
        except ValueError:
            if not stops or share_of_stop < SHORTEST:
                raise
            share_of_stop /= 4  # a force that grew has stopped a ball earlier than the one at the start would
            continue
        share_of_stop = min(2 * share_of_stop, 0.5)
        knots = begins + path.ends[:, None] * spans
        knots[-1] = np.where(last, goal, knots[-1])
        stretches += [Stretch(who, knots[k], knots[k + 1], c) for k, c in enumerate(path.coefficients)]
        y[:, who], now[who] = path.last(), knots[-1]
    else:
        raise ValueError(f"a rolling ball does not settle: {MOST} stretches of its path")
    stopping = np.flatnonzero(stops & (np.hypot(y[2], y[3]) <= SLOWEST) & (target > now))
    if len(stopping):
        begins, start = now[stopping], y[:, stopping]
        force = acceleration(stopping, start[..., None])[..., 0]
        left = np.hypot(start[2], start[3]) / np.maximum(np.hypot(force[0], force[1]), 1e-300)
        now[stopping] += left
        stretches.append(_stop(stopping, begins, begins + left, start))
        y[:2, stopping] += left / 2 * start[2:]
        y[2:, stopping] = 0.0
    return Rolls(time, now, y, tuple(stretches), bodies.radius, state[:, 8])


def _stop(who: Any, begins: Array, ends: Array, start: Array) -> Stretch:
    """A uniform deceleration to rest, as series: x + v t (s - s^2/2), v (1 - s), with s = (1 + z)/2."""
    far = (ends - begins) * start[2:]
    places = np.stack([start[:2] + 5 / 16 * far, far / 4, -far / 16], axis=-1)
    speeds = np.stack([start[2:] / 2, -start[2:] / 2, 0 * far], axis=-1)
    return Stretch(who, begins, ends, np.concatenate([places, speeds]))
