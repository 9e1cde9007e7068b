"""Motion without closed form, of many balls at once: each alone, or two and two that push each other.

A sliding ball is integrated in q = (5 v + 2 R w x z)/7 and the contact velocity u = s (cos th, sin th), v = q + (2/7) u:
    q' = (5/7) p,   s' = -(7/2) mu N + p . u_hat = -A,   th' = (u_hat x p)/s,   x' = v
with p the push, N the load over the mass, and cos th, sin th in place of th. Towards the end of the slide th' grows as
1/s. So the slip of a ball whose slide is to end paces the integration, of both balls where they push each other: with
ln s for the time every right-hand side is smooth, and the slide's end is a known place instead of an event to search
for. Where nothing can turn the slip, s itself is as good. All other motion is integrated over time: of a rolling ball,
v' = (5/7) p - loss v_hat, pieces no longer than half of what would stop it.

Where a spin w drills, friction fades with the slip as F u/(u + c), c ~ |w|. A push p then keeps a slip of
u = c p/(F - p) creeping, micrometres a second, until the spin is gone, perhaps a second later. For all that can be seen
such a ball rolls, and what slows a rolling ball slows it: so a slide is over once its slip is small beside the
drilling, at `ending_slip`, and what is left of the slip ends as if nothing drilled. That slip is fixed when the slide
begins, and is the same whether the ball is solved alone or with another.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.dynamics.collocation import DEEPEST, SIZES, Parts, Path, integrate, matrices, product, series
from synthcam.dynamics.kinematics import Array, contact_velocity, fly, plate_state, rolling_velocity
from synthcam.model import Bodies, Model

Ints = NDArray[np.intp]
Flags = NDArray[np.bool_]
REST, ROLL, SLIDE, FLY = range(4)
STILL = 1e-12  # m/s: slower than this is rest, or rolling for a contact velocity
SLOWEST = 1e-7  # m/s: a ball slower than this has stopped
TOUCHING = 1e-12  # of a radius
FINISH = 1e-5  # of the first slip: the rest of the slide, a microsecond, is taken as a uniform deceleration
PROBE = 1e-9  # m/s: a slip at which it is seen how far a spin has friction fade
SMALL = 0.1  # of c: so small a slip beside the drilling, friction being a tenth, is no longer a slide
BREAK = 0.33  # of ln(|u|/|u0|) on the way to its last: where pieces meet
FEW = 28  # nodes of a logarithmic piece, first
SLIDING, ROLLING = ("friction", "normal_load", "push", "drilling"), ("rolling", "push")  # laws
STRAIGHT = {"slip_speed", "slip", "gravity", "radius", "of_a"}  # laws that ask no more leave the slip's direction
NOWHERE = np.full(2, np.inf)  # where the other ball is when there is none
NARROW = 3e-4  # of a leg: over so little time a parabola says as much, and a difference of sums would be rounded
SLIGHT = 1e-16  # m: coefficients of all balls that together are not worth their time
TINY = 1e-300
MOST = 1000  # pieces of a past
FASTEST = 1e3  # m/s: a ball that must have come faster did not come
GAUSS, WEIGHTS = np.polynomial.legendre.leggauss(4)  # exact for a parabola, 1e-15 m for a roll


def modes_of(states: Array, radius: Array) -> Ints:
    """What balls in states (m, 9) do: REST, ROLL, SLIDE or FLY."""
    u = contact_velocity(states, radius)
    slips, moves = np.hypot(u[:, 0], u[:, 1]) > STILL, np.hypot(states[:, 3], states[:, 4]) > STILL
    aloft = (states[:, 5] > 0) | (states[:, 2] > radius * (1 + TOUCHING))
    return np.where(aloft, FLY, np.where(slips, SLIDE, np.where(moves, ROLL, REST)))


@dataclass(frozen=True)
class Forces:
    """What acts on m balls. known: what the laws may ask for that does not change, (m, 1) or a number."""

    model: Model
    known: dict[str, Any]

    @classmethod
    def of(cls, model: Model, bodies: Bodies) -> Forces:
        known: dict[str, Any] = dict(gravity=model.gravity, radius=bodies.radius[:, None], mass=bodies.mass[:, None])
        return cls(model, known | dict(of_a=bodies.of_a[:, None], ball=model.ball))

    def __getitem__(self, rows: Any) -> Forces:
        return Forces(self.model, {k: v[rows] if isinstance(v, np.ndarray) else v for k, v in self.known.items()})

    def sliding(self, slip: Array, hat: Array, spin: Any, place: Array, v: Array, other: Any) -> tuple[Any, ...]:
        """A (m, n), u_hat x p, p (2, m, n) and dwz/dt for slip speeds (m, n) along `hat`; places, v (2, m, n)."""
        laws = self.model.laws
        instant = self.known | dict(
            slip_speed=slip, slip=last_axis(hat), position=last_axis(place), velocity=last_axis(v)
        )
        instant |= dict(spin=spin, other=other)
        friction = laws("friction", self.model.sliding_friction, instant)
        load = laws("normal_load", self.model.gravity, instant)
        slowing = 3.5 * friction * load + np.zeros_like(slip)
        twist = 0.0
        if laws.bent("drilling"):
            twist = laws("drilling", 0.0, instant | {"friction": friction, "load": load})
        if not laws.bent("push"):
            return slowing, 0.0, 0.0, twist
        push = laws("push", last_axis(np.zeros_like(v)), instant).transpose(2, 0, 1)
        slowing -= push[0] * hat[0] + push[1] * hat[1]
        return slowing, hat[0] * push[1] - hat[1] * push[0], push, twist

    def rolling(self, place: Array, v: Array, other: Any) -> Array:
        """The acceleration of rolling balls, (2, m, n)."""
        model, speed = self.model, np.hypot(v[0], v[1])
        instant = self.known | dict(position=last_axis(place), velocity=last_axis(v), other=other, speed=speed)
        loss = model.laws("rolling", model.rolling_drag * speed + model.rolling_decel, instant)
        out = v * (-loss / np.maximum(speed, TINY))
        return np.asarray(out + 5 / 7 * self.flying(place, v, other) if model.laws.bent("push") else out)

    def flying(self, place: Array, v: Array, other: Any) -> Array:
        """The push in full."""
        instant = self.known | dict(position=last_axis(place), velocity=last_axis(v), other=other)
        return np.asarray(self.model.laws("push", last_axis(np.zeros_like(v)), instant)).transpose(2, 0, 1)


def ending_slip(model: Model, state: Array, bodies: Bodies, other: Any = NOWHERE) -> Array:
    """Where a spin drills: the slips (k,), m/s, at which slides that begin in these states (k, 9) are as good as over.

    c sqrt(SMALL^2 + (2 p/(F - p))^2), no less than FINISH of the first one: small beside the drilling, twice the creep
    at least. other: places relative to these balls, (k, 1, 2) or NOWHERE.
    """
    u, forces = contact_velocity(state, bodies.radius), Forces.of(model, bodies)
    first = np.hypot(u[:, 0], u[:, 1])
    hat, slip = (u.T / np.maximum(first, TINY))[..., None], np.full((len(state), 1), PROBE)
    v = rolling_velocity(state, bodies.radius).T[..., None] + 2 / 7 * slip * hat
    there = state[:, :2].T[..., None], v, other
    found = [forces.sliding(slip, hat, spins * state[:, 8:], *there) for spins in (0.0, 1.0)]
    push = found[0][2] + np.zeros((2, len(state), 1))
    along = push[0] * hat[0] + push[1] * hat[1]
    whole, faded = (np.maximum(slowing + along, TINY) for slowing, *_ in found)
    size = np.hypot(push[0], push[1])
    creep = size / np.maximum(whole - size, SMALL * whole)
    beside = PROBE * (whole / faded - 1) * np.sqrt(SMALL**2 + 4 * creep**2)
    return np.asarray(np.maximum(beside[:, 0], FINISH * first))


def lasting_slip(model: Model, state: Array, bodies: Bodies, other: Any = None) -> Array:
    """The same of balls that drill; infinity of those that never do."""
    u = contact_velocity(state, bodies.radius)
    late = ending_slip(model, state, bodies, NOWHERE if other is None else other)
    return np.where(late < np.hypot(u[:, 0], u[:, 1]), late, np.inf)


@dataclass(frozen=True)
class Led:
    """Motion of m balls from the times `begins` on for `lasts`, s (m,), which may be negative, as series over z.

    path (c, m, n): x, y, qx, qy, and where a ball slides ux, uy, wz; last of all, where the time is not even in z, the
    time since `begins`; else of one piece. states (m, 9): at the beginning. flies: balls in the air. log, cut (m,): by
    how much ln s falls where it paces, else 0, and the time at which it has.
    """

    begins: Array
    lasts: Array
    states: Array
    radius: Array
    gravity: float
    path: Path
    slides: bool
    timed: bool
    flies: Flags
    log: Array
    cut: Array

    def __getitem__(self, rows: Ints) -> Led:
        path = Path(self.path.ends, tuple(c[:, rows] for c in self.path.coefficients))
        of = {f: getattr(self, f)[rows] for f in ("begins", "lasts", "states", "radius", "flies", "log", "cut")}
        return replace(self, path=path, **of)

    def later(self, by: Array) -> Led:
        return replace(self, begins=self.begins + by)

    def at(self, times: Array) -> Array:
        """States (m, k, 9) at times (m, k) within it."""
        elapsed = times - self.begins[:, None]
        y = self.path(self._along(elapsed))
        x, q = np.moveaxis(y[:2], 0, -1), np.moveaxis(y[2:4], 0, -1)
        u, wz = (np.moveaxis(y[4:6], 0, -1), y[6]) if self.slides else (np.zeros(2), self.states[:, 8:])
        out = plate_state(x, q, u, wz, self.radius[:, None])
        if self.flies.any():
            aloft = fly(self.states[self.flies], self.gravity, elapsed[self.flies])
            aloft[..., 0:2], aloft[..., 3:5] = x[self.flies], q[self.flies]
            out[self.flies] = aloft
        return out

    def means(self, middle: Array, wide: Any) -> Array:
        """Centres (2, m, k) averaged over the times `wide`, a number or (m, k), about times (m, k)."""
        elapsed = middle - self.begins[:, None]
        if not self.timed and np.ndim(wide) == 0 and len(self.path.coefficients) == 1:
            return self._even_means(elapsed, wide)
        narrow = wide < NARROW * np.abs(self.lasts)[:, None] + 0 * middle
        half = np.where(narrow, wide / np.sqrt(12), wide / 2)
        times = np.stack([elapsed - half, elapsed + half], axis=-1).reshape(len(middle), -1)
        along = self._along(times)
        out = np.zeros((2, *middle.shape))
        if not narrow.all():
            base, sums = self._sums
            found = sums(along)
            out = (found[..., 1::2] - found[..., ::2]) / np.where(narrow, 1.0, wide) + base
        if narrow.any():
            found = self._places(along)
            out = np.where(narrow, (found[..., ::2] + found[..., 1::2]) / 2, out)
        return np.asarray(out)

    def _even_means(self, elapsed: Array, wide: float) -> Array:
        """The mean of f over x +- h is the sum of h^(2j)/(2j+1)! f^(2j)(x)."""
        (c,) = self.path.coefficients
        half = np.minimum(np.abs(wide / self.lasts), 1.0)[:, None]  # a longer one does not lie within
        worth = np.flatnonzero(_sizes(c[:2]) > SLIGHT).max(initial=1)
        term = mean = c[:2, :, : worth + 1]
        curvature = matrices(term.shape[-1]).curvature
        for j in range(1, (term.shape[-1] + 1) // 2):
            term = product(term, curvature) * (half * half / (2 * j * (2 * j + 1)))
            mean = mean + term
            if _sizes(term).max() < SLIGHT:
                break
        return series(mean, 2 * self._along(elapsed) - 1)

    @cached_property
    def _places(self) -> Path:
        return self._part(slice(0, 2))

    def _part(self, which: slice) -> Path:
        return Path(self.path.ends, tuple(c[which] for c in self.path.coefficients))

    @cached_property
    def _timing(self) -> Path:
        """The time since the beginning and its slope along the path, (2, m, n)."""
        wide, pieces = np.diff(self.path.ends), [c[-1:] for c in self.path.coefficients]
        slopes = [product(c, matrices(c.shape[-1]).slope) * (2 / w) for c, w in zip(pieces, wide, strict=True)]
        return Path(self.path.ends, tuple(np.concatenate(both) for both in zip(pieces, slopes, strict=True)))

    @cached_property
    def _sums(self) -> tuple[Array, Path]:
        """The place half way, (2, m, 1), and the integral of the place less that over the time."""
        first, last = self.path.coefficients[0], self.path.coefficients[-1]
        signs = (-1.0) ** np.arange(first.shape[-1])
        base = ((first[:2] @ signs + last[:2].sum(axis=-1)) / 2)[..., None]
        sofar, sums = np.zeros_like(base), []
        for wide, c in zip(np.diff(self.path.ends), self.path.coefficients, strict=True):
            size = c.shape[-1]
            on = matrices(2 * size)  # holds the product
            place = product(c[:2], on.values[:size]) - base
            rate = self.lasts[:, None] * wide / 2
            if self.timed:
                rate = product(product(c[-1:], matrices(size).slope), on.values[:size])[0]
            total = product(place * rate, on.integral) + sofar
            sums.append(product(total, on.coefficients))
            sofar = total[..., -1:]
        return base, Path(self.path.ends, tuple(sums))

    def _along(self, elapsed: Array) -> Array:
        """Where on the path its own time is `elapsed`: Newton, kept in brackets."""
        last = self.path.ends[-1]
        if not self.timed:
            return elapsed * (last / self.lasts[:, None])
        low, high = np.full(elapsed.shape, -1e-9), np.full(elapsed.shape, last + 1e-9)  # room for rounding
        share, log = np.clip(elapsed / self.cut[:, None], 0.0, 1.0), self.log[:, None]
        along = share
        if np.any(log):  # exact for constant friction
            along = np.where(log < 0, np.log1p(share * np.expm1(log)) / np.where(log < 0, log, 1.0), share)
        tolerance = 1e-15 * np.abs(self.lasts)[:, None]
        for _ in range(60):
            time, slope = self._timing(along)
            late = time > elapsed
            low, high = np.where(late, low, along), np.where(late, along, high)
            new = along - (time - elapsed) / np.where(slope > 0, slope, np.inf)
            astray = (new < low) | (new > high)
            left, along = (new - along) ** 2 * slope, np.where(astray, (low + high) / 2, new)
            if not np.any((left > tolerance) | astray):  # what this turn leaves
                break
        return np.asarray(along)


def _sizes(coefficients: Array) -> Array:
    """(c, m, n) -> (n,): roots of sums of squares, no less than any; a maximum takes numpy longer."""
    return np.asarray(np.sqrt(np.einsum("cmn,cmn->n", coefficients, coefficients)))


def averaged(places: Callable[[Array], Array], middle: Array, wide: Any) -> Array:
    """Means (2, m, k) of places (2, m, times) over the times `wide` about `middle`, by Gauss quadrature."""
    if np.ndim(wide) == 0 and wide == 0:
        return places(middle)
    times = middle[:, None] + GAUSS[:, None] * (np.asarray(wide) / 2 + 0 * middle)[:, None]
    found = places(times.reshape(len(middle), -1)).reshape(2, *times.shape)
    return np.asarray(np.tensordot(found, WEIGHTS / 2, axes=(2, 0)))


class Phase:
    """Balls in states (m, 9) and modes (m,), on the way.

    partner (m,): whose pull each feels, or None. paced (m,): rows of the slides whose ends pace them and end with the
    phase, or -1: then it lasts `spans`, (m,). floor (m,): slips at which a spin no longer drills, infinite if it never
    does.
    """

    def __init__(
        self,
        model: Model,
        bodies: Bodies,
        states: Array,
        modes: Ints,
        spans: Array,
        paced: Ints,
        floor: Array,
        partner: Ints | None = None,
    ) -> None:
        self.model, self.bodies, self.states, self.partner = model, bodies, states, partner
        self.spans, self.paced, self.floor, self.forces = spans[:, None], paced, floor, Forces.of(model, bodies)
        self.rows: dict[int, Any] = {mode: np.flatnonzero(modes == mode) for mode in (ROLL, SLIDE, FLY)}
        for mode, rows in self.rows.items():
            if len(rows) == len(modes):
                self.rows[mode] = slice(None)
        self.slides, self.timed = bool(np.any(modes == SLIDE)), bool(np.any(paced >= 0))
        self.modes = modes
        laws = model.laws
        asked = set().union(*(laws.asked(law) for law in SLIDING))
        self.pushes, self.drills = laws.bent("push"), laws.bent("drilling")
        self.ends = (paced == np.arange(len(modes)))[:, None]
        self.free = self.slides and not self.ends.all()
        self.straight = self.timed and not self.free and not self.pushes and not self.drills
        self.straight &= all(laws.asked(law) <= STRAIGHT for law in ("friction", "normal_load"))
        self.at = 4 if self.slides else 0  # of q among the components; then come x and the time
        if partner is not None:
            self.feed = None
        elif self.slides:
            turning = self.pushes + self.drills
            self.feed = None if "position" in asked else max(turning + (self.pushes and "velocity" in asked), 1)
        else:
            self.feed = None if "position" in laws.asked("rolling") | laws.asked("push") else 1
        u = contact_velocity(states, bodies.radius).T * (modes == SLIDE)
        self.first = np.hypot(u[0], u[1])[:, None]
        self.hat = (u / np.maximum(self.first[:, 0], TINY))[..., None]
        self.spins = np.where(self.first > floor[:, None], 1.0, 0.0) if self.drills else 1.0
        self.cut = np.where(self.first > floor[:, None], floor[:, None], FINISH * self.first)
        self.log = np.log(np.where(self.ends, self.cut / np.maximum(self.first, TINY), 1.0))

    def start(self) -> Array:
        """(c, m, 1)."""
        s, u = self.states, self.first * self.hat
        q = s[:, 3:5].T[..., None] - 2 / 7 * u
        there = [*q, *s[:, :2].T[..., None]]
        if self.slides:
            there = [*self.hat, s[:, 8, None], self.first, *there]
        return np.stack([*there, np.zeros_like(self.first)] if self.timed else there)

    def slip(self, z: Any, y: Array) -> tuple[Any, Any]:
        """Slip speeds (m, n), and how fast they fall along z where that is what paces."""
        if not self.slides:
            return 0.0, 0.0
        if self.straight:
            return self.first * (1 - z), self.first
        if not self.timed:
            return y[3], 0.0
        log = self.log
        if np.mean(z) > 1:  # what is left when it no longer drills
            log = np.where(self.ends, np.log(FINISH), 0.0)
            slip = self.cut * np.exp(log * (z - 1))
        else:
            slip = self.first * np.exp(log * z)
        return np.where(self.ends, slip, y[3]) if self.free else slip, -log * slip

    def act(self, slip: Any, y: Array, spins: Any) -> tuple[Any, ...]:
        """dq/dt, A, u_hat x p and dwz/dt."""
        at = self.at
        q, place, other = y[at : at + 2], y[at + 2 : at + 4], NOWHERE
        v = q + 2 / 7 * slip * y[:2] if self.slides else q
        if self.partner is not None:
            other = last_axis(place[:, self.partner] - place)
        dq, slowing, across, twist = None, 0.0, 0.0, 0.0
        for mode, rows in self.rows.items():
            whole = isinstance(rows, slice)
            if not whole and len(rows) == 0:
                continue
            forces = self.forces if whole else self.forces[rows]
            there = place[:, rows], v[:, rows], other if self.partner is None else other[rows]
            if mode == SLIDE:
                spin = y[2][rows] * (spins if np.ndim(spins) == 0 else spins[rows])
                found = forces.sliding(slip[rows], y[:2, rows], spin, *there)
                own = 5 / 7 * found[2]
                if not whole:
                    slowing, across, twist = (_spread(f, rows, slip.shape) for f in (found[0], found[1], found[3]))
                else:
                    slowing, across, _, twist = found
            else:
                own = forces.rolling(*there) if mode == ROLL else forces.flying(*there)
            if whole:
                return own, slowing, across, twist
            dq = np.zeros_like(v) if dq is None else dq
            dq[:, rows] = own
        return (np.zeros_like(v) if dq is None else dq), slowing, across, twist

    def _spinning(self, late: bool) -> Any:
        """1 where a spin has friction fade: no more towards the end of a slide."""
        return np.where(self.ends, 0.0, self.spins) if self.drills and late else self.spins

    def rate(self, fall: Any, slowing: Any) -> Any:
        """dt/dz. Raises ValueError where friction does not end a slide."""
        if not self.timed:
            return self.spans
        if not np.all(slowing[self.ends[:, 0]] > 0):
            raise ValueError("sliding friction does not end the slide: the push along the slip is too strong")
        if not self.free and self.partner is None:
            return fall / slowing
        own = fall / np.where(self.ends, slowing, 1.0)
        return np.where(self.paced[:, None] >= 0, own[self.paced], self.spans)

    def right(self, z: Array, y: Array) -> Parts:
        slip, fall = self.slip(z, y)
        dq, slowing, across, twist = self.act(slip, y, self._spinning(bool(np.mean(z) > 1)))
        rate, at = self.rate(fall, slowing), self.at
        if self.slides and self.pushes:
            turn = across / np.maximum(slip, TINY) * rate
            out = np.empty((2, *turn.shape))
            np.multiply(-turn, y[1], out=out[0])
            np.multiply(turn, y[0], out=out[1])
            yield slice(0, 2), out
        if self.slides and self.drills:
            yield slice(2, 3), (twist * rate + np.zeros_like(slip))[None]
        if self.free:
            yield slice(3, 4), (-slowing * rate)[None]
        if self.pushes or not self.slides or self.partner is not None:
            yield slice(at, at + 2), dq * rate
        v = y[at : at + 2] + 2 / 7 * slip * y[:2] if self.slides else y[at : at + 2]
        yield slice(at + 2, at + 4), v * rate
        if self.timed:
            yield slice(at + 4, at + 5), (rate + np.zeros_like(y[at]))[None]

    def guess(self) -> Callable[[Array], Array]:
        """All forces were what they are at the start."""
        start = self.start()
        at, first, hat = self.at, self.first, self.hat
        dq, slowing, across, twist = self.act(first if self.slides else 0.0, start, self.spins)
        self.rate(1.0 + 0 * first, slowing + 0 * first)

        def guess(z: Array) -> Array:
            y = np.repeat(start, len(z), axis=-1)
            t, left = self.spans * z, 0.0
            if self.timed:
                slip, _ = self.slip(z, y)
                own = (first - slip) / np.where(self.ends, slowing, 1.0)
                t = np.where(self.paced[:, None] >= 0, own[self.paced], t)
                y[-1] = t
            q0, y[at : at + 2] = y[at : at + 2].copy(), y[at : at + 2] + dq * t
            if self.slides:
                left = np.maximum(first - slowing * t, 0.0)
                turned = across / np.where(slowing > 0, slowing, 1.0)
                half = turned / -2 * np.log(np.maximum(left, 1e-3 * self.cut) / np.maximum(first, TINY) + (first == 0))
                cos, sin = (1 - half * half) / (1 + half * half), 2 * half / (1 + half * half)
                y[0], y[1] = y[0] * cos - y[1] * sin, y[1] * cos + y[0] * sin
                y[2], y[3] = y[2] + twist * t, left
            y[at + 2 : at + 4] += ((q0 + y[at : at + 2]) / 2 + (first + left) / 7 * hat) * t
            return y

        return guess

    def run(self) -> Way:
        """Raises ValueError when a slide does not end, and where a law is not smooth."""
        knots: tuple[float, ...] = (0.0, 1.0)
        if self.timed and not self.straight:
            drilling = self.ends[:, 0] & (self.first[:, 0] > self.floor)
            knots = (0.0, BREAK, 1.0, 2.0)[: 4 if drilling.any() else 3]
        path = integrate(
            self.right,
            knots,
            self.start()[..., 0],
            self.guess(),
            few=FEW if len(knots) > 2 else SIZES[0],
            feed=self.feed,
        )
        ends, pieces, sound, cut = (
            list(path.ends),
            list[Array](),
            np.ones(len(self.modes), dtype=bool),
            self.spans[:, 0],
        )
        for end, (z, y) in zip(ends[1:], path.nodes(), strict=True):
            slip, _ = self.slip(z, y)
            if self.free:
                sound &= (self.modes != SLIDE) | self.ends[:, 0] | (y[3] > 0).all(axis=1)
            pieces.append(self._dense(y, slip))
            if self.timed and end == 1.0:
                cut = y[-1, :, -1]
        lasts = y[-1, :, -1] if self.timed else cut
        if self.timed and not self.straight:
            late, piece = self._closing(y[..., -1:], slip[:, -1:])
            lasts = lasts + late
            pieces.append(piece)
            ends.append(ends[-1] + 1)
        falls = np.where(self.modes == FLY, flight_time(self.model, self.states, self.bodies), np.inf)
        return self._way(ends, pieces, lasts, cut, self.ends[:, 0] | (lasts == falls), sound & (lasts <= falls))

    def stop(self) -> Way:
        """The same where a ball, one of both, rolls so slowly that it is taken to stop evenly."""
        y = self.start()
        late, piece = self._closing(y, self.first, stops=True)
        over = (self.modes == ROLL) & (np.hypot(*self.states[:, 3:5].T) <= SLOWEST)
        return self._way([0.0, 1.0], [piece], late, late, over, np.ones(len(late), dtype=bool))

    def _dense(self, y: Array, slip: Array) -> Array:
        """Coefficients of what is kept, from the components on nodes."""
        at = self.at
        kept = [y[at + 2 : at + 4], y[at : at + 2]]
        if self.slides:
            kept += [slip * y[:2], y[2:3]]
        if self.timed:
            kept.append(y[-1:])
        return product(np.concatenate(kept), matrices(y.shape[-1]).coefficients)

    def _closing(self, y: Array, slip: Array, stops: bool = False) -> tuple[Array, Array]:
        """What is left of a slip or of a roll ends evenly; meanwhile all else that acts stays as it is.

        y (c, m, 1): how long that lasts, (m,), and the piece.
        """
        at, ends = self.at, self.ends
        dq, slowing, across, twist = self.act(np.where(ends, slip / 2, slip), y, self._spinning(True))
        q, dq = y[at : at + 2], dq + np.zeros((2, *slip.shape))
        if stops:
            speed = np.hypot(q[0], q[1])
            ends = (self.modes == ROLL)[:, None] & (speed <= SLOWEST)
            late = speed / np.maximum(np.hypot(dq[0], dq[1]), TINY)
            alone = np.where(ends, late, np.inf)
            both = alone if self.partner is None else np.minimum(alone, alone[self.partner])
            ends = ends & (late <= both)
            dq = np.where(ends, -q / np.maximum(late, TINY), dq)
            late = both
        else:
            own = slip / np.where(ends, slowing, 1.0)
            late = np.where(self.paced[:, None] >= 0, own[self.paced], 0.0)
        t = late * (1 + matrices(3).nodes) / 2
        v, dv, kept = q, dq, [q + dq * t]
        if self.slides:
            hat = y[:2]
            du = across * np.stack([-hat[1], hat[0]]) - slowing * hat
            du = np.where(ends & (self.modes == SLIDE)[:, None], -slip * hat / np.maximum(late, TINY), du)
            v, dv = v + 2 / 7 * slip * hat, dv + 2 / 7 * du
            kept += [slip * hat + du * t, y[2:3] + (twist + np.zeros_like(slip)) * t]
        kept.insert(0, y[at + 2 : at + 4] + (v + dv / 2 * t) * t)
        if self.timed:
            kept.append((y[-1] + t)[None])
        return late[:, 0], product(np.concatenate(kept), matrices(3).coefficients)

    def _way(self, ends: list[float], pieces: list[Array], lasts: Array, cut: Array, over: Flags, sound: Flags) -> Way:
        model, bodies, states, flies = self.model, self.bodies, self.states, self.modes == FLY
        fixed = dict(radius=bodies.radius, gravity=model.gravity, slides=self.slides, timed=self.timed, flies=flies)
        fixed |= dict(log=0 * lasts if self.straight else self.log[:, 0], cut=cut)
        led = Led(np.zeros(len(lasts)), lasts, states, path=Path(np.array(ends), tuple(pieces)), **fixed)
        y = pieces[-1].sum(axis=-1)
        last = plate_state(y[:2].T, y[2:4].T, y[4:6].T if self.slides else np.zeros(2), states[:, 8], bodies.radius)
        if self.slides:
            last[:, 8] = y[6]
        ended = self.ends[:, 0]
        last[ended] = plate_state(y[:2, ended].T, y[2:4, ended].T, np.zeros(2), last[ended, 8], bodies.radius[ended])
        if flies.any():
            aloft = fly(states[flies], model.gravity, lasts[flies, None])[:, 0]
            aloft[:, :2], aloft[:, 3:5] = y[:2, flies].T, y[2:4, flies].T
            last[flies] = aloft
        down = over & flies
        last[down, 2] = bodies.radius[down]
        return Way(led, last, lasts, over, sound)


@dataclass
class Way:
    """How balls moved from time 0 on; states (m, 9) at the end, how long that lasted (m,).

    over: whose slide, roll or flight ended; sound: of which balls it is true.
    """

    led: Led
    last: Array
    lasts: Array
    over: Flags
    sound: Flags

    @classmethod
    def even(cls, model: Model, bodies: Bodies, states: Array, lasts: Array, path: Array) -> Way:
        """Of balls on the plate that roll or rest, on path (4, m, n) over `lasts`."""
        none = np.zeros(len(lasts), dtype=bool)
        led = Led(
            0 * lasts,
            lasts,
            states,
            bodies.radius,
            model.gravity,
            Path(np.array([0.0, 1.0]), (path,)),
            slides=False,
            timed=False,
            flies=none,
            log=0 * lasts,
            cut=lasts,
        )
        return cls(led, led.at(lasts[:, None])[:, 0], lasts, none, ~none)

    def __getitem__(self, rows: Ints) -> Way:
        return Way(self.led[rows], self.last[rows], self.lasts[rows], self.over[rows], self.sound[rows])


def flight_time(model: Model, states: Array, bodies: Bodies) -> Array:
    """How long balls stay in the air, (m,)."""
    up, height = states[:, 5], np.maximum(states[:, 2] - bodies.radius, 0.0)
    return np.asarray((up + np.sqrt(up * up + 2 * model.gravity * height)) / model.gravity)


def last_axis(vectors: Array) -> Array:
    """(2, m, n) as effects want it: (m, n, 2)."""
    return vectors.transpose(1, 2, 0)


def _spread(values: Any, rows: Ints, shape: tuple[int, ...]) -> Array:
    out = np.zeros(shape)
    out[rows] = values
    return out


Ways = Iterator[tuple[Ints, Way]]


def lead(model: Model, bodies: Bodies, states: Array, goal: Array, floor: Array, balls: int = 1) -> Ways:
    """The next piece of motion of k units, on the way to `goal`, s from now (k,): each one ball, or two that push.

    states (balls k, 9): all first balls, then all second ones. floor (balls k,): as Phase has it. It leads no further
    than to the first end of a slide, roll or flight of a unit. Yields units and their balls' ways.
    """
    modes, units = modes_of(states, bodies.radius), np.arange(len(goal))
    spans, ender, stops = _plan(model, bodies, states, modes, goal, floor, balls)
    job = _Job(model, bodies, states, modes, floor, balls)
    for some in (stops, ~stops & (ender >= 0), ~stops & (ender < 0)):
        if some.any():
            yield from job.ways(units[some], spans, ender, bool((stops & some).any()))


@dataclass(frozen=True)
class _Job:
    model: Model
    bodies: Bodies
    states: Array
    modes: Ints
    floor: Array
    balls: int

    def ways(self, units: Ints, spans: Array, ender: Ints, stops: bool, depth: int = DEEPEST) -> Ways:
        """What has no solution in one piece is led again for half the time."""
        count, k = len(self.modes) // self.balls, len(units)
        rows = _rows(units, count, self.balls)
        paced = np.tile(np.where(ender[units] >= 0, ender[units] * k + np.arange(k), -1), self.balls)
        partner = (np.arange(2 * k) + k) % (2 * k) if self.balls == 2 else None
        phase = Phase(
            self.model,
            self.bodies[rows],
            self.states[rows],
            self.modes[rows],
            np.tile(spans[units], self.balls),
            paced,
            self.floor[rows],
            partner,
        )
        try:
            way = phase.stop() if stops else phase.run()
            good = way.sound.reshape(self.balls, k).all(axis=0)
        except ValueError:
            if depth == 0 or (self.balls == 1 and phase.slides):
                raise
            good = np.zeros(k, dtype=bool)
            if k > 1 and self.balls == 2:
                for half in np.array_split(units, 2):
                    yield from self.ways(half, spans, ender, stops, depth)
                return
        if good.any():
            yield units[good], way if good.all() else way[np.flatnonzero(np.tile(good, self.balls))]
        if not good.all():
            yield from self.ways(units[~good], spans / 2, np.full_like(ender, -1), False, depth - 1)


def _plan(
    model: Model, bodies: Bodies, states: Array, modes: Ints, goal: Array, floor: Array, balls: int
) -> tuple[Array, Ints, Flags]:
    """How long the next pieces may be, (k,); which ball's slide ends one, or -1; and where a ball is about to stop."""
    k = len(goal)
    if balls == 1 and np.all(modes == SLIDE):
        return np.zeros(k), np.zeros(k, dtype=np.intp), np.zeros(k, dtype=bool)
    partner = (np.arange(2 * k) + k) % (2 * k) if balls == 2 else None
    phase = Phase(model, bodies, states, modes, np.zeros(len(modes)), np.full(len(modes), -1), floor, partner)
    dq, slowing, *_ = phase.act(phase.first, phase.start(), phase.spins)
    speed, rolls = np.hypot(states[:, 3], states[:, 4]), modes == ROLL
    half = speed / np.maximum(2 * np.hypot(dq[0], dq[1])[:, 0], TINY)
    half = np.where(rolls, half, flight_time(model, states, bodies) if np.any(modes == FLY) else np.inf)
    half = np.where(rolls | (modes == FLY), half, np.inf).reshape(balls, k).min(axis=0)
    stops = (rolls & (speed <= SLOWEST)).reshape(balls, k).any(axis=0)
    away = (phase.first[:, 0] - np.where(phase.first[:, 0] > floor, floor, 0.0)) / np.maximum(
        slowing + 0 * phase.first, TINY
    )[:, 0]
    away = np.where((modes == SLIDE), away, np.inf).reshape(balls, k)
    ends, soonest = np.argmin(away, axis=0), away.min(axis=0)
    limit = np.minimum(half, np.abs(goal))
    paces = soonest < 0.8 * half
    spans = np.where(soonest > 1.25 * limit, limit, np.minimum(soonest, limit) / 2)
    return np.copysign(np.where(limit == np.inf, 0.0, spans), goal), np.where(paces, ends, -1), stops


