"""Two balls that push each other, many pairs at once: both led together, piece by piece, from event to event."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.contact import TOUCHING
from synthcam.kinematics import Array, Real, contact_velocity, fly, plate_state, rolling_state
from synthcam.model import Bodies, Model
from synthcam.pulled import FAINT, SMALLEST, STEADY, STILL, Ball, Flags, Mesh, last_axis, mesh, most
from synthcam.rolling import SLOWEST, Stretch
from synthcam.sliding import ending_slip
from synthcam.spectral import series
from synthcam.trajectory import Motion

NODES = 24  # of a piece
STARTS = (12, 20, 32, 56)  # nodes of a piece that begins at rest: tried in this order
BOOST = 5.0  # times the last coefficients that a pole leaves
TURNS, PATIENCE = 25, 120  # of the iteration; of a start that many nodes are spent on
QUICK = 5  # turns in which a start is looked for in whole steps
NEARLY = 8.0  # times the slip at which it no longer drills: from here one piece leads there
HALVINGS = 30  # of a piece
SETTLED = 2e-13  # m/s, of an iteration's change
AWAY = 8.0  # distances of touching: a ball at rest is let go when the other comes so near, if not yet pulled off
CLINGING = 1e-4  # m/s: a softer impact of balls that push each other is one of an endless row

Ints = NDArray[np.intp]
Pair = tuple[Bodies, Bodies]


@dataclass(frozen=True)
class Course:
    """Balls `who` (k,) on one piece of their motion, from `begins` to `ends`, (k,): a Segment.

    series: x, y, vx, vy and, where they slide, qx, qy, wz. state (k, 9): at the piece's first end, which is the later
    one where it leads back.
    """

    who: Ints
    begins: Array
    ends: Array
    motion: Motion
    series: Stretch
    state: Array
    radius: Array
    gravity: float

    @property
    def aloft(self) -> bool:
        return self.motion == "fly"

    def states(self, times: Array) -> Array:
        """(k, m, 9) at times (k, m)."""
        if self.motion == "rest":
            return np.repeat(self.state[:, None], times.shape[1], axis=1)
        y = np.moveaxis(self.series.plane(times), 0, -1)
        x, v, radius = y[..., 0:2], y[..., 2:4], self.radius[:, None]
        if self.motion == "slide":
            return plate_state(x, y[..., 4:6], 3.5 * (v - y[..., 4:6]), y[..., 6], radius)
        if self.motion == "fly":
            out = fly(self.state, self.gravity, times - self.series.begins[:, None])
            out[..., 0:2], out[..., 3:5] = x, v
            return out
        return plate_state(x, v, np.zeros(2), self.state[:, 8:], radius)

    def means(self, middle: Array, wide: Real) -> Array:
        """Centres (2, k, m) averaged over the times `wide`, a number or (k, m), about `middle` (k, m)."""
        if self.motion == "rest":
            return np.broadcast_to(self.state[:, :2].T[..., None], (2, *middle.shape))
        if np.ndim(wide) == 0:
            return self.series.means(middle, wide)
        return self._between(middle - np.asarray(wide) / 2, middle + np.asarray(wide) / 2)

    def _between(self, early: Array, late: Array) -> Array:
        """Centres (2, k, m) averaged from `early` to `late`, (k, m): by the series' integral. Nothing over no time."""
        some = np.flatnonzero((late > early).any(axis=1))
        c, n = self.series.coefficients[:2, some], self.series.coefficients.shape[-1]
        padded = np.zeros((*c.shape[:-1], n + 2))
        padded[..., 1:n] = c[..., 1:]
        whole = np.zeros((*c.shape[:-1], n + 1))
        whole[..., 1:] = (padded[..., :n] - padded[..., 2:]) / (2 * np.arange(1, n + 1))
        first, last = self.series.begins[some, None], self.series.ends[some, None]
        a, b = ((2 * times[some] - first - last) / (last - first) for times in (early, late))
        sums = series(whole, np.concatenate([a, b], axis=1))
        gain = sums[..., a.shape[1] :] - sums[..., : a.shape[1]]
        out = np.zeros((2, *early.shape))
        out[:, some] = np.where(b == a, 0.0, c[..., :1] + gain / np.where(b == a, 1.0, b - a))
        return out

    def of(self, which: Any) -> Course:
        """Some of them."""
        series = replace(
            self.series,
            who=self.who[which],
            begins=self.series.begins[which],
            ends=self.series.ends[which],
            coefficients=self.series.coefficients[:, which],
        )
        some = dict(who=self.who[which], begins=self.begins[which], ends=self.ends[which], state=self.state[which])
        return replace(self, series=series, radius=self.radius[which], **some)


