"""Two balls of one run that push each other: their past before the launch and their next legs, solved together."""

import math
from collections.abc import Iterable

import numpy as np

from synthcam.dynamics.forces import (
    FLY,
    REST,
    ROLL,
    SLIDE,
    STOP_SPEED_M_S,
    BallStates,
    classify_modes,
    find_ending_slip,
)
from synthcam.dynamics.integrated_motion import IntegratedMotion
from synthcam.dynamics.kinematics import State, to_rest, to_rolling
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.propagate import propagate, propagate_back
from synthcam.dynamics.start_from_rest import (
    PUSHED_AWAY,
    START_NODE_COUNTS,
    UNKNOWN_PAST,
    excess_push,
    push_at_rest,
    solve_approach,
    solve_start,
)
from synthcam.dynamics.trajectory import Event, Leg, Motion, NumericLeg, RestLeg
from synthcam.model import Bodies, Model
from synthcam_shared.arrays import Array, Flags, Index

LEAD_TIME_S = 0.2  # of motion beyond the end that was asked for
SAMPLES_PER_STEP = 33  # within a step, at which a ball at rest is checked for the push that starts it
NAMES: dict[int, Motion] = {REST: "rest", ROLL: "roll", SLIDE: "slide", FLY: "fly"}
CANNOT_REST = "a ball cannot rest before its launch: 5/7 of the push on it exceeds rolling_decel"


def make_leg(motion: IntegratedMotion, ball: int, mode: int, now: float) -> Leg:
    """Make a leg of one ball of an interacting pair, forwards or backwards from the time `now`."""
    own = motion[np.array([ball])].shift(np.array([now]))
    ends = sorted((now + float(motion.begins[ball]), now + float(motion.begins[ball] + motion.durations[ball])))
    if mode == REST:
        still = to_rest(tuple(motion.states[ball].tolist()), float(motion.bodies.radius[ball]))
        return RestLeg(ends[0], ends[1], still)
    lift = motion.gravity if mode == FLY else 0.0
    return NumericLeg.of(ends[0], ends[1], NAMES[mode], lambda times: own.at(times[None])[0], lift)


