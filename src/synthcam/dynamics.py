"""solve: a model and a launch -> the whole motion, in exact legs between exactly placed events."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from synthcam.impact import collide
from synthcam.launch import Launch
from synthcam.model import Model
from synthcam.numeric import SLOWEST, numeric_roll, numeric_slide
from synthcam.trajectory import (
    Array,
    Event,
    Leg,
    Rest,
    Roll,
    Slide,
    Trajectory,
    contact_velocity,
    rolling_state,
    rolling_velocity,
)

STILL = 1e-12  # m/s: slower than this is rest, or rolling for a contact velocity
TOUCHING = 1e-12  # of a radius
LINGERING = 1e-9  # m/s: an impact softer than this is one of an endless row, as restitution under 0.4 may bring
LIMIT = 10_000  # events: more means that something never settles


def solve(model: Model, launch: Launch, start: float = 0.0, end: float = 0.0) -> Trajectory:
    """The motion from `start` to `end` (s) or to the last slide's end, whichever is later.

    Legs are closed forms where no active effect bends them, numerical solutions elsewhere. Raises ValueError when a
    ball that should be at rest cannot stay there, or when balls overlap at the launch.
    """
    states = [state.copy() for state in launch.states]
    legs: list[list[Leg]] = [_before(model, s, start, launch.time) for s in states]
    events: list[Event] = []
    t = launch.time
    open_legs: list[Leg] = [_leg(model, s, t, end) for s in states]
    for _ in range(LIMIT):
        sliding = any(leg.motion == "slide" for leg in open_legs)
        horizon = min([leg.t1 for leg in open_legs] + ([] if sliding else [max(end, t)]))
        contact = _first_contact(open_legs, t, horizon, 2 * model.ball.radius)
        event: Event | None
        if contact is not None:
            t, i, j = contact
            i, j = _target_first(open_legs, i, j, t)
            new, event = _impact(model, open_legs, i, j, t)
            changed = {i: new[0], j: new[1]}
        else:
            t = horizon
            ending = [k for k, leg in enumerate(open_legs) if leg.t1 <= t]
            if not ending:
                break
            k = ending[0]
            state, event = _settle(model, open_legs[k], k)
            changed = {k: state}
        if event is not None:
            events.append(event)
        for k, state in changed.items():
            legs[k].append(dataclasses.replace(open_legs[k], t1=t))  # type: ignore[type-var]
            open_legs[k] = _leg(model, state, t, max(end, t))
    else:
        raise ValueError(f"the motion does not settle: {LIMIT} events by {t:g} s")
    for k, leg in enumerate(open_legs):
        legs[k].append(dataclasses.replace(leg, t1=t))  # type: ignore[type-var]
    return Trajectory(start, t, tuple(tuple(x) for x in legs), tuple(events))


def _before(model: Model, state: Array, start: float, time: float) -> list[Leg]:
    """The leg that leads to a launch: a ball rolling, or at rest."""
    if start >= time:
        return []
    if np.hypot(*contact_velocity(state, model.ball.radius)) > STILL:
        raise ValueError("a ball that slides at its launch has no past: start the run at the launch")
    leg = _leg(model, state, time, start)
    if leg.motion == "roll" and start < leg.t0 < time:
        raise ValueError(f"a ball has no past before {leg.t0:.6g} s: the push set it rolling from rest there")
    return [dataclasses.replace(leg, t0=start, t1=time)]  # type: ignore[type-var]


def _leg(model: Model, state: Array, t: float, until: float) -> Leg:
    """The leg of a ball that has this state at t, to its own next event; a numerical roll is solved to `until`."""
    radius = model.ball.radius
    u = float(np.hypot(*contact_velocity(state, radius)))
    if u > STILL:
        if model.laws.bent("friction", "normal_load", "push"):
            return numeric_slide(model, state, t)
        slowing = model.sliding_friction * model.gravity
        return Slide(t, t + u / (3.5 * slowing), state, radius, slowing)
    speed = float(np.hypot(state[3], state[4]))
    pushed = model.laws.bent("push")
    if speed <= STILL:
        if pushed:
            instant = {"position": state[:2], "velocity": np.zeros(2), "gravity": model.gravity}
            push = float(np.hypot(*model.laws("push", np.zeros(2), instant)))
            if 5 / 7 * push > model.rolling_decel:
                raise ValueError(
                    f"a ball cannot rest: 5/7 of the push, {5 / 7 * push:.3g} m/s^2, exceeds rolling_decel"
                )
        state = rolling_state(state[:2], np.zeros(2), state[8], radius)
        return Rest(t, np.inf, state)
    if pushed or model.laws.bent("rolling"):
        return numeric_roll(model, state, t, until)
    stop = t + Roll.stop_after(speed, model.rolling_drag, model.rolling_decel)
    return Roll(t, stop, t, state, radius, model.rolling_drag, model.rolling_decel)


def _settle(model: Model, leg: Leg, ball: int) -> tuple[Array, Event | None]:
    """The end of a slide or of a roll; no event where a numerical roll was merely not solved further."""
    radius = model.ball.radius
    before = leg.at(np.array([leg.t1]))[0]
    if leg.motion == "roll" and np.hypot(before[3], before[4]) > 2 * SLOWEST:
        return before, None
    velocity = rolling_velocity(before, radius) if leg.motion == "slide" else np.zeros(2)
    after = rolling_state(before[:2], velocity, before[8], radius)
    kind = "slide_end" if leg.motion == "slide" else "stop"
    return after, Event(leg.t1, kind, ball, before=before[None], after=after[None])  # type: ignore[arg-type]


def _impact(model: Model, legs: list[Leg], i: int, j: int, t: float) -> tuple[Array, Event]:
    before = np.stack([legs[k].at(np.array([t]))[0] for k in (i, j)])
    hit = collide(model, before[0], before[1])
    if hit.impulse_n < LINGERING:
        raise ValueError(f"balls {i} and {j} stay in contact from {t:.6g} s on: only separate impacts are modelled")
    event = Event(t, "contact", i, j, before, hit.states, hit.n, hit.impulse_n, hit.impulse_t)
    return hit.states, event


def _target_first(legs: list[Leg], i: int, j: int, t: float) -> tuple[int, int]:
    """The slower ball is the target, i; the lower index when they are equally fast."""
    speeds = [float(np.hypot(*legs[k].at(np.array([t]))[0, 3:5])) for k in (i, j)]
    return (j, i) if speeds[0] > speeds[1] else (i, j)


def _first_contact(legs: list[Leg], t: float, horizon: float, diameter: float) -> tuple[float, int, int] | None:
    """Time and balls of the first contact in [t, horizon], or None."""
    found = None
    for i, j in itertools.combinations(range(len(legs)), 2):
        if legs[i].motion == legs[j].motion == "rest":
            continue
        when = _contact(legs[i], legs[j], t, horizon, diameter)
        if when is not None:
            found, horizon = (when, i, j), when
    return found


def _contact(a: Leg, b: Leg, t: float, horizon: float, diameter: float) -> float | None:
    """First time in [t, horizon] at which two balls touch and approach.

    Steps that cannot pass a contact: the gap h(t) stays above h + h' s - A s^2/2 where A bounds both accelerations,
    for the distance of two points in free motion is convex. On a contact they converge like Newton's method.
    """
    steepest = a.bound(t) + b.bound(t)
    touching = TOUCHING * diameter / 2
    while True:
        at = np.array([t])
        relative = a.at(at)[0] - b.at(at)[0]
        distance = float(np.hypot(relative[0], relative[1]))
        gap = distance - diameter
        rate = float(relative[:2] @ relative[3:5]) / distance
        if gap <= touching:
            if rate < 0:
                return t
            if gap < -1e-6 * diameter:
                raise ValueError(f"balls overlap by {-gap:.3g} m at {t:.6g} s")
            gap = touching if rate == 0 else max(gap, 0.0)
        step = _safe_step(gap, rate, steepest)
        if t + step > horizon:
            return None
        if t + step == t and rate < 0:  # nearer than the last bit of the time can tell
            return t
        t = max(t + step, float(np.nextafter(t, np.inf)))


def _safe_step(gap: float, rate: float, steepest: float) -> float:
    """The positive root s of gap + rate s - steepest s^2/2 = 0."""
    if steepest == 0:
        return gap / -rate if rate < 0 else np.inf
    root = np.sqrt(rate * rate + 2 * steepest * gap)
    return float((rate + root) / steepest if rate > 0 else 2 * gap / (root - rate))
