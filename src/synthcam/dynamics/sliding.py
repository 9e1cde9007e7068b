"""Sliding without closed form: when an effect bends friction, load, the torque about the vertical, or pushes.

Integrated in q = (5 v + 2 R w x z)/7 and the contact velocity u = |u| (cos th, sin th), v = q + (2/7) u:
    q' = (5/7) p,   |u|' = -(7/2) mu N + p . u_hat = -A,   th' = (u_hat x p)/|u|,   x' = v
with p the push, N the load over the mass, and cos th, sin th in place of th. Towards the end of the slide th' grows as
1/|u|; with ln|u| for the time every right-hand side is smooth, and the slide's end is a known place instead of an event
to search for. Where nothing can turn the slip and A depends on |u| alone, t and x are integrals over |u|.

Where a spin w drills, friction fades with the slip as F u/(u + c), c ~ |w|. A push p then keeps a slip of
u = c p/(F - p) creeping, micrometres a second, until the spin is gone, perhaps a second later. For all that can be seen
such a ball rolls, and what slows a rolling ball slows it: so a slide is over once its slip is small beside the
drilling, at `ending_slip`, and what is left of the slip ends as if nothing drilled. That slip is fixed when the slide
begins, and is the same whether the ball is solved alone or with another.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from synthcam.dynamics.collocation import RESOLVED, SIZES, Parts, Path, integrate, matrices, product
from synthcam.dynamics.kinematics import Array, contact_velocity, plate_state, rolling_velocity
from synthcam.dynamics.slide_series import Reading
from synthcam.model import Bodies, Model

FINISH = 1e-5  # of the first slip: the rest of the slide, a microsecond, is taken as a uniform deceleration
PROBE = 1e-9  # m/s: a slip at which it is seen how far a spin has friction fade
SMALL = 0.1  # of c: so small a slip beside the drilling, friction being a tenth, is no longer a slide
KNOTS = (0.0, -3.8, float(np.log(FINISH)))  # of ln(|u|/|u0|)
SHARES = (1.0, 0.0)  # of |u|/|u0|
LAWS = ("friction", "normal_load", "push", "drilling")
STRAIGHT = {"slip_speed", "slip", "gravity", "radius", "of_a"}  # laws that ask no more leave the slip's direction
NOWHERE = np.full(2, np.inf)  # where the other ball is when there is none
FEW = 28  # nodes of a logarithmic piece, first
CLOSING = 1 - ((1 - matrices(10).nodes) / 2) ** 3  # of the uniform end's time: nodes in the cube root of what is left


@dataclass(frozen=True)
class Slides:
    """k slides that begin together at elapsed time 0, solved: (cos th, sin th, wz, qx, qy, x, y, t) against `knots`.

    lasts (k,): how long, s. cut: when the uniform end begins; slowing (k,), push (2, k), twist (k,) in it. The path
    runs over |u|/|u0| where it is straight, else over the logarithm of that divided by `stretch` (k,). drills: a
    spin drills, and friction fades with the slip.
    """

    path: Path
    straight: bool
    drills: bool
    first: Array
    stretch: Array
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
        plane = self._closing(self.path.last()[..., None], self._slip(), (self.lasts - self.cut)[:, None])[..., 0]
        return plate_state(plane[0:2].T, plane[2:4].T, plane[4:6].T, plane[6], self.radius)

    def means(self, middle: Array, wide: Any) -> Array:
        """Centres (2, k, m) averaged over the times `wide`, a number or (k, m), about elapsed times (k, m)."""
        return self._reading.means(middle, wide)

    @cached_property
    def _reading(self) -> Reading:
        pieces = [(y[7], y[5:7]) for _, y in self.path.nodes()]
        if self.straight:
            return Reading.of(pieces, 1)
        late = (self.lasts - self.cut)[:, None] * CLOSING
        pieces.append((self.cut[:, None] + late, self._closing(self.path.last()[..., None], self._slip(), late)[:2]))
        return Reading.of(pieces, 1 if self.drills else 3)  # where friction fades, the end is as smooth as the rest

    def _slip(self) -> Array:
        """At the path's end, (k, 1)."""
        return np.asarray(self.first * (0.0 if self.straight else FINISH**self.stretch))[:, None]

    def _closing(self, y: Array, slip: Array, late: Array) -> Array:
        """(x, y, qx, qy, ux, uy, wz), (7, k, m), the times `late` (k, m) after such y (8, k, m) and |u| (k, m)."""
        left, push = np.maximum(slip - self.slowing[:, None] * late, 0.0), self.push[..., None] * late
        out = np.empty((7, *late.shape))
        out[0:2] = y[5:7] + (y[3:5] + 5 / 14 * push + (slip + left) / 7 * y[:2]) * late
        out[2:4], out[4:6], out[6] = y[3:5] + 5 / 7 * push, left * y[:2], y[2] + self.twist[:, None] * late
        return out

    def _exact(self, elapsed: Array) -> Array:
        """(x, y, qx, qy, ux, uy, wz), (7, k, m)."""
        cut = self.cut[:, None]
        along = self._when(np.minimum(elapsed, cut))
        slip = self.first[:, None] * (along if self.straight else np.exp(along * self.stretch[:, None]))
        return self._closing(self.path(along), slip, np.clip(elapsed - cut, 0.0, (self.lasts - self.cut)[:, None]))

    @cached_property
    def _timing(self) -> Path:
        """The time and its slope along the path."""
        wide, pieces = np.diff(self.path.ends), self.path.coefficients
        return Path(self.path.ends, tuple(_with_slope(c[7], w) for c, w in zip(pieces, wide, strict=True)))

    def _when(self, elapsed: Array) -> Array:
        """Where on the path a slide has lasted `elapsed`: Newton on the path's own time, kept in brackets."""
        end = 0.0 if self.straight else FINISH
        left = 1 - elapsed / self.cut[:, None] * (1 - end)  # exact for constant friction
        low, high = np.full(elapsed.shape, self.path.ends[-1]), np.full(elapsed.shape, self.path.ends[0])
        along = np.clip(left if self.straight else np.log(np.maximum(left, end)), low, high)
        for _ in range(60):
            time, slope = self._timing(along)
            late = time > elapsed
            low, high = np.where(late, along, low), np.where(late, high, along)
            new = along - (time - elapsed) / np.where(slope < 0, slope, -np.inf)
            new = np.where((new >= low) & (new <= high), new, (low + high) / 2)
            if np.all(np.abs((new - along) * slope) < 1e-8 * self.cut[:, None]):  # squared by this turn
                return np.asarray(new)
            along = new
        return np.asarray(along)


