"""solve: a model and a launch -> the whole motion, in exact legs between exactly placed events."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from synthcam import rolling, sliding
from synthcam.hermite import Table, around
from synthcam.impact import LOWEST, collide, land
from synthcam.kinematics import (
    Array,
    contact_velocity,
    fly,
    rolling_state,
    rolling_velocity,
    slide_time,
    stop_time,
)
from synthcam.launch import Launch
from synthcam.model import Bodies, Model
from synthcam.trajectory import Event, Fly, Leg, Numeric, Rest, Roll, Slide, Trajectory

STILL = 1e-12  # m/s: slower than this is rest, or rolling for a contact velocity
TOUCHING = 1e-12  # of a radius
LINGERING = 1e-9  # m/s: an impact softer than this is one of an endless row, as restitution under 0.4 may bring
CLINGING = 1e-4  # m/s: the same for balls that push each other, whose row is long
LIMIT = 10_000  # events: more means that something never settles
AHEAD = 0.2  # s of numerical rolling beyond what was asked for
SWEEPS = 12  # over balls that push each other, at most
AGREED = 1e-11  # m between sweeps
WINDOW, SHORTEST = 0.1, 2e-4  # s: how far ahead balls that push each other are led, at most and at least

Others = Callable[[Array], Array]  # times (m,) -> places of the other ball (m, 2)


def solve(model: Model, launch: Launch, start: float = 0.0, end: float = 0.0) -> Trajectory:
    """The motion from `start` to `end` (s) or to the last slide's end, whichever is later.

    Legs are closed forms where no active effect bends them, numerical solutions elsewhere. Raises ValueError when a
    ball that should be at rest cannot stay there, when balls overlap, or when the motion does not settle.
    """
    if model.laws.asks("push", "other") and len(launch.states) > 2:
        raise ValueError(f"balls that push each other are modelled in twos, not {len(launch.states)} at a time")
    return _Run(model, launch, start, end).motion()


def uncoupled(model: Model) -> Model:
    """The model without the effects by which balls push each other."""
    return dataclasses.replace(model, effects=tuple(e for e in model.effects if "other" not in e.laws.get("push", ())))


def _path_of(leg: Leg, t: float) -> Others:
    """Where a ball is about the time t; beyond the ends of its leg it goes straight on."""
    if leg.motion == "rest":
        place = leg.at(np.array([t]))[0, :2]
        return lambda times: np.broadcast_to(place, (len(times), 2))
    knots = np.unique(around(np.array([t]), leg.t0, leg.t1), axis=1)
    table = Table.of(lambda times: leg.at(times[0])[None][..., [0, 1, 3, 4]], knots)
    return lambda times: table(np.array([0]), times[None])[0]


class _Run:
    """One run of the event loop.

    Two balls that push each other are led from event to event: each in the other's last known leg, until both agree.
    """

    def __init__(self, model: Model, launch: Launch, start: float, end: float) -> None:
        self.model, self.bodies, self.end = model, launch.bodies, end
        self.start, self.t = start, launch.time
        self.events: list[Event] = []
        self.mutual = model.laws.asks("push", "other") and len(launch.states) == 2
        self.others: list[Others | None] = [None] * len(launch.states)
        self.window = np.inf
        states = dict(enumerate(launch.states.copy()))
        before = self._agreed(lambda k: self._before(k, states[k], launch.time), states)
        self.past: list[list[Leg]] = [[leg] if leg.t1 > leg.t0 else [] for leg in before]
        if _touching(launch):  # these legs are replaced at once, and would lead one ball through the other
            self.model, self.mutual = uncoupled(model), False
        self.legs = self._agreed(lambda k: self._leg(k, states[k].copy(), launch.time), states)
        self.model, self.mutual = model, model.laws.asks("push", "other") and len(launch.states) == 2

    def motion(self) -> Trajectory:
        for _ in range(LIMIT):
            busy = any(leg.motion in ("slide", "fly") for leg in self.legs)
            horizon = min([leg.t1 for leg in self.legs] + ([] if busy else [max(self.end, self.t)]))
            contact = self._first_contact(horizon)
            if contact is not None:
                self._collide(*contact)
                continue
            self.t = horizon
            ending = [k for k, leg in enumerate(self.legs) if leg.t1 <= self.t]
            if not ending:
                break
            self._settle(ending[0])
        else:
            raise ValueError(f"the motion does not settle: {LIMIT} events by {self.t:g} s")
        for k, leg in enumerate(self.legs):
            self.past[k].append(dataclasses.replace(leg, t1=self.t))  # type: ignore[type-var]
        return Trajectory(self.start, self.t, tuple(tuple(x) for x in self.past), tuple(self.events))

    def _go_on(self, states: dict[int, Array]) -> None:
        """Begin new legs: of these balls, and of those that they push."""
        if self.mutual:
            states = {k: self.legs[k].at(np.array([self.t]))[0] for k in (0, 1)} | states
        for k in states:
            self.past[k].append(dataclasses.replace(self.legs[k], t1=self.t))  # type: ignore[type-var]
        for k, leg in zip(states, self._agreed(lambda k: self._leg(k, states[k], self.t), states), strict=True):
            self.legs[k] = leg

    def _agreed(self, leg: Callable[[int], Leg], states: dict[int, Array]) -> list[Leg]:
        """The legs of these balls from now, or until now; of balls that push each other when they fit each other."""
        if not self.mutual:
            return [leg(k) for k in states]
        self.window = min(10 * self.window, WINDOW)
        while True:
            try:
                return self._fitted(leg, states)
            except ValueError:  # a leg that is tried may lead through the other ball, in a contact yet to be found
                if self.window < SHORTEST:
                    raise
                self.window /= 10

    def _fitted(self, leg: Callable[[int], Leg], states: dict[int, Array]) -> list[Leg]:
        self.others = [_path_of(Rest(self.t, self.t, states[1 - k]), self.t) for k in (0, 1)]
        seen = np.empty(0)
        for _ in range(SWEEPS):
            legs = [leg(k) for k in states]
            first, last = max(x.t0 for x in legs), min(x.t1 for x in legs)
            times = np.linspace(first, min(last, max(self.t, self.end) + AHEAD), 33)
            places = np.array([x.at(times)[:, :2] for x in legs])
            if seen.shape == places.shape and np.abs(places - seen).max() < AGREED:
                break
            seen = places
            self.others = [_path_of(legs[1 - k], self.t) for k in (0, 1)]
        return legs

    # legs

    def _body(self, k: int) -> Bodies:
        return self.bodies[k : k + 1]

    def _other(self, k: int) -> sliding.Other | None:
        path = self.others[k]
        return None if path is None else lambda t, _: path(t.ravel()).reshape(*t.shape, 2)

    def _before(self, k: int, state: Array, time: float) -> Leg:
        """The leg that leads to a launch: a ball rolling, or at rest."""
        if self.start >= time:
            return Rest(time, time, state)
        radius = float(self.bodies.radius[k])
        if np.hypot(*contact_velocity(state, radius)) > STILL or state[5] != 0:
            raise ValueError("a ball that slides or flies at its launch has no past: start the run at the launch")
        if np.hypot(state[3], state[4]) <= STILL:
            still = rolling_state(state[:2], np.zeros(2), state[8], radius)
            if not self.model.laws.asks("push", "other") and self._excess(k, still, time) > 0:
                raise ValueError("a ball cannot rest before its launch: 5/7 of the push on it exceeds rolling_decel")
            return Rest(self.start, time, still)
        leg = self._roll(k, state, time, self.start)
        if isinstance(leg, Numeric) and leg.t0 > self.start:
            raise ValueError(f"a ball has no past before {leg.t0:g} s: it would have had to come from rest")
        return dataclasses.replace(leg, t0=self.start, t1=time)  # type: ignore[type-var]

    def _leg(self, k: int, state: Array, t: float) -> Leg:
        """The leg of a ball that has this state at t, to its own next event."""
        radius = float(self.bodies.radius[k])
        if state[5] > 0 or _aloft(state, radius):
            return self._fly(k, state, t)
        u = float(np.hypot(*contact_velocity(state, radius)))
        if u > STILL:
            return self._slide(k, state, t)
        if np.hypot(state[3], state[4]) > STILL:
            return self._roll(k, state, t, min(max(self.end, t) + AHEAD, t + self.window))
        return self._rest(k, state, t)

    def _slide(self, k: int, state: Array, t: float) -> Leg:
        radius = float(self.bodies.radius[k])
        if not self.model.laws.bent(*sliding.LAWS):
            slowing = self.model.sliding_friction * self.model.gravity
            return Slide(t, t + float(slide_time(state, radius, slowing)), state, radius, slowing)
        found = sliding.slides(self.model, state[None], self._body(k), np.array([t]), self._other(k))
        lasts = float(found.lasts[0])

        def states(times: Array) -> Array:
            return np.asarray(found.states((times - t)[None])[0])

        return Numeric(t, t + lasts, "slide", states, _steepest(states, t, lasts))

    def _roll(self, k: int, state: Array, t: float, until: float) -> Leg:
        model, radius = self.model, float(self.bodies.radius[k])
        if not model.laws.bent(*rolling.LAWS):
            stop = t + float(stop_time(np.hypot(state[3], state[4]), model.rolling_drag, model.rolling_decel))
            return Roll(t, stop, t, state, radius, model.rolling_drag, model.rolling_decel)
        found = rolling.rolls(model, state[None], self._body(k), np.array([t]), np.array([until]), self._other(k))
        ended = float(found.until[0])

        def states(times: Array) -> Array:
            return np.asarray(found.states(times[None])[0])

        return Numeric(min(t, ended), max(t, ended), "roll", states, _steepest(states, t, ended - t))

    def _fly(self, k: int, state: Array, t: float) -> Leg:
        model = self.model
        up, height = float(state[5]), max(float(state[2] - self.bodies.radius[k]), 0.0)
        lasts = (up + float(np.sqrt(up * up + 2 * model.gravity * height))) / model.gravity
        leg = Fly(t, t + lasts, state, model.gravity)
        if not model.laws.bent("push"):
            return leg
        times = np.array([t]), np.array([t + lasts])
        found = rolling.flights(model, state[None], self._body(k), *times, self._other(k))

        def states(at: Array) -> Array:
            out = fly(state, model.gravity, at - t)
            plane = found.plane(at[None])[0]
            out[:, 0:2], out[:, 3:5] = plane[:, :2], plane[:, 2:]
            return out

        return Numeric(t, t + lasts, "fly", states, model.gravity + _steepest(states, t, lasts))

    def _rest(self, k: int, state: Array, t: float) -> Leg:
        """Rest, until a push that depends on the other ball overcomes what holds the ball."""
        still = rolling_state(state[:2], np.zeros(2), state[8], float(self.bodies.radius[k]))
        if not self.model.laws.bent("push"):
            return Rest(t, np.inf, still)
        if self._excess(k, still, t) > 0:
            return Rest(t, t, still)
        if self.others[k] is None:
            return Rest(t, np.inf, still)
        return Rest(t, self._loosened(k, still, t), still)

    def _excess(self, k: int, state: Array, t: float) -> float:
        """By how much 5/7 of the push on a ball at rest exceeds what holds it, or would were it to roll, m/s^2."""
        instant = self._at_rest(k, state, t)
        push = self.model.laws("push", np.zeros(2), instant)
        size, decel = float(np.hypot(*push)), self.model.rolling_decel
        nudge = rolling.SLOWEST * push / (size or 1.0)
        loss = self.model.laws("rolling", decel, instant | {"velocity": nudge, "speed": rolling.SLOWEST})
        return size * 5 / 7 - max(decel, float(loss))

    def _at_rest(self, k: int, state: Array, t: float) -> dict[str, Any]:
        body, other = self._body(k), self._other(k)
        instant: dict[str, Any] = dict(position=state[:2], velocity=np.zeros(2), gravity=self.model.gravity)
        instant |= dict(radius=body.radius[0], mass=body.mass[0], of_a=body.of_a[0])
        instant["other"] = sliding.NOWHERE if other is None else other(np.array([[t]]), 0)[0, 0] - state[:2]
        return instant

    def _loosened(self, k: int, state: Array, t: float) -> float:
        """When a ball at rest starts to roll, or infinity: looked for every ms, then halved."""
        for a in np.arange(t, max(self.end, t) + AHEAD, 1e-3):
            if self._excess(k, state, a + 1e-3) > 0:
                low, high = a, a + 1e-3
                while high - low > 1e-12:
                    middle = (low + high) / 2
                    low, high = (low, middle) if self._excess(k, state, middle) > 0 else (middle, high)
                return float(high)
        return np.inf

    # events

    def _settle(self, k: int) -> None:
        """The end of a leg: of a slide, a roll, a rest, a flight; no event where a numerical roll was solved to."""
        leg, radius = self.legs[k], float(self.bodies.radius[k])
        before = leg.at(np.array([leg.t1]))[0]
        if leg.motion == "roll" and np.hypot(before[3], before[4]) > 2 * rolling.SLOWEST:
            self._go_on({k: before})
        elif leg.motion == "fly":
            self._go_on({k: self._landed(k, before)})
        elif leg.motion == "rest":
            push = self.model.laws("push", np.zeros(2), self._at_rest(k, before, self.t))
            nudge = 2 * rolling.SLOWEST * push / np.hypot(*push)
            self._happen("start", k, before, rolling_state(before[:2], nudge, before[8], radius))
        else:
            velocity = rolling_velocity(before, radius) if leg.motion == "slide" else np.zeros(2)
            after = rolling_state(before[:2], velocity, before[8], radius)
            self._happen("slide_end" if leg.motion == "slide" else "stop", k, before, after)

    def _landed(self, k: int, before: Array) -> Array:
        radius = float(self.bodies.radius[k])
        before[2] = radius
        after = land(self.model, before[None], self._body(k))[0]
        slips = [float(np.hypot(*contact_velocity(s, radius))) for s in (before, after)]
        self.events.append(Event(self.t, "land", k, before=before[None], after=after[None]))
        if slips[0] > STILL and slips[1] <= 1e-9 * slips[0]:
            after = _rolling(after, radius)
            self.events.append(Event(self.t, "slide_end", k, before=before[None], after=after[None]))
        return np.asarray(after)

    def _happen(self, kind: str, k: int, before: Array, after: Array) -> None:
        self.events.append(Event(self.t, kind, k, before=before[None], after=after[None]))  # type: ignore[arg-type]
        self._go_on({k: after})

    def _collide(self, t: float, i: int, j: int) -> None:
        self.t = t
        states = {k: self.legs[k].at(np.array([t])) for k in (i, j)}
        speeds = {k: float(np.hypot(*states[k][0, 3:5])) for k in (i, j)}
        i, j = (j, i) if speeds[i] > speeds[j] else (i, j)  # the slower ball is the target
        hit = collide(self.model, states[i], states[j], self._body(i), self._body(j))
        if hit.impulse_n[0] < (CLINGING if self.mutual else LINGERING) * self.bodies.mass[i]:
            raise ValueError(f"balls {i} and {j} stay in contact from {t:.6g} s on: only separate impacts are modelled")
        n = (float(hit.n[0, 0]), float(hit.n[0, 1]))
        before, after = np.concatenate([states[i], states[j]]), np.concatenate([hit.target, hit.striker])
        after[:, 5] = np.where(np.abs(after[:, 5]) < LOWEST, 0.0, after[:, 5])
        impulses = float(hit.impulse_n[0]), float(hit.impulse_t[0])
        self.events.append(Event(t, "contact", i, j, before, after, n, *impulses))
        new = {i: after[0], j: after[1]}
        for k, state in new.items():
            if state[5] < 0 and not _aloft(state, float(self.bodies.radius[k])):
                new[k] = self._landed(k, state.copy())
        self._go_on(new)

    def _first_contact(self, horizon: float) -> tuple[float, int, int] | None:
        """Time and balls of the first contact in [now, horizon], or None."""
        found = None
        for i, j in itertools.combinations(range(len(self.legs)), 2):
            if self.legs[i].motion == self.legs[j].motion == "rest":
                continue
            reach = float(self.bodies.radius[i] + self.bodies.radius[j])
            when = _contact(self.legs[i], self.legs[j], self.t, horizon, reach)
            if when is not None:
                found, horizon = (when, i, j), when
        return found


def _rolling(state: Array, radius: float) -> Array:
    """The same state with the last rounding of its slip taken out; a flight's vertical velocity is kept."""
    out = rolling_state(state[:2], rolling_velocity(state, radius), state[8], radius)
    out[5] = state[5]
    return out


