"""The two balls of one run that push each other: what led to their launch, and their next legs, both together."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from synthcam.dynamics.coupled import Modes, Piece, approach, excess, floor_of, mode_of, opening, push_at_rest, step
from synthcam.dynamics.kinematics import Array, State, made_rolling, resting
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.rolling import SLOWEST
from synthcam.dynamics.trajectory import Event, Leg, Rest
from synthcam.model import Bodies, Model

FASTEST = 1e3  # m/s: a ball that must have come faster did not come
AHEAD = 0.2  # s of motion beyond what was asked for
LOOKS = 33  # within a piece at whether a ball at rest is pulled off
NEVER = (
    "no approach was found to such a contact: for a push so strong the ball that comes, at {:.4g} m/s, is too slow, "
    "or the one at rest is held again on its way"
)
HELD = "a ball cannot rest before its launch: 5/7 of the push on it exceeds rolling_decel"


class Pairing:
    """From `start` to `end`, s, or beyond; states are nine floats."""

    def __init__(self, model: Model, bodies: Bodies, start: float, end: float) -> None:
        self.model, self.start, self.end = model, start, end
        self.bodies, self.floor = (bodies[:1], bodies[1:]), [math.inf, math.inf]

    def before(self, launch: Launch) -> tuple[dict[int, State], list[list[Leg]], list[Event]]:
        """The states at the launch, the legs that led there from the start, and when a ball was pulled from its rest.

        Of two balls that touch, one that rests has been pulled by the one that comes: its velocity is what follows.
        """
        rows, order = launch.states[:, None].copy(), [0, 1]
        modes = self._modes(rows)
        if launch.touches and sorted(modes) == ["rest", "roll"] and opening(rows) < 0:
            order = [modes.index("rest"), modes.index("roll")]
            pair = self.bodies[order[0]], self.bodies[order[1]]
            found = approach(self.model, pair, rows[order], launch.time, self.start)
            if found is None:
                raise ValueError(NEVER.format(np.hypot(*rows[order[1], 0, 3:5])))
            rows[order], pieces = found
            if opening(rows) >= 0:
                raise ValueError("the ball at rest would be pushed away faster than the other comes")
        else:
            pieces = self._back(rows, modes, launch.time)
        past: list[list[Leg]] = [[], []]
        events = []
        for piece in pieces:
            for k, leg in zip(order, piece.legs, strict=True):
                begins = max(leg.t0, self.start)
                if begins < leg.t1:
                    past[k].insert(0, leg.spanning(begins, leg.t1))
            if self.start < piece.then and {leg.motion for leg in piece.legs} == {"roll"} and "rest" in modes:
                (still, other), k = piece.last[:, 0], order[0]
                events.append(start_of(self.model, self.bodies[k], k, tuple(still.tolist()), piece.then, other))
        return {k: tuple(rows[k, 0].tolist()) for k in (0, 1)}, past, events

    def _back(self, rows: Array, modes: Modes, now: float) -> list[Piece]:
        """Balls that roll or rest, led back to the start."""
        still = [k for k in (0, 1) if modes[k] == "rest"]
        if self.start < now and not set(modes) <= {"rest", "roll"}:
            raise ValueError("a ball that slides or flies at its launch has no past: start the run at the launch")
        if self.start < now and any(self._pulls(k, rows[k], rows[1 - k, :, :2].T[..., None]) for k in still):
            raise ValueError(HELD)
        pieces: list[Piece] = []
        while now > self.start and modes != ("rest", "rest"):
            piece = step(self.model, self.bodies, modes, rows, self.floor, now, self.start)
            if piece is None:
                raise ValueError(f"a ball has no past before {now:g} s: it would have had to come from rest")
            if any(self._pulls(k, rows[k], piece.places[1 - k][:, None]) for k in still):
                raise ValueError(HELD)
            pieces.append(piece)
            rows, now = piece.last, piece.then
            if not np.abs(rows[..., 3:5]).max() <= FASTEST:
                raise ValueError(f"a ball would have had to come faster than {FASTEST:g} m/s")
        return pieces

    def legs(self, states: dict[int, State], t: float, anew: Iterable[int]) -> tuple[list[Leg], float, list[Event]]:
        """Legs from t on, and how far both are known: none leads beyond that. And which balls just begin to roll.

        anew: balls to which something happened at t. The others go on, in a slide that began earlier.
        """
        rows = np.array([[states[k]] for k in (0, 1)])
        for k in anew:
            self.floor[k] = floor_of(self.model, self.bodies, rows, k)
        modes, started = list(self._modes(rows)), []
        for k in (0, 1):
            if modes[k] == "rest" and self._pulls(k, rows[k], rows[1 - k, :, :2].T[..., None]):
                modes[k] = "creep"
                started.append(start_of(self.model, self.bodies[k], k, states[k], t, rows[1 - k, 0]))
        still = [resting(states[k], float(self.bodies[k].radius[0])) for k in (0, 1)]
        if modes == ["rest", "rest"]:
            return [Rest(t, math.inf, state) for state in still], math.inf, []
        goal = max(self.end, t) + AHEAD
        piece = step(self.model, self.bodies, (modes[0], modes[1]), rows, self.floor, t, goal)
        if piece is None:
            raise ValueError(f"balls that push each other could not be followed from {t:.9g} s on")
        legs, until = list(piece.legs), piece.then
        for k in (0, 1):
            if modes[k] == "rest":
                legs[k] = Rest(t, self._loosened(k, rows[k], legs[1 - k], t, until), still[k])
            elif not piece.over[k]:
                legs[k] = legs[k].spanning(t, math.inf)
            elif modes[k] == "drill":
                legs[k], self.floor[k] = legs[k].spanning(t, math.inf), math.inf
        return legs, until, started

    def _modes(self, rows: Array) -> Modes:
        one, two = (mode_of(rows[k], self.bodies[k].radius, self.floor[k]) for k in (0, 1))
        return one, two

    def _pulls(self, k: int, row: Array, other: Array) -> bool:
        """Does the push overcome what holds ball k, with the other at any of (2, 1, n)?"""
        return bool(np.any(excess(self.model, self.bodies[k], row, other) > 0))

    def _loosened(self, k: int, row: Array, other: Leg, t: float, until: float) -> float:
        """When a ball at rest starts to roll, or infinity."""
        times = np.linspace(t, until, LOOKS)
        places = other.at(times)[:, :2].T[:, None]
        late = np.flatnonzero(excess(self.model, self.bodies[k], row, places)[0] > 0)
        if len(late) == 0:
            return math.inf
        low, high = times[max(late[0] - 1, 0)], times[late[0]]
        while high - low > 1e-12 and low < (middle := (low + high) / 2) < high:  # late clocks are coarse
            loose = self._pulls(k, row, other.at(np.array([middle]))[:, :2].T[..., None])
            low, high = (low, middle) if loose else (middle, high)
        return float(high)


def start_of(model: Model, body: Bodies, k: int, state: State, t: float, other: Array) -> Event:
    """Ball k at rest begins to roll, the other being at `other` (2 or more,): afterwards with a little speed."""
    still = resting(state, float(body.radius[0]))
    push = push_at_rest(model, body, np.array([still]), other[:2, None, None])[0, 0]
    nudge = 2 * SLOWEST * push / np.hypot(*push)
    after = made_rolling((*still[:3], *nudge.tolist(), *still[5:]), still[2])
    return Event(t, "start", k, before=np.array([still]), after=np.array([after]))