def _with_slope(c: Array, wide: float) -> Array:
    """A series (k, n) and its derivative: (2, k, n)."""
    return np.stack([c, product(c[None], matrices(c.shape[-1]).slope)[0] * (2 / wide)])


@dataclass(frozen=True)
class _Forces:
    """What acts on k sliding balls. fixed: what the laws may ask for that does not change."""

    model: Model
    fixed: dict[str, Any]
    pushes: bool
    drills: bool
    spins: Any = 1.0  # (k, 1): 0 for a ball whose spin no longer matters

    @classmethod
    def of(cls, model: Model, bodies: Bodies, other: Array = NOWHERE) -> _Forces:
        fixed: dict[str, Any] = dict(gravity=model.gravity, radius=bodies.radius[:, None])
        fixed |= dict(mass=bodies.mass[:, None], of_a=bodies.of_a[:, None], other=other, ball=model.ball)
        return cls(model, fixed, model.laws.bent("push"), model.laws.bent("drilling"))

    def at(self, slip: Array, y: Array) -> tuple[Array, Any, Any, Any]:
        """A (k, n), u_hat x p, p (2, k, n) and dwz/dt for slip speeds (k, n) and y (8, k, n)."""
        model, laws, hat = self.model, self.model.laws, y[:2]
        v = y[3:5] + (2 / 7 * slip) * hat
        instant = self.fixed | dict(slip_speed=slip, slip=_last(hat), position=_last(y[5:7]), velocity=_last(v))
        instant |= dict(spin=y[2] * self.spins)
        friction = laws("friction", model.sliding_friction, instant)
        load = laws("normal_load", model.gravity, instant)
        slowing = 3.5 * friction * load + np.zeros_like(slip)
        twist = laws("drilling", 0.0, instant | {"friction": friction, "load": load}) if self.drills else 0.0
        push, across = 0.0, 0.0
        if self.pushes:
            push = laws("push", _last(np.zeros_like(v)), instant).transpose(2, 0, 1)
            slowing -= push[0] * hat[0] + push[1] * hat[1]
            across = hat[0] * push[1] - hat[1] * push[0]
        return slowing, across, push, twist

    def ending(self, slip: Array, y: Array) -> tuple[Array, Any, Any, Any]:
        """The same where they end the slide. Raises ValueError where they do not."""
        found = self.at(slip, y)
        if not np.all(found[0] > 0):
            raise ValueError("sliding friction does not end the slide: the push along the slip is too strong")
        return found