@dataclass(frozen=True)
class Piece:
    """Pairs `who` (indices, (k,)) from `now` to `then`, (k,), later or earlier.

    places, velocities (2 balls, 2, k, nodes): at times spread over it, ends among them; last (2, k, 9): states at its
    end; over (2, k): whose slide, roll or flight ended with it. courses: of balls 0 and of balls 1, `who` as here.
    """

    who: Ints
    now: Array
    then: Array
    places: Array
    velocities: Array
    last: Array
    over: Flags
    courses: tuple[Course, Course]

    def of(self, which: Any) -> Piece:
        """Some of them."""
        courses = self.courses[0].of(which), self.courses[1].of(which)
        times = self.now[which], self.then[which]
        ways = self.places[:, :, which], self.velocities[:, :, which]
        return Piece(self.who[which], *times, *ways, self.last[:, which], self.over[:, which], courses)

    def among(self, pairs: Ints) -> Piece:
        """The same, its pairs numbered anew: k is now pairs[k]."""
        courses = [replace(course, who=pairs[self.who]) for course in self.courses]
        return replace(self, who=pairs[self.who], courses=(courses[0], courses[1]))


def floors(model: Model, bodies: Pair, states: Array) -> Array:
    """The slips (2, k) at which balls that begin to slide in states (2, k, 9) no longer drill; inf if none does."""
    out = np.full(states.shape[:2], np.inf)
    if model.laws.bent("drilling"):
        for ball, body in enumerate(bodies):
            other = (states[1 - ball] - states[ball])[:, None, :2]
            late = ending_slip(model, states[ball], body, other)
            out[ball] = np.where(late < np.hypot(*contact_velocity(states[ball], body.radius).T), late, np.inf)
    return out


def mode_of(states: Array, radius: Array, floor: Array) -> NDArray[np.str_]:
    """What balls in states (k, 9) do: rest, roll, drill (down to the slip `floor`, (k,)), slide or fly."""
    slips = np.hypot(*contact_velocity(states, radius).T) > STILL
    moves = np.hypot(states[:, 3], states[:, 4]) > STILL
    plain = np.where(slips, np.where(np.isfinite(floor), "drill", "slide"), np.where(moves, "roll", "rest"))
    aloft = (states[:, 5] > 0) | (states[:, 2] > radius * (1 + TOUCHING))
    return np.asarray(np.where(aloft, "fly", plain))


def opening(states: Array) -> Array:
    """How fast the balls of pairs, (2, k, 9), part, times their distance, m^2/s."""
    apart = states[0] - states[1]
    return np.asarray((apart[:, :3] * apart[:, 3:6]).sum(axis=1))


def push_at_rest(model: Model, body: Bodies, state: Array, other: Array) -> Array:
    """The push on balls at rest, states (k, 9), while the others are at (2, k, n): (k, n, 2), m/s^2."""
    instant = _at_rest(body, state, other) | {"gravity": model.gravity, "ball": model.ball}
    return np.asarray(model.laws("push", np.zeros_like(instant["position"]), instant))


def excess(model: Model, body: Bodies, state: Array, other: Array) -> Array:
    """By how much 5/7 of that push exceeds what holds the balls, or would were they to roll, (k, n), m/s^2."""
    push = push_at_rest(model, body, state, other)
    size = np.hypot(push[..., 0], push[..., 1])
    nudge = {"velocity": SLOWEST * push / np.maximum(size, SMALLEST)[..., None], "speed": np.full(size.shape, SLOWEST)}
    instant = _at_rest(body, state, other) | {"gravity": model.gravity, "ball": model.ball} | nudge
    loss = model.laws("rolling", model.rolling_decel, instant)
    return np.asarray(size * 5 / 7 - np.maximum(model.rolling_decel, loss))


def _at_rest(body: Bodies, state: Array, other: Array) -> dict[str, Any]:
    place = np.broadcast_to(state[:, :2].T[..., None], (2, len(state), other.shape[-1]))
    here = dict(position=last_axis(place), velocity=np.zeros((*place.shape[1:], 2)), other=last_axis(other - place))
    return here | dict(radius=body.radius[:, None], mass=body.mass[:, None], of_a=body.of_a[:, None])