class InteractingPair:
    """Solves both balls together from `start` to `end`, s, or beyond; states are nine floats."""

    def __init__(self, model: Model, bodies: Bodies, start: float, end: float) -> None:
        self.model, self.bodies, self.start, self.end = model, bodies, start, end
        self.floor = np.full(2, np.inf)

    def solve_past(self, launch: Launch) -> tuple[dict[int, State], list[list[Leg]], list[Event]]:
        """Solve the motion before the launch.

        Returns the states at the launch, the legs from the start to it, and the event at which a ball started from
        rest. A target at rest that touches the striker has been pulled by it: its velocity follows.
        """
        rows, order, now = launch.states.copy(), np.arange(2), np.array([launch.time])
        modes, past, events = classify_modes(rows, self.bodies.radius), [list[Leg](), list[Leg]()], list[Event]()
        lasted, onset = np.maximum(now - self.start, 0.0), np.zeros(1)
        if launch.touches and sorted(modes) == [REST, ROLL] and _separation_rate(rows) < 0:
            order = np.argsort(modes)
            rows[order], pieces, onset = solve_approach(self.model, self.bodies[order], rows[order], lasted)
            if _separation_rate(rows) >= 0:
                raise ValueError(PUSHED_AWAY)
        else:
            pieces = self._propagate_back(rows, modes, lasted)
        for _, motion in pieces:
            halfway = motion.at((motion.begins + motion.durations / 2)[:, None])[:, 0]
            moved = classify_modes(halfway, motion.bodies.radius)
            for ball, k in enumerate(order):
                leg = make_leg(motion, ball, moved[ball], launch.time)
                begins = max(leg.t0, self.start)
                if begins < leg.t1:
                    leg.t0 = begins
                    past[k].insert(0, leg)
        if onset[0] < 0 and self.start < launch.time + onset[0]:
            still, other = (leg.now(launch.time + onset[0]) for leg in (past[k][-1] for k in order))
            when = launch.time + float(onset[0])
            events = [make_start_event(self.model, self.bodies[order[:1]], int(order[0]), still, when, np.array(other))]
        return {k: tuple(rows[k].tolist()) for k in (0, 1)}, past, events

    def _propagate_back(self, rows: Array, modes: Index, lasted: Array) -> list[tuple[Index, IntegratedMotion]]:
        """Integrate balls that roll or rest back to the start."""
        if lasted[0] == 0:
            return []
        if np.any(modes > ROLL):
            raise ValueError(UNKNOWN_PAST)
        balls = BallStates.without_drilling(self.model, self.bodies, rows, 2)
        pieces = list(propagate_back(balls, np.zeros(1), -lasted))
        for _, motion in pieces:
            states = motion.at(motion.begins[:, None] + motion.durations[:, None] * np.linspace(0, 1, SAMPLES_PER_STEP))
            for k in (k for k in (0, 1) if modes[k] == REST):
                if np.any(self._excess(k, rows[k], states[1 - k]) > 0):
                    raise ValueError(CANNOT_REST)
        if not pieces and any(self._excess(k, rows[k], rows[1 - k, None])[0] > 0 for k in (0, 1)):
            raise ValueError(CANNOT_REST)
        return pieces

    def next_legs(
        self, states: dict[int, State], t: float, restarted: Iterable[int]
    ) -> tuple[list[Leg], float, list[Event]]:
        """Return the legs from t on, the time to which both are known, and the events of balls that start to roll.

        restarted: balls with an event at t. The others continue, in a slide that began earlier.
        """
        rows, started = np.array([states[0], states[1]]), []
        for k in restarted if self.model.laws.has_effect_on("drilling") else ():
            other = (rows[1 - k] - rows[k])[None, None, :2]
            self.floor[k] = find_ending_slip(self.model, rows[k : k + 1], self.bodies[k : k + 1], other)[0]
        modes = classify_modes(rows, self.bodies.radius)
        loose = [k for k in (0, 1) if modes[k] == REST and self._excess(k, rows[k], rows[1 - k, None])[0] > 0]
        for k in loose:
            started.append(make_start_event(self.model, self.bodies[k : k + 1], k, states[k], t, rows[1 - k]))
        if np.all(modes == REST) and not loose:
            still = (to_rest(states[k], float(self.bodies.radius[k])) for k in (0, 1))
            return [RestLeg(t, math.inf, state) for state in still], math.inf, []
        goal = np.array([max(self.end - t, 0.0) + LEAD_TIME_S])
        motion, over = self._propagate(rows, modes, loose, goal)
        until = t + float(motion.durations[0])
        legs = [make_leg(motion, k, ROLL if k in loose else modes[k], t) for k in (0, 1)]
        for k in (0, 1):
            if modes[k] == REST and k not in loose:
                legs[k].t1 = self._find_start_time(k, rows[k], legs[1 - k], t, until)
            elif not over[k]:
                legs[k].t1 = math.inf
        return legs, until, started

    def _propagate(self, rows: Array, modes: Index, loose: list[int], goal: Array) -> tuple[IntegratedMotion, Flags]:
        if len(loose) == 1 and modes[1 - loose[0]] == ROLL:
            order = np.array([loose[0], 1 - loose[0]])
            far = np.hypot(*(rows[1] - rows[0])[:2]) - self.bodies.radius.sum() * (_separation_rate(rows) < 0)
            lasts, known = np.minimum(goal, 0.3 * far / np.hypot(*rows[order[1], 3:5])), np.zeros(1, dtype=bool)
            for _ in range(40):
                for size in START_NODE_COUNTS:
                    motion, good = solve_start(self.model, self.bodies[order], rows[order], lasts, 0, known, size)
                    if good[0]:
                        return motion[order], np.zeros(2, dtype=bool)
                lasts = lasts / 2
        for k in loose:  # the other ball does not roll: a small speed is enough
            rows[k] = give_small_speed(self.model, self.bodies[k : k + 1], rows[k], rows[1 - k])
        ((_, step),) = propagate(BallStates(self.model, self.bodies, rows, self.floor, 2), goal)
        return step.motion, step.ended

    def _excess(self, k: int, row: Array, others: Array) -> Array:
        """Return by how much the push on ball k exceeds what holds it, with the other in states (n, 9)."""
        return np.asarray(excess_push(self.model, self.bodies[k : k + 1], row[None], others[:, :2].T[:, None])[0])

    def _find_start_time(self, k: int, row: Array, other: Leg, t: float, until: float) -> float:
        """Find when a ball at rest starts to roll, by bisection; infinity where it does not."""
        times = np.linspace(t, until, SAMPLES_PER_STEP)
        late = np.flatnonzero(self._excess(k, row, other.at(times)) > 0)
        if len(late) == 0:
            return math.inf
        low, high = times[max(late[0] - 1, 0)], times[late[0]]
        while high - low > 1e-12 and low < (middle := (low + high) / 2) < high:  # late times have few digits
            loose = self._excess(k, row, other.at(np.array([middle])))[0] > 0
            low, high = (low, middle) if loose else (middle, high)
        return float(high)


def _separation_rate(states: Array) -> float:
    """Return the rate at which balls in states (2, 9) separate, times their distance, m^2/s."""
    apart = states[0] - states[1]
    return float(apart[:3] @ apart[3:6])


def make_start_event(model: Model, body: Bodies, k: int, state: State, t: float, other: Array) -> Event:
    """Make the event at which ball k of an interacting pair starts from rest; the other is at `other` (2 or more,)."""
    still = to_rest(state, float(body.radius[0]))
    return Event(t, "start", k, before=np.array([still]), after=np.array([give_small_speed(model, body, still, other)]))


def give_small_speed(model: Model, body: Bodies, still: State | Array, other: Array) -> State:
    """Give a ball of an interacting pair that rests a small speed along the push on it."""
    push = push_at_rest(model, body, np.array([still]), other[:2, None, None])[:, 0, 0]
    velocity = 2 * STOP_SPEED_M_S * push / np.hypot(*push)
    return to_rolling((*still[:3], *velocity.tolist(), *still[5:]), still[2])