def ending_slip(model: Model, state: Array, bodies: Bodies, other: Array = NOWHERE) -> Array:
    """Where a spin drills: the slips (k,), m/s, at which slides that begin in these states (k, 9) are as good as over.

    c sqrt(SMALL^2 + (2 p/(F - p))^2), no less than FINISH of the first one: small beside the drilling, twice the creep
    at least. other: places relative to these balls, (k, 1, 2) or NOWHERE.
    """
    u, q = contact_velocity(state, bodies.radius), rolling_velocity(state, bodies.radius)
    first = np.hypot(u[:, 0], u[:, 1])
    hat = u.T / np.maximum(first, 1e-300)
    y = np.stack([*hat, state[:, 8], *q.T, *state[:, 0:2].T, np.zeros(len(state))])[..., None]
    slip, forces = np.full((len(state), 1), PROBE), _Forces.of(model, bodies, other)
    found = [dataclasses.replace(forces, spins=spins).at(slip, y) for spins in (0.0, 1.0)]
    push = found[0][2] + np.zeros((2, len(state), 1))
    along = push[0] * y[0] + push[1] * y[1]
    whole, faded = (np.maximum(slowing + along, 1e-300) for slowing, *_ in found)
    size = np.hypot(push[0], push[1])
    creep = size / np.maximum(whole - size, SMALL * whole)
    beside = PROBE * (whole / faded - 1) * np.sqrt(SMALL**2 + 4 * creep**2)
    return np.asarray(np.maximum(beside[:, 0], FINISH * first))


def _guess(forces: _Forces, first: Array, stretch: Array, start: Array) -> Callable[[Array], Array]:
    """The slides were all forces what they are at their start (8, k)."""
    slowing, across, push, twist = forces.ending(first[:, None], start[..., None])

    def guess(log: Array) -> Array:
        log = log * stretch[:, None]
        share = np.exp(log)
        t = first[:, None] * (1 - share) / slowing
        half = across / slowing / -2 * log  # of the angle turned, or its tangent
        cos, sin = (1 - half * half) / (1 + half * half), 2 * half / (1 + half * half)
        y = np.repeat(start[..., None], log.shape[-1], axis=-1)
        y[5:7] += (y[3:5] + first[:, None] * (1 + share) / 7 * y[:2]) * t
        y[0], y[1] = y[0] * cos - y[1] * sin, y[1] * cos + y[0] * sin
        y[2], y[7] = y[2] + twist * t, t
        y[3:5] += 5 / 7 * push * t
        return y

    return guess


