"""One ball of each of many pairs that push each other, on a piece of its motion: what acts on it, where that takes it.

A piece of motion is a Chebyshev series over a time of the pair's own. What a ball's speed is counted in - that of its
centre where it rolls, that of its lowest point where it slides - is led as a size s and a direction e, turned by psi:
    s' = -A,   psi' = (e x f)/s,   A = loss - f . e
with f the push, of which a rolling ball takes 5/7. So each ball feels the other through f alone, and Picard iteration
of both gains digits at every turn. A piece on which s comes to zero ends there: with x the share of its unknown length
T, s = T (1 - x) M(x), where M is the mean of A over what is left of the piece, and s(0) gives T.

Where a spin drills, a slide has two parts: it drills until its slip is `sliding.ending_slip`; the rest is as if nothing
drilled.

A ball that starts from rest goes after the push: its lag d behind the push's direction phi obeys
    (s/f) d' + sin d = (s/f) phi',
which has one smooth solution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.dynamics.collocation import matrices, product
from synthcam.dynamics.kinematics import Array, contact_velocity, fly, plate_state, rolling_velocity
from synthcam.dynamics.rolling import SLOWEST
from synthcam.model import Bodies, Model

Flags = NDArray[np.bool_]
SMALLEST = 1e-300
FAINT = 1e-30  # m/s, m/s^2: stands in for nothing; friction that spins weaken divides by no less
STILL = 1e-12  # m/s: slower than this is rest, or rolling for a contact velocity
TRUE, STEADY = 3e-14, 5e-13  # m, m/s: of the last coefficients


@dataclass(frozen=True)
class Mesh:
    """Nodes x of [0, 1], and matrices to multiply values on them with.

    They give the integral from 0; the mean over what is left; the integral from 0 of values/(1 - x), at x = 1 as a
    little before; the derivative; the coefficients.
    """

    x: Array
    integral: Array
    rest: Array
    turn: Array
    slope: Array
    coefficients: Array


@cache
def mesh(size: int) -> Mesh:
    on = matrices(size)
    x = (1 + on.nodes) / 2
    gauss, weights = np.polynomial.legendre.leggauss(size)
    gauss, weights = (1 + gauss) / 2, weights / 2

    def at(where: Array) -> Array:
        return np.asarray(on.coefficients @ np.polynomial.chebyshev.chebvander(2 * where - 1, size - 1).T)

    rest, turn, last = np.empty((size, size)), np.empty((size, size)), np.eye(size)[:, -1]
    for k in range(size):
        rest[:, k] = at(x[k] + (1 - x[k]) * gauss) @ weights
        early = x[k] * gauss
        turn[:, k] = (at(early) - last[:, None]) @ (weights * x[k] / (1 - early))
        turn[:, k] -= np.log(1 - x[k] if k < size - 1 else (1 - x[-2]) / 8) * last
    slope = 2 * on.coefficients @ on.slope @ np.linalg.inv(on.coefficients)
    return Mesh(x, on.integral / 2, rest, turn, slope, on.coefficients)


class Ball:
    """One ball of each of k pairs in one piece, as the iteration has it: vectors (2, k, n), numbers (k, n).

    It may rest, creep (roll, from rest or, at the piece's other end, to it), roll, drill (slide while a spin has
    friction fade, until the slip is `floor`, (k,)), slide or fly.
    """

    def __init__(self, model: Model, mode: str, body: Bodies, state: Array, floor: float) -> None:
        self.model, self.mode, self.state, self.body = model, mode, state, body
        self.fixed: dict[str, Any] = dict(gravity=model.gravity, radius=body.radius[:, None], mass=body.mass[:, None])
        self.fixed |= dict(of_a=body.of_a[:, None], ball=model.ball)
        self.place, velocity = state[:, :2].T[..., None], state[:, 3:5].T[..., None]
        self.slides, self.drills = mode in ("slide", "drill"), mode == "drill"
        counted = contact_velocity(state, body.radius).T[..., None] if self.slides else velocity
        self.first = np.hypot(counted[0], counted[1])
        self.hat = counted / np.maximum(self.first, SMALLEST)
        self.q0 = rolling_velocity(state, body.radius).T[..., None] if self.slides else velocity
        self.floor = np.full_like(self.first, floor if self.drills else 0.0)
        self.x, self.v, self.s, self.e = self.place, velocity, self.first, self.hat
        self.q, self.wz = self.q0, state[:, 8][:, None]
        self.away = np.zeros_like(self.place)
        self.stays = np.ones(len(state), dtype=bool)  # s over zero
        self.size = 1

    def feel(self, other: Array) -> None:
        """Everything that acts on it, the other ball being at `other`."""
        laws, mode = self.model.laws, self.mode
        if mode == "rest":
            return
        x, v = last_axis(self.x), last_axis(self.v)
        if mode == "creep":
            v = last_axis(np.maximum(self.s, SLOWEST) * self.e)
        instant = self.fixed | dict(position=x, velocity=v, other=last_axis(other - self.x))
        push = np.asarray(laws("push", last_axis(np.zeros_like(self.x)), instant)).transpose(2, 0, 1)
        self.push = push
        if mode == "fly":
            return
        if self.slides:
            spin = self.wz if self.drills or not laws.bent("drilling") else 0 * self.wz
            instant |= dict(slip_speed=np.maximum(self.s, FAINT), slip=last_axis(self.e), spin=spin)
            friction = laws("friction", self.model.sliding_friction, instant)
            load = laws("normal_load", self.model.gravity, instant)
            loss = 3.5 * friction * load
            if self.drills:
                self.twist = laws("drilling", 0.0, instant | {"friction": friction, "load": load}) + 0 * self.s
        else:
            push = 5 / 7 * push
            base = self.model.rolling_drag * np.maximum(self.s, 0.0) + self.model.rolling_decel
            speed = np.maximum(self.s, SLOWEST) if mode == "creep" else self.s
            loss = laws("rolling", base, instant | {"speed": speed})
        if mode == "creep":
            self.pull, self.loss = push, loss + 0 * self.s
            return
        self.loss = loss
        self.slowing = loss - (push[0] * self.e[0] + push[1] * self.e[1])
        self.across = self.e[0] * push[1] - self.e[1] * push[0]

    def excess(self) -> Array:
        """By how much the pull on a creeping ball exceeds what would hold it."""
        return np.asarray(np.hypot(*self.pull) - np.maximum(self.loss, self.model.rolling_decel))

    def ending(self) -> Array:
        """How long until s is down, (k, 1)."""
        self.left = product(self.slowing[None] + np.zeros((1, 1, self.size)), self.on.rest)[0]
        return np.asarray((self.first - self.floor) / self.left[:, :1])

    def go(self, lasts: Array, ends: bool, anchor: int = 0) -> None:
        """The next iterate, of a piece that lasts so long, (k, 1)."""
        on, mode = self.on, self.mode
        if mode == "rest":
            return
        if mode == "fly":
            self.v = self.q0 + lasts * product(self.push, on.integral)
            self._moved(lasts)
            return
        if mode == "creep":
            self._creep(lasts, anchor)
            self._moved(lasts)
            return
        if ends:
            self.s = self.floor + lasts * self.left * (1 - on.x)
        else:
            s = self.first - lasts * product(self.slowing[None], on.integral)[0]
            self.stays = s[:, -1] > self.floor[:, 0]
            self.s = np.maximum(s, 1e-3 * self.first)  # a path that is only tried
        if ends and not self.drills:
            self._turn(product((self.across / self.left)[None], on.turn)[0])
        else:
            self._turn(lasts * product((self.across / self.s)[None], on.integral)[0])
        if self.slides:
            self.q = self.q0 + 5 / 7 * lasts * product(self.push, on.integral)
            self.v = self.q + 2 / 7 * self.s * self.e
            if self.drills:
                self.wz = self.state[:, 8:] + lasts * product(self.twist[None], on.integral)[0]
        else:
            self.v = self.s * self.e
        self._moved(lasts)

    def _turn(self, psi: Array) -> None:
        half = np.tan(psi / 2)  # numpy's sine and cosine take longer
        double = 2 / (1 + half * half)
        s, c = double * half, double - 1
        self.e = np.empty((2, *psi.shape))
        np.subtract(c * self.hat[0], s * self.hat[1], out=self.e[0])
        np.add(s * self.hat[0], c * self.hat[1], out=self.e[1])

    def _moved(self, lasts: Array) -> None:
        self.away = lasts * product(self.v, self.on.integral)
        self.x = self.place + self.away

    def guess(self, on: Mesh, lasts: Array, ends: bool, anchor: int = 0) -> None:
        """A first iterate, from the forces at the start."""
        self.on, self.size, x = on, len(on.x), on.x
        if self.mode == "rest":
            self.x = np.broadcast_to(self.place, (*self.place.shape[:2], self.size))
            self.v = self.away = np.zeros_like(self.x)
            return
        if self.mode == "fly":
            self.v = self.q0 + self.push * (lasts * x)
        elif self.mode == "creep":
            pull = np.hypot(*self.pull)
            self.hat = self.pull / np.maximum(pull, SMALLEST)
            self.lag = np.zeros((len(pull), self.size))
            self.s = np.abs(lasts * (x - x[anchor])) * np.maximum(self.excess(), 0.0) / 2
            self._turn(self.lag)
            self.v = self.s * self.e
        else:
            self.s = self.floor + (self.first - self.floor) * (1 - x) if ends else self.first - self.slowing * lasts * x
            self.s = np.maximum(self.s, 1e-3 * self.first if self.drills else 0.0)
            self.e = np.repeat(self.hat, self.size, axis=-1)
            self.q = np.repeat(self.q0, self.size, axis=-1)
            self.v = self.q + 2 / 7 * self.s * self.e if self.slides else self.s * self.e
            self.wz = np.repeat(self.wz, self.size, axis=-1)
        self._moved(lasts)

    def _creep(self, lasts: Array, anchor: int) -> None:
        """A creeping ball's speed and lag behind the pull."""
        on = self.on
        size = np.maximum(np.hypot(*self.pull), SMALLEST)
        along = self.hat[0] * self.pull[0] + self.hat[1] * self.pull[1]
        phi = np.arctan2(self.hat[0] * self.pull[1] - self.hat[1] * self.pull[0], along)
        gain = product((size * np.cos(self.lag) - self.loss)[None], on.integral)[0]
        self.s = lasts * (gain - gain[:, anchor, None])
        weight = self.s / (lasts * size)
        lines = weight[..., None] * on.slope.T
        lines[:, range(self.size), range(self.size)] += np.sinc(self.lag / np.pi)
        self.lag = np.linalg.solve(lines, (weight * (phi @ on.slope))[..., None])[..., 0]
        self._turn(phi - self.lag)
        self.v = self.s * self.e

    def sound(self) -> Any:
        """Is s over zero all along, (k,)?"""
        return self.stays & (self.s.min(axis=1) >= 0) if self.slides or self.mode in ("creep", "roll") else self.stays

    def over(self, lasts: float) -> bool:
        """Has its drilling, slide, roll or flight ended with a piece that lasts so long?"""
        if self.mode == "fly":
            return lasts >= self.flies()
        counts = self.slides or self.mode == "roll"
        return counts and bool(self.s[0, -1] <= self.floor[0, 0] * (1 + 1e-12) + STILL)

    def last(self, lasts: Array) -> Array:
        """States (k, 9) at the piece's end."""
        x, v, radius, wz = self.x[..., -1].T, self.v[..., -1].T, self.body.radius, self.wz[:, -1]
        if self.mode == "fly":
            out = fly(self.state, self.model.gravity, lasts)[:, 0]
            out[:, 0:2], out[:, 3:5] = x, v
            return out
        if self.slides:
            return plate_state(x, self.q[..., -1].T, (self.s * self.e)[..., -1].T, wz, radius)
        return plate_state(x, v, np.zeros(2), wz, radius)

    def flies(self) -> float:
        """How long it stays in the air."""
        up, height = float(self.state[0, 5]), max(float(self.state[0, 2] - self.body.radius[0]), 0.0)
        return (up + math.sqrt(up * up + 2 * self.model.gravity * height)) / self.model.gravity

    def coefficients(self) -> tuple[Array, Array]:
        """Of x, y, vx, vy and, in slides, qx, qy, wz: (c, k, nodes); and the last ones over what they may be, (k,)."""
        found = product(np.concatenate([self.x, self.v]), self.on.coefficients)
        counted = found[2:]
        if self.slides:
            more = np.concatenate([self.q, self.wz[None] + np.zeros((1, 1, self.size))])
            found = np.concatenate([found, product(more, self.on.coefficients)])
            counted = (
                found[2:6] if self.drills else found[4:6]
            )  # where it ends hangs on a slip that hardly falls any more
        return found, np.maximum(most(found[:2, :, -2:]) / TRUE, most(counted[..., -2:]) / STEADY)


def most(vectors: Array) -> Array:
    """The largest part of any of (2, k, few): (k,)."""
    each = np.abs(vectors).max(axis=0)
    out = each[:, 0]
    for column in each.T[1:]:  # quicker than a maximum over a short axis
        out = np.maximum(out, column)
    return np.asarray(out)


def last_axis(vectors: Array) -> Array:
    """(2, k, n) as effects want it: (k, n, 2)."""
    return vectors.transpose(1, 2, 0)