def _aloft(state: Array, radius: float) -> bool:
    return bool(state[2] > radius * (1 + TOUCHING))


def _touching(launch: Launch) -> bool:
    reach = launch.bodies.radius[:, None] + launch.bodies.radius
    apart = np.linalg.norm(launch.states[:, None, :3] - launch.states[:, :3], axis=-1) - reach
    return bool(np.any(apart[~np.eye(len(apart), dtype=bool)] <= TOUCHING * launch.bodies.radius.min()))


def _contact(a: Leg, b: Leg, t: float, horizon: float, reach: float) -> float | None:
    """First time in [t, horizon] at which two balls touch and approach; reach: the sum of their radii.

    Steps that cannot pass a contact: the gap h(t) stays above h + h' s - A s^2/2 where A bounds both accelerations,
    for the distance of two points in free motion is convex. On a contact they converge like Newton's method.
    """
    steepest = a.bound(t) + b.bound(t)
    touching = TOUCHING * reach / 2
    while True:
        at = np.array([t])
        relative = a.at(at)[0] - b.at(at)[0]
        distance = float(np.linalg.norm(relative[:3]))
        gap = distance - reach
        rate = float(relative[:3] @ relative[3:6]) / distance
        if gap <= touching:
            passing = float(relative[3:6] @ relative[3:6]) / distance > steepest  # what parts them outgrows all else
            if rate < 0 and not (passing and rate > -LINGERING):
                return t
            if gap < -1e-6 * reach:
                raise ValueError(f"balls overlap by {-gap:.3g} m at {t:.6g} s")
            gap, rate = (touching, 0.0) if rate <= 0 else (max(gap, 0.0), rate)
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


def _steepest(states: Others, t: float, lasts: float) -> float:
    """A bound of the acceleration along a leg: twice the largest found between samples."""
    times = np.linspace(t, t + lasts, 65)
    v = states(times)[:, 3:5]
    return float(2 * np.max(np.linalg.norm(np.diff(v, axis=0), axis=1)) / max(abs(lasts) / 64, 1e-300))