def slides(model: Model, state: Array, bodies: Bodies) -> Slides:
    """The slides that start from states (k, 9), each ball alone. Raises ValueError when a slip would grow, not end."""
    u, q = contact_velocity(state, bodies.radius), rolling_velocity(state, bodies.radius)
    first = np.hypot(u[:, 0], u[:, 1])
    laws, forces = model.laws, _Forces.of(model, bodies)
    pushes, drills, cut = forces.pushes, forces.drills, FINISH * first
    if drills:
        late = ending_slip(model, state, bodies)
        cut = np.where(late < first, late, cut)
        forces = dataclasses.replace(forces, spins=1.0 * (late < first)[:, None])

    def right(log: Array, y: Array) -> Parts:
        slip = first[:, None] * np.exp(log * stretch[:, None])
        slowing, across, push, twist = forces.ending(slip, y)
        per = stretch[:, None] / slowing
        rate, turn = -slip * per, across * per  # dt and -dth by the path's logarithm
        if pushes:
            out = np.empty((2, *rate.shape))
            np.multiply(turn, y[1], out=out[0])
            np.multiply(-turn, y[0], out=out[1])
            yield slice(0, 2), out
        if drills:
            yield slice(2, 3), (twist * rate)[None]
        if pushes:
            yield slice(3, 5), 5 / 7 * push * rate
        v = y[3:5] + (2 / 7 * slip) * y[:2]
        yield slice(5, 7), v * rate
        yield slice(7, 8), rate[None]

    start = np.stack([*u.T / first, state[:, 8], *q.T, *state[:, 0:2].T, np.zeros(len(state))])
    stretch = np.log(cut / first) / KNOTS[-1] if drills else np.ones_like(first)
    if not pushes and not drills and all(laws.asked(law) <= STRAIGHT for law in ("friction", "normal_load")):
        path = _straight(lambda slip, y: forces.ending(slip, y)[0], first, start)
        if path is not None:
            lasts, nothing = path.last()[7], np.zeros_like(first)
            ending = lasts, lasts, nothing, np.zeros((2, len(first))), nothing
            return Slides(path, True, False, first, stretch, bodies.radius, *ending)
    asked = set().union(*(laws.asked(law) for law in LAWS))
    turning = pushes + drills
    feed = None if "position" in asked else max(turning + (pushes and "velocity" in asked), 1)
    path = integrate(right, KNOTS, start, _guess(forces, first, stretch, start), few=FEW, feed=feed)
    last, slip = path.last(), first * FINISH**stretch
    still = np.where((np.arange(8) == 2)[:, None], 0.0, last) if drills else last  # no spin
    slowing, _, push, twist = forces.ending(slip[:, None] / 2, still[..., None])
    push, twist = (np.broadcast_to(f, (*lead, len(slip), 1))[..., 0] for f, lead in ((push, (2,)), (twist, ())))
    when, slowing = last[7], slowing[:, 0]
    return Slides(path, False, drills, first, stretch, bodies.radius, when, when + slip / slowing, slowing, push, twist)


def _last(vectors: Array) -> Array:
    """(2, k, n) as effects want it: (k, n, 2)."""
    return vectors.transpose(1, 2, 0)


def _straight(slowing: Callable[[Array, Array], Array], first: Array, start: Array) -> Path | None:
    """The path over |u|/|u0| of slides whose A depends on |u| alone; None where that is not smooth."""
    for size in (SIZES[0], SIZES[-1], 2 * SIZES[-1]):
        on = matrices(size)
        slip = first[:, None] * (1 - on.nodes) / 2
        whole = np.repeat(start[..., None], size, axis=-1)
        rate = first[:, None] / 2 / slowing(slip, whole)
        last = np.abs(product(rate[None], on.coefficients[:, -3:])).max(axis=-1)
        if np.all(last < RESOLVED * rate.max(axis=-1)):
            time, path = product(np.stack([rate, rate * slip]), on.integral)
            whole[7] = time
            whole[5:7] += whole[3:5] * time + 2 / 7 * path * whole[:2]
            return Path(np.array(SHARES), (product(whole, on.coefficients),))
    return None