def step(
    model: Model, bodies: Pair, modes: tuple[str, str], states: Array, floor: Array, now: Array, goal: Array
) -> tuple[list[Piece], Ints]:
    """The next pieces of k pairs, both balls in these modes, states (2, k, 9) at `now`, on the way to `goal`, (k,).

    floor (2, k): slips at which they no longer drill. None leads beyond the first end of a slide, of its drilling, of a
    roll or flight. And the pairs for which no piece is short enough.
    """
    balls = _begin(model, bodies, modes, states, floor)
    lasts, ender = _plan(balls, now, goal)
    todo, found = np.arange(len(now)), []
    for _ in range(HALVINGS):
        left = [todo[:0]]
        for which in (-1, 0, 1):
            some = todo[ender[todo] == which]
            if len(some):
                pair = bodies[0][some], bodies[1][some]
                begin = _begin(model, pair, modes, states[:, some], floor[:, some])
                piece, good = _lead(begin, some, now[some], lasts[some], which)
                found += [piece if np.all(good) else piece.of(good)] if np.any(good) else []
                left.append(some[~good])
        todo = np.concatenate(left)
        if len(todo) == 0:
            break
        lasts[todo], ender[todo] = lasts[todo] / 2, -1
    return found, todo


def _begin(model: Model, bodies: Pair, modes: tuple[str, str], states: Array, floor: Array) -> list[Ball]:
    balls = [Ball(model, *each) for each in zip(modes, bodies, states, floor, strict=True)]
    _feel(balls)
    return balls


def _feel(balls: Sequence[Ball]) -> None:
    places = balls[1].x, balls[0].x
    for ball, other in zip(balls, places, strict=True):
        ball.feel(other)


def _plan(balls: Sequence[Ball], now: Array, goal: Array) -> tuple[Array, Ints]:
    """How long the next piece may be, (k,), negative where it leads back; of which ball s is down with it, or -1."""
    apart, drift = (balls[1].x - balls[0].x)[..., 0], (balls[1].v - balls[0].v)[..., 0]
    sign = np.sign(goal - now)
    far, speed = np.hypot(*apart), np.maximum(np.hypot(*drift), FAINT)
    nearing = (apart * drift).sum(axis=0) * sign < 0
    forces = [np.hypot(*ball.push)[:, 0] for ball in balls if ball.mode != "rest"]
    force = np.maximum(sum(forces), FAINT)
    reach = balls[0].body.radius + balls[1].body.radius
    rho = np.maximum(BOOST * force * far / speed / STEADY, 1.0) ** (1 / (NODES - 3))
    wide = np.clip(4 / np.maximum(rho + 1 / rho - 2, 1e-3), 0.1, 10.0)  # a pole at r = 0 lets r grow by so much
    room = np.where(nearing, np.minimum(wide / (1 + wide), np.maximum(1 - 0.85 * reach / far, 0.15)), wide)
    lasts = np.minimum(room * far / speed, np.sqrt(far / force))
    lasts = np.minimum(lasts, np.abs(goal - now))
    for ball in balls:
        if ball.mode == "fly":
            lasts = np.minimum(lasts, ball.flies())
    rest = np.full((2, len(now)), np.inf)
    for k, ball in enumerate(balls):
        if ball.mode in ("slide", "drill", "roll"):
            ends = (ball.slowing > 0)[:, 0] & (sign > 0)
            rest[k] = np.where(ends, (ball.first - ball.floor)[:, 0] / np.where(ends, ball.slowing[:, 0], 1.0), np.inf)
            if ball.mode == "drill":
                early = ends & (ball.first > NEARLY * ball.floor)[:, 0]
                lasts = np.where(early, np.minimum(lasts, 0.75 * rest[k]), lasts)
                rest[k, early] = np.inf
    soon = rest.min(axis=0)
    ends = soon <= lasts
    lasts = np.where(ends, soon, np.where(soon < 2 * lasts, soon / 2, lasts))
    return lasts * sign, np.where(ends, rest.argmin(axis=0), -1)