def back(
    model: Model, bodies: Bodies, states: Array, now: Array, until: Array, balls: int = 1
) -> list[tuple[Ints, Led]]:
    """Units whose balls roll or rest in `states` at `now` (k,), led back: motions of units.

    Raises ValueError where a ball would have come from rest.
    """
    states, now, pieces, k = states.copy(), now.copy(), list[tuple[Ints, Led]](), len(now)
    for _ in range(MOST):
        speed = np.hypot(states[:, 3], states[:, 4]).reshape(balls, k)
        left = np.flatnonzero((now > until) & (speed > STILL).any(axis=0))
        if len(left) == 0:
            return pieces
        if np.any((speed[:, left] > STILL) & (speed[:, left] <= SLOWEST)):
            raise ValueError(f"a ball has no past before {now[left].max():g} s: it would have had to come from rest")
        if not np.all(speed < FASTEST):
            break
        rows = _rows(left, k, balls)
        for units, way in lead(
            model, bodies[rows], states[rows], (until - now)[left], np.full(len(rows), np.inf), balls
        ):
            mine = left[units]
            pieces.append((mine, way.led.later(np.tile(now[mine], balls))))
            states[_rows(mine, k, balls)] = way.last
            now[mine] = arrived(now[mine] + way.lasts[: len(mine)], until[mine])
    raise ValueError(f"a past does not settle: a ball would have had to come faster than {FASTEST:g} m/s")


def arrived(now: Array, goal: Array) -> Array:
    """The goal where only rounding keeps it from having been reached."""
    return np.where(np.abs(now - goal) <= 1e-15 * (1 + np.abs(goal)), goal, now)


def _rows(units: Ints, count: int, balls: int) -> Ints:
    """Of each of `count` units there are `balls` rows, all first balls before all second ones."""
    return np.concatenate([units + ball * count for ball in range(balls)])
