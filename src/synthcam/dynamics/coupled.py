"""Two balls that push each other: both led together, piece by piece, from event to event."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.dynamics.contact_time import TOUCHING
from synthcam.dynamics.kinematics import Array, contact_velocity, fly, plate_state, resting, rolling_state
from synthcam.dynamics.pushed_ball import FAINT, SMALLEST, STEADY, STILL, Ball, Mesh, last_axis, mesh, most
from synthcam.dynamics.rolling import SLOWEST, Stretch
from synthcam.dynamics.sliding import ending_slip
from synthcam.dynamics.trajectory import Leg, Numeric, Rest
from synthcam.model import Bodies, Model

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

Pair = tuple[Bodies, Bodies]
Modes = tuple[str, str]


@dataclass(frozen=True)
class Piece:
    """The motion of two balls to the time `then`, from an earlier or later one.

    places, velocities (2 balls, 2, n): at times spread over it, ends among them; last (2, 1, 9): states at its end;
    over: whose slide, drilling, roll or flight ended with it.
    """

    then: float
    places: Array
    velocities: Array
    last: Array
    over: tuple[bool, bool]
    legs: tuple[Leg, Leg]


def floor_of(model: Model, bodies: Pair, states: Array, ball: int) -> float:
    """The slip at which a ball that begins to slide in states (2, 1, 9) no longer drills; inf if it never does."""
    if not model.laws.bent("drilling"):
        return math.inf
    other = (states[1 - ball] - states[ball])[:, None, :2]
    late = float(ending_slip(model, states[ball], bodies[ball], other)[0])
    return late if late < math.hypot(*contact_velocity(states[ball], bodies[ball].radius)[0]) else math.inf


def mode_of(state: Array, radius: Array, floor: float) -> str:
    """What a ball in state (1, 9) does: rest, roll, drill (down to the slip `floor`), slide or fly."""
    if state[0, 5] > 0 or state[0, 2] > radius[0] * (1 + TOUCHING):
        return "fly"
    if math.hypot(*contact_velocity(state, radius)[0]) > STILL:
        return "drill" if math.isfinite(floor) else "slide"
    return "roll" if math.hypot(*state[0, 3:5]) > STILL else "rest"


def opening(states: Array) -> float:
    """How fast balls in states (2, 1, 9) part, times their distance, m^2/s."""
    apart = (states[0] - states[1])[0]
    return float(apart[:3] @ apart[3:6])


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
    model: Model, bodies: Pair, modes: Modes, states: Array, floor: Sequence[float], now: float, goal: float
) -> Piece | None:
    """The next piece of both balls in these modes, states (2, 1, 9) at `now`, on the way to `goal`.

    floor: slips at which they no longer drill. It leads no further than to the first end of a slide, of its drilling,
    of a roll or flight. None if no piece is short enough.
    """
    balls = _begin(model, bodies, modes, states, floor)
    lasts, ender = _plan(balls, goal - now)
    for _ in range(HALVINGS):
        piece = _lead(balls, now, lasts, ender)
        if piece is not None:
            return piece
        lasts, ender = lasts / 2, -1
        balls = _begin(model, bodies, modes, states, floor)
    return None


def _begin(model: Model, bodies: Pair, modes: Modes, states: Array, floor: Sequence[float]) -> list[Ball]:
    balls = [Ball(model, *each) for each in zip(modes, bodies, states, floor, strict=True)]
    _feel(balls)
    return balls


def _feel(balls: Sequence[Ball]) -> None:
    places = balls[1].x, balls[0].x
    for ball, other in zip(balls, places, strict=True):
        ball.feel(other)


def _plan(balls: Sequence[Ball], left: float) -> tuple[float, int]:
    """How long the next piece may be, negative where it leads back; of which ball s is down with it, or -1."""
    (x, y), drift = (balls[1].x - balls[0].x)[:, 0, 0], (balls[1].v - balls[0].v)[:, 0, 0]
    far, speed = math.hypot(x, y), max(math.hypot(*drift), FAINT)
    force = max(sum(float(np.hypot(*ball.push)[0, 0]) for ball in balls if ball.mode != "rest"), FAINT)
    rho = max(BOOST * force * far / speed / STEADY, 1.0) ** (1 / (NODES - 3))
    room = min(max(4 / max(rho + 1 / rho - 2, 1e-3), 0.1), 10.0)  # a pole at r = 0 lets r grow by so much
    if (x * drift[0] + y * drift[1]) * left < 0:
        reach = float(balls[0].body.radius[0] + balls[1].body.radius[0])
        room = min(room / (1 + room), max(1 - 0.85 * reach / far, 0.15))
    lasts = min(room * far / speed, math.sqrt(far / force), abs(left))
    soon, ender = math.inf, -1
    for k, ball in enumerate(balls):
        if ball.mode == "fly":
            lasts = min(lasts, ball.flies())
        elif ball.mode in ("slide", "drill", "roll") and left > 0 and ball.slowing[0, 0] > 0:
            ends = float((ball.first - ball.floor)[0, 0] / ball.slowing[0, 0])
            if ball.mode == "drill" and ball.first[0, 0] > NEARLY * ball.floor[0, 0]:
                lasts = min(lasts, 0.75 * ends)
            elif ends < soon:
                soon, ender = ends, k
    if soon <= lasts:
        return soon, ender
    return math.copysign(soon / 2 if soon < 2 * lasts else lasts, left), -1


def _lead(
    balls: list[Ball], now: float, lasts: float, ender: int, size: int = NODES, onset: bool | None = None
) -> Piece | None:
    """Both balls for a time `lasts`, or until s of ball `ender` is down; None if that is not their motion.

    onset: whether ball 0, which creeps, starts at the piece's far end, where the pull on it overcomes what holds it.
    """
    on, anchor, long = mesh(size), 0 if onset is None else -1, np.full((1, 1), lasts)
    for k, ball in enumerate(balls):
        ball.guess(on, long, k == ender, anchor)
    change, some = math.inf, slice(size // 2 - 1, None, size // 2)
    with np.errstate(all="ignore"):  # a runaway piece is led again, shorter
        for turn in range(TURNS if size <= NODES else PATIENCE):
            _feel(balls)
            if ender >= 0:
                long = balls[ender].ending()
            if onset:
                share = 1.0 if turn < QUICK else 0.5  # near the slowest that can come, whole steps go to and fro
                long = long * (1 - share * _beyond(balls[0].excess(), on))
            before = [ball.away for ball in balls]
            for k, ball in enumerate(balls):
                ball.go(long, k == ender, anchor)
            moved = [most((ball.away - old)[..., some])[0] for ball, old in zip(balls, before, strict=True)]
            last, change = change, np.max(moved) / np.abs(long[0, 0])
            to_come = change * np.minimum(change / np.maximum(last, FAINT), 1.0)
            good = to_come < np.inf and np.sign(long[0, 0]) == np.sign(lasts)
            good = good and (onset is not None or all(ball.stays for ball in balls))  # a start may yet be found
            if turn > 0 and (not good or to_come < SETTLED):
                break
        found = [ball.coefficients() for ball in balls]
        fine = [ball.sound() and rough < 1 for ball, (_, rough) in zip(balls, found, strict=True)]
        if not (good and to_come < SETTLED and all(fine)):
            return None
    then = now + float(long[0, 0])
    places, velocities = (np.stack(ways)[:, :, 0] for ways in ([ball.x for ball in balls], [ball.v for ball in balls]))
    over = [ball.over(float(long[0, 0])) for ball in balls]
    legs = [_leg(ball, now, then, c) for ball, (c, _) in zip(balls, found, strict=True)]
    last_states = np.stack([ball.last(long) for ball in balls])
    return Piece(then, places, velocities, last_states, (over[0], over[1]), (legs[0], legs[1]))


def _leg(ball: Ball, now: float, then: float, coefficients: Array) -> Leg:
    begins, ends, state, radius = min(now, then), max(now, then), ball.state, ball.body.radius
    gravity = ball.model.gravity
    if ball.mode == "rest":
        return Rest(begins, ends, resting(tuple(state[0].tolist()), float(radius[0])))
    path, slides = Stretch(0, np.array([now]), np.array([then]), coefficients), ball.slides

    def states(times: Array) -> Array:
        y = np.moveaxis(path.plane(times[None])[:, 0], 0, -1)
        x, v = y[:, 0:2], y[:, 2:4]
        if slides:
            return plate_state(x, y[:, 4:6], 3.5 * (v - y[:, 4:6]), y[:, 6], radius)
        return plate_state(x, v, np.zeros(2), state[:, 8], radius)

    def aloft(times: Array) -> Array:
        out, y = fly(state[0], gravity, times - now), path.plane(times[None])[:, 0].T
        out[:, 0:2], out[:, 3:5] = y[:, :2], y[:, 2:]
        return out

    if ball.mode == "fly":
        return Numeric.of(begins, ends, "fly", aloft, gravity)
    return Numeric.of(begins, ends, "slide" if slides else "roll", states)


def _beyond(early: Array, on: Mesh) -> Array:
    """By what share of itself a piece leads beyond the place where the excess at its far end is zero, (k, 1)."""
    return np.asarray(np.clip(early[:, -1:] / (early @ on.slope[:, -1:]), -0.3, 0.3))


def approach(
    model: Model, bodies: Pair, touching: Array, time: float, start: float
) -> tuple[Array, list[Piece]] | None:
    """What leads to a contact at `time`, states (2, 1, 9), of ball 0 that rested with ball 1 that rolls.

    Ball 0 is let go where the pull on it overcomes what holds it, but when ball 1 is AWAY at the earliest. Returns the
    states at the contact, of ball 0 with the velocity that it then has; pieces that lead back from there, to `start` or
    to the onset, whichever is earlier. None if there is no such past.
    """
    hit, then, now, pieces = touching.copy(), touching.copy(), time, list[Piece]()
    lasts, held = _pulled_for(model, bodies, touching)
    if lasts > 0:
        for size in STARTS:
            balls = _begin(model, bodies, ("creep", "roll"), touching, (0.0, 0.0))
            piece = _lead(balls, time, -lasts, -1, size, not held)
            if piece is not None:
                break
        else:
            return None
        pieces, then, now = [piece], piece.last, piece.then
        hit[0] = rolling_state(hit[0, :, :2], piece.velocities[0, :, 0], hit[0, :, 8], bodies[0].radius)
    then[0, :, 3:8] = 0.0
    while now > start:
        piece = step(model, bodies, ("rest", "roll"), then, (0.0, 0.0), now, start)
        if piece is None:
            return None
        pieces.append(piece)
        then[1], now = piece.last[1], piece.then
    return hit, pieces


def _pulled_for(model: Model, bodies: Pair, touching: Array) -> tuple[float, bool]:
    """How long ball 0 is pulled along before the contact, were ball 1's roll uniform; is it longer than we look?"""
    here, way = touching[1, :, :2].T[..., None], touching[1, :, 3:5].T[..., None]

    def early(tau: float) -> bool:
        return bool(excess(model, bodies[0], touching[0], here - tau * way)[0, 0] > 0)

    far = AWAY * float((bodies[0].radius + bodies[1].radius)[0]) / math.hypot(*way[:, 0, 0])
    if not early(0.0) or early(far):
        return (far, True) if early(0.0) else (0.0, False)
    low, high = 1e-4 * far, far
    for _ in range(12):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if early(middle) else (low, middle)
    return low, False