def _lead(
    balls: list[Ball],
    who: Ints,
    now: Array,
    lasts: Array,
    ender: int,
    size: int = NODES,
    onset: Flags | None = None,
) -> tuple[Piece, Flags]:
    """Both balls for a time `lasts`, (k,), or until s of ball `ender` is down; and for which that is their motion.

    onset (k,): pairs whose ball 0 starts, at the piece's far end, where the pull on it overcomes what holds it.
    """
    on, anchor, long = mesh(size), -1 if onset is not None else 0, lasts[:, None]
    for k, ball in enumerate(balls):
        ball.guess(on, long, k == ender, anchor)
    change, some = np.full(len(lasts), np.inf), slice(size // 2 - 1, None, size // 2)
    with np.errstate(all="ignore"):  # a runaway piece is led again, shorter
        for turn in range(TURNS if size <= NODES else PATIENCE):
            _feel(balls)
            if ender >= 0:
                long = balls[ender].ending()
            if onset is not None:
                share = 1.0 if turn < QUICK else 0.5  # near the slowest that can come, whole steps go to and fro
                long = np.where(onset[:, None], long * (1 - share * _beyond(balls[0].excess(), on)), long)
            worst = np.zeros(len(lasts))
            for k, ball in enumerate(balls):
                before = ball.away
                ball.go(long, k == ender, anchor)
                worst = np.maximum(worst, most(ball.away[..., some] - before[..., some]))
            last, change = change, worst / np.abs(long[:, 0])
            to_come = change * np.minimum(change / np.maximum(last, FAINT), 1.0)
            good = (to_come < np.inf) & (np.sign(long[:, 0]) == np.sign(lasts))
            for ball in balls:
                good &= ball.stays | (onset is not None)  # whose start may yet be found
            if turn > 0 and to_come.max(initial=0.0, where=good) < SETTLED:
                break
        good &= (to_come < SETTLED) & balls[0].sound() & balls[1].sound()
        then, over, courses = now + long[:, 0], np.zeros((2, len(now)), dtype=bool), []
        for k, ball in enumerate(balls):
            coefficients, rough = ball.coefficients()
            good &= rough < 1
            if ball.mode == "fly":
                over[k] = long[:, 0] >= ball.flies()
            elif ball.mode in ("slide", "drill", "roll"):
                over[k] = ball.over()
            motion: Any = {"creep": "roll", "drill": "slide"}.get(ball.mode, ball.mode)
            series = Stretch(who, now, then, coefficients)
            whole = np.minimum(now, then), np.maximum(now, then), motion, series, ball.state, ball.body.radius
            courses.append(Course(who, *whole, ball.model.gravity))
    ways = (np.stack([ball.x for ball in balls]), np.stack([ball.v for ball in balls]))
    last_states = np.stack([ball.last(long) for ball in balls])
    return Piece(who, now, then, *ways, last_states, over, (courses[0], courses[1])), good


def _beyond(early: Array, on: Mesh) -> Array:
    """By what share of itself a piece leads beyond the place where the excess at its far end is zero, (k, 1)."""
    return np.asarray(np.clip(early[:, -1:] / (early @ on.slope[:, -1:]), -0.3, 0.3))


def approach(model: Model, bodies: Pair, touching: Array, time: Array, start: Array) -> tuple[Array, list[Piece], Ints]:
    """What leads to contacts at `time` (k,), states (2, k, 9), of balls 0 that rested with balls 1 that roll.

    Ball 0 is let go where the pull on it overcomes what holds it, but when ball 1 is AWAY at the earliest. Returns the
    states at the contact, of balls 0 with the velocity they then have; pieces that lead back from there, to `start` or
    to the onset, whichever is earlier; the pairs that have no such past.
    """
    one, two = touching
    here, way = two[:, :2].T[..., None], two[:, 3:5].T[..., None]

    def early(tau: Array) -> Array:
        return excess(model, bodies[0], one, here - tau[:, None] * way)[:, 0]

    far = AWAY * (bodies[0].radius + bodies[1].radius) / np.hypot(way[0], way[1])[:, 0]
    low, high = 1e-4 * far, far
    for _ in range(12):
        middle = np.sqrt(low * high)
        pulled = early(middle) > 0
        low, high = np.where(pulled, middle, low), np.where(pulled, high, middle)
    held = early(far) > 0
    lasts, todo = np.where(held, far, low), np.flatnonzero(early(0 * far) > 0)
    hit, then, now, pieces = touching.copy(), touching.copy(), time.astype(float).copy(), []
    for size in STARTS:
        if len(todo):
            pair = bodies[0][todo], bodies[1][todo]
            begin = _begin(model, pair, ("creep", "roll"), touching[:, todo], np.zeros((2, len(todo))))
            piece, good = _lead(begin, todo, time[todo], -lasts[todo], -1, size, ~held[todo])
            piece, todo = piece if np.all(good) else piece.of(good), todo[~good]
            pieces += [piece] if len(piece.who) else []
            then[:, piece.who], now[piece.who] = piece.last, piece.then
            at = hit[0, piece.who, :2], piece.velocities[0, ..., 0].T, hit[0, piece.who, 8:]
            hit[0, piece.who] = rolling_state(at[0], at[1], at[2][:, 0], bodies[0].radius[piece.who])
    lost = [todo]
    then[0, :, 3:8] = 0.0
    todo = np.setdiff1d(np.flatnonzero(now > start), todo)
    while len(todo):
        pair = bodies[0][todo], bodies[1][todo]
        nothing = np.zeros((2, len(todo)))
        found, failed = step(model, pair, ("rest", "roll"), then[:, todo], nothing, now[todo], start[todo])
        lost.append(todo[failed])
        for piece in found:
            piece = piece.among(todo)
            pieces.append(piece)
            then[1, piece.who], now[piece.who] = piece.last[1], piece.then
        todo = np.setdiff1d(todo[now[todo] > start[todo]], lost[-1])
    return hit, pieces, np.concatenate(lost)
