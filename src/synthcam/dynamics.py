"""solve: a model and a launch -> the whole motion, in exact legs between exactly placed events."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from synthcam import rolling, sliding
from synthcam.contact import LINGERING, TOUCHING, first_contact
from synthcam.hermite import Table, around
from synthcam.impact import LOWEST, land, strike
from synthcam.kinematics import Array, State, fly, slip, stop_time
from synthcam.launch import Launch
from synthcam.model import Bodies, Model
from synthcam.trajectory import Event, Fly, Leg, Numeric, Rest, Roll, Slide, Trajectory

STILL = 1e-12  # m/s: slower than this is rest, or rolling for a contact velocity
CLINGING = 1e-4  # m/s: as LINGERING for balls that push each other, whose row is long
LIMIT = 10_000  # events: more means that something never settles
FAR = 1e4  # s: beyond it the clock's last bit is too coarse for an event
LONG = 60.0  # s: balls that push each other are led in small steps
FASTEST = 1e3  # m/s: a ball that must have come faster did not come
AHEAD = 0.2  # s of numerical rolling beyond what was asked for
SWEEPS = 12  # over balls that push each other, at most
AGREED = 1e-11  # m between sweeps
WINDOW, SHORTEST = 0.1, 2e-4  # s: how far ahead balls that push each other are led, at most and at least

Others = Callable[[Array], Array]  # times (m,) -> places of the other ball (m, 2)


def solve(model: Model, launch: Launch, start: float = 0.0, end: float = 0.0) -> Trajectory:
    """The motion from `start` to `end` (s) or to the last slide's end, whichever is later.

    Legs are closed forms where no active effect bends them, numerical solutions elsewhere. Raises ValueError when a
    ball that should be at rest cannot stay there, when balls overlap, when the motion does not settle, and when it is
    asked for at times or speeds beyond FAR and FASTEST.
    """
    for what, t in (("its launch", launch.time), ("its start", start), ("its end", end)):
        if not abs(t) <= FAR:
            raise ValueError(f"{what} is at {t:g} s: a motion is solved within {FAR:g} s of 0")
    if model.laws.asks("push", "other"):
        lasts = max(launch.time, end) - min(launch.time, start)
        if len(launch.states) > 2:
            raise ValueError(f"balls that push each other are modelled in twos, not {len(launch.states)} at a time")
        if lasts > LONG:
            raise ValueError(f"balls that push each other are followed for {LONG:g} s, not for {lasts:g} s")
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
    """One run of the event loop; states are nine floats.

    Two balls that push each other are led from event to event: each in the other's last known leg, until both agree.
    """

    def __init__(self, model: Model, launch: Launch, start: float, end: float) -> None:
        self.model, self.bodies, self.end = model, launch.bodies, end
        self.radius, self.mass = launch.bodies.radius.tolist(), launch.bodies.mass.tolist()
        self.start, self.t = start, launch.time
        self.events: list[Event] = []
        laws = model.laws
        self.slides, self.rolls = laws.bent(*sliding.LAWS), laws.bent(*rolling.LAWS)  # without closed form
        self.pushes = laws.bent("push")
        self.mutual = laws.asks("push", "other") and len(launch.states) == 2
        self.others: list[Others | None] = [None] * len(launch.states)
        self.asleep = [False] * len(launch.states)  # is the other at rest?
        self.window = math.inf
        states = {k: tuple(row) for k, row in enumerate(launch.states.tolist())}
        before = self._agreed(lambda k: self._before(k, states[k], launch.time), states)
        self.past: list[list[Leg]] = [[leg] if leg.t1 > leg.t0 else [] for leg in before]
        if self.mutual and _touching(
            launch
        ):  # these legs are replaced at once, and would lead one ball through the other
            self.model, self.mutual = uncoupled(model), False
            self.legs = self._agreed(lambda k: self._leg(k, states[k], launch.time), states)
            self.model, self.mutual = model, True
        else:
            self.legs = self._agreed(lambda k: self._leg(k, states[k], launch.time), states)

    def motion(self) -> Trajectory:
        for _ in range(LIMIT):
            busy = any(leg.motion in ("slide", "fly") for leg in self.legs)
            horizon = min([leg.t1 for leg in self.legs] + ([] if busy else [max(self.end, self.t)]))
            contact = first_contact(self.legs, self.radius, self.t, horizon)
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
            self.past[k].append(leg.spanning(leg.t0, self.t))
        return Trajectory(self.start, self.t, tuple(tuple(x) for x in self.past), tuple(self.events))

    def _go_on(self, states: dict[int, State]) -> None:
        """Begin new legs: of these balls, and of those that they push."""
        if self.mutual:
            states = {k: self.legs[k].now(self.t) for k in (0, 1)} | states
        for k in states:
            self.past[k].append(self.legs[k].spanning(self.legs[k].t0, self.t))
        for k, leg in zip(states, self._agreed(lambda k: self._leg(k, states[k], self.t), states), strict=True):
            self.legs[k] = leg

    def _agreed(self, leg: Callable[[int], Leg], states: dict[int, State]) -> list[Leg]:
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

    def _fitted(self, leg: Callable[[int], Leg], states: dict[int, State]) -> list[Leg]:
        self._lead([Rest(self.t, self.t, states[k]) for k in (0, 1)])
        seen, change = np.empty(0), np.inf
        for _ in range(SWEEPS):
            legs = [leg(k) for k in states]
            first, last = max(x.t0 for x in legs), min(x.t1 for x in legs)
            times = np.linspace(first, min(last, max(self.t, self.end) + AHEAD), 33)
            places = np.array([x.at(times)[:, :2] for x in legs])
            if seen.shape == places.shape:
                last_change, change = change, float(np.abs(places - seen).max())
                gain = min(change / last_change, 1.0) if last_change < math.inf else 1.0
                if change * gain < AGREED:  # the next sweep gains that factor too
                    break
            seen = places
            self._lead(legs)
        return legs

    def _lead(self, legs: list[Leg]) -> None:
        """From now on each of two balls is pushed by the other on this leg."""
        self.others = [_path_of(leg, self.t) for leg in reversed(legs)]
        self.asleep = [leg.motion == "rest" for leg in reversed(legs)]

    # legs

    def _body(self, k: int) -> Bodies:
        return self.bodies[k : k + 1]

    def _other(self, k: int) -> sliding.Other | None:
        path = self.others[k]
        return None if path is None else lambda t, _: path(t.ravel()).reshape(*t.shape, 2)

    def _before(self, k: int, state: State, time: float) -> Leg:
        """The leg that leads to a launch: a ball rolling, or at rest."""
        if self.start >= time:
            return Rest(time, time, state)
        if math.hypot(*slip(state, self.radius[k])) > STILL or state[5] != 0:
            raise ValueError("a ball that slides or flies at its launch has no past: start the run at the launch")
        if math.hypot(state[3], state[4]) <= STILL:
            still = _still(state, self.radius[k])
            if not self.model.laws.asks("push", "other") and self._excess(k, still, time) > 0:
                raise ValueError("a ball cannot rest before its launch: 5/7 of the push on it exceeds rolling_decel")
            return Rest(self.start, time, still)
        leg = self._roll(k, state, time, self.start)
        if isinstance(leg, Numeric) and leg.t0 > self.start:
            raise ValueError(f"a ball has no past before {leg.t0:g} s: it would have had to come from rest")
        try:
            speed = math.hypot(*leg.now(self.start)[3:5])
        except OverflowError:
            speed = math.inf
        if not speed <= FASTEST:
            raise ValueError(
                f"a ball would have had to come faster than {FASTEST:g} m/s, {time - self.start:g} s earlier"
            )
        return leg.spanning(self.start, time)

    def _leg(self, k: int, state: State, t: float) -> Leg:
        """The leg of a ball that has this state at t, to its own next event."""
        radius = self.radius[k]
        if state[5] > 0 or _aloft(state, radius):
            return self._fly(k, state, t)
        if math.hypot(*slip(state, radius)) > STILL:
            return self._slide(k, state, t)
        if math.hypot(state[3], state[4]) > STILL:
            return self._roll(k, state, t, min(max(self.end, t) + AHEAD, t + self.window))
        return self._rest(k, state, t)

    def _slide(self, k: int, state: State, t: float) -> Leg:
        if not self.slides:
            slowing = self.model.sliding_friction * self.model.gravity
            lasts = math.hypot(*slip(state, self.radius[k])) / (3.5 * slowing)
            return Slide(t, t + lasts, t, state, self.radius[k], slowing)
        found = sliding.slides(self.model, np.array([state]), self._body(k), np.array([t]), self._other(k))
        lasts = float(found.lasts[0])

        def states(times: Array) -> Array:
            return np.asarray(found.states((times - t)[None])[0])

        return Numeric(t, t + lasts, "slide", states, _steepest(states, t, lasts))

    def _roll(self, k: int, state: State, t: float, until: float) -> Leg:
        model = self.model
        if not self.rolls:
            stop = t + stop_time(math.hypot(state[3], state[4]), model.rolling_drag, model.rolling_decel)
            return Roll(t, stop, t, state, self.radius[k], model.rolling_drag, model.rolling_decel)
        times = np.array([t]), np.array([until])
        found = rolling.rolls(model, np.array([state]), self._body(k), *times, self._other(k))
        ended = float(found.until[0])

        def states(times: Array) -> Array:
            return np.asarray(found.states(times[None])[0])

        return Numeric(min(t, ended), max(t, ended), "roll", states, _steepest(states, t, ended - t))

    def _fly(self, k: int, state: State, t: float) -> Leg:
        model = self.model
        up, height = state[5], max(state[2] - self.radius[k], 0.0)
        lasts = (up + math.sqrt(up * up + 2 * model.gravity * height)) / model.gravity
        leg = Fly(t, t + lasts, t, state, model.gravity)
        if not self.pushes:
            return leg
        times = np.array([t]), np.array([t + lasts])
        found = rolling.flights(model, np.array([state]), self._body(k), *times, self._other(k))

        def states(at: Array) -> Array:
            out = fly(np.array(state), model.gravity, at - t)
            plane = found.plane(at[None])[:, 0].T
            out[:, 0:2], out[:, 3:5] = plane[:, :2], plane[:, 2:]
            return out

        return Numeric(t, t + lasts, "fly", states, model.gravity + _steepest(states, t, lasts))

    def _rest(self, k: int, state: State, t: float) -> Leg:
        """Rest, until a push that depends on the other ball overcomes what holds the ball."""
        still = _still(state, self.radius[k])
        if not self.pushes:
            return Rest(t, math.inf, still)
        if self._excess(k, still, t) > 0:
            return Rest(t, t, still)
        if self.others[k] is None or self.asleep[k]:
            return Rest(t, math.inf, still)
        return Rest(t, self._loosened(k, still, t), still)

    def _excess(self, k: int, state: State, t: float) -> float:
        """By how much 5/7 of the push on a ball at rest exceeds what holds it, or would were it to roll, m/s^2."""
        if not self.pushes:
            return -self.model.rolling_decel
        instant = self._at_rest(k, state, t)
        push = self.model.laws("push", np.zeros(2), instant)
        size, decel = float(np.hypot(*push)), self.model.rolling_decel
        nudge = rolling.SLOWEST * push / (size or 1.0)
        loss = self.model.laws("rolling", decel, instant | {"velocity": nudge, "speed": rolling.SLOWEST})
        return size * 5 / 7 - max(decel, float(loss))

    def _at_rest(self, k: int, state: State, t: float) -> dict[str, Any]:
        body, other, place = self._body(k), self._other(k), np.array(state[:2])
        instant: dict[str, Any] = dict(position=place, velocity=np.zeros(2), gravity=self.model.gravity)
        instant |= dict(radius=body.radius[0], mass=body.mass[0], of_a=body.of_a[0])
        instant["other"] = sliding.NOWHERE if other is None else other(np.array([[t]]), 0)[0, 0] - place
        return instant

    def _loosened(self, k: int, state: State, t: float) -> float:
        """When a ball at rest starts to roll, or infinity: looked for every ms, then halved."""
        for step in range(math.ceil((max(self.end, t) + AHEAD - t) / 1e-3)):
            a = t + 1e-3 * step
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
        leg, radius = self.legs[k], self.radius[k]
        before = leg.now(leg.t1)
        if leg.motion == "roll" and math.hypot(before[3], before[4]) > 2 * rolling.SLOWEST:
            self._go_on({k: before})
        elif leg.motion == "fly":
            self._go_on({k: self._landed(k, before)})
        elif leg.motion == "rest":
            push = self.model.laws("push", np.zeros(2), self._at_rest(k, before, self.t))
            nudge = 2 * rolling.SLOWEST * push / np.hypot(*push)
            self._happen("start", k, before, _rolling((*before[:3], *nudge.tolist(), *before[5:]), radius))
        elif leg.motion == "slide":
            self._happen("slide_end", k, before, _rolled_out(before, radius))
        else:
            self._happen("stop", k, before, _still(before, radius))

    def _landed(self, k: int, before: State) -> State:
        radius = self.radius[k]
        down = np.array([(*before[:2], radius, *before[3:])])
        up = land(self.model, down, self._body(k))
        after: State = tuple(up[0].tolist())
        slips = [math.hypot(*slip(s, radius)) for s in (before, after)]
        self.events.append(Event(self.t, "land", k, before=down, after=up))
        if slips[0] > STILL and slips[1] <= 1e-9 * slips[0]:
            after = _rolled_out(after, radius)
            self.events.append(Event(self.t, "slide_end", k, before=down, after=np.array([after])))
        return after

    def _happen(self, kind: str, k: int, before: State, after: State) -> None:
        self.events.append(
            Event(self.t, kind, k, before=np.array([before]), after=np.array([after]))  # type: ignore[arg-type]
        )
        self._go_on({k: after})

    def _collide(self, t: float, i: int, j: int) -> None:
        self.t = t
        states = {k: self.legs[k].now(t) for k in (i, j)}
        if math.hypot(*states[i][3:5]) > math.hypot(*states[j][3:5]):
            i, j = j, i  # the slower ball is the target
        bodies = (self.radius[i], self.mass[i]), (self.radius[j], self.mass[j])
        target, striker, n, along_n, along_t = strike(self.model, states[i], states[j], *bodies)
        if along_n < (CLINGING if self.mutual else LINGERING) * self.mass[i]:
            raise ValueError(f"balls {i} and {j} stay in contact from {t:.6g} s on: only separate impacts are modelled")
        new = {k: s if abs(s[5]) >= LOWEST else (*s[:5], 0.0, *s[6:]) for k, s in ((i, target), (j, striker))}
        before: Array = np.array((states[i], states[j]))
        after: Array = np.array((new[i], new[j]))
        self.events.append(Event(t, "contact", i, j, before, after, n[:2], along_n, along_t))
        for k, state in new.items():
            if state[5] < 0 and not _aloft(state, self.radius[k]):
                new[k] = self._landed(k, state)
        self._go_on(new)


def _still(state: State, radius: float) -> State:
    """At rest, but for a spin about the vertical."""
    return state[0], state[1], radius, 0.0, 0.0, 0.0, 0.0, 0.0, state[8]


def _rolling(state: State, radius: float) -> State:
    """Rolling with the state's velocity; a vertical one is kept."""
    x, y, _, vx, vy, vz, _, _, wz = state
    return x, y, radius, vx, vy, vz, -vy / radius, vx / radius, wz


def _rolled_out(state: State, radius: float) -> State:
    """Rolling as when the slip is over, (5 v + 2 R w x z)/7; a flight's vertical velocity is kept."""
    ux, uy = slip(state, radius)
    return _rolling((*state[:3], state[3] - 2 / 7 * ux, state[4] - 2 / 7 * uy, *state[5:]), radius)


def _aloft(state: State, radius: float) -> bool:
    return bool(state[2] > radius * (1 + TOUCHING))


def _touching(launch: Launch) -> bool:
    reach = launch.bodies.radius[:, None] + launch.bodies.radius
    apart = np.linalg.norm(launch.states[:, None, :3] - launch.states[:, :3], axis=-1) - reach
    return bool(np.any(apart[~np.eye(len(apart), dtype=bool)] <= TOUCHING * launch.bodies.radius.min()))


def _steepest(states: Others, t: float, lasts: float) -> float:
    """A bound of the acceleration along a leg: twice the largest found between samples."""
    times = np.linspace(t, t + lasts, 65)
    v = states(times)[:, 3:5]
    return float(2 * np.max(np.linalg.norm(np.diff(v, axis=0), axis=1)) / max(abs(lasts) / 64, 1e-300))
