"""Numerical integration of motion without closed form: many balls, each alone or in pairs that push each other.

A sliding ball is integrated in q = (5 v + 2 R w x z)/7 and the contact velocity u = s (cos th, sin th):

    v = q + (2/7) u,   x' = v,   q' = (5/7) p,   s' = -(7/2) mu N + p . u_hat = -A,   th' = (u_hat x p)/s

with the push p and the load N over the mass; the numbers are those of a solid ball. cos th and sin th replace th.
Towards the end of the slide th' grows as 1/s. The slip of a ball whose slide will end therefore paces the integration
of both balls of a pair. With ln s instead of the time every right-hand side is smooth. The end of the slide is then a
known point instead of an event to search for. If nothing turns the slip, s itself serves. All other motion is
integrated over time. A rolling ball, v' = (5/7) p - loss v_hat, is integrated for at most half the time that would stop
it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np

from synthcam.dynamics.collocation import MAX_HALVINGS, NODE_COUNTS, Parts, integrate_by_collocation, make_matrices
from synthcam.dynamics.forces import (
    END_SLIP_SHARE,
    FLY,
    LAWS,
    NOWHERE,
    ROLL,
    SLIDE,
    STOP_SPEED_M_S,
    TINY,
    ZERO_SPEED_M_S,
    BallStates,
    Forces,
    classify_modes,
    find_ending_slip,
    move_vectors_to_last_axis,
)
from synthcam.dynamics.integrated_motion import IntegratedMotion, Pieces, snap_to_goal
from synthcam.dynamics.kinematics import contact_velocity, flight_time, push_share, rolling_velocity, slip_rate
from synthcam_shared.arrays import Array, Flags, Index

MAX_SPEED_M_S = 1e3  # a ball that would have had to come faster has no past
LOG_SLIP_BREAK = 0.33  # share of the fall of ln(slip) at which two pieces of a slide meet
END_TIMES = 1 - ((1 - make_matrices(10).nodes) / 2) ** 3  # nodes of an even end, in the cube root of the time left
FLOOR_TOLERANCE = 1e-9  # of the slip at which a spin no longer drills


@dataclass(frozen=True)
class IntegrationStep:
    """One step of m balls from time 0."""

    motion: IntegratedMotion
    final_states: Array  # (m, 9)
    durations: Array  # (m,) s
    ended: Flags  # (m,) whether the slide, roll or flight of the ball ended with the step
    valid: Flags  # (m,) whether the step is a solution for the ball

    def __getitem__(self, rows: Index) -> Self:
        return type(self)(*(getattr(self, f.name)[rows] for f in fields(self)))


class PhaseIntegrator:
    """Integrates k units, each in one phase: for `spans` (k,), or until the slide of ball `ender` (k,) has ended."""

    def __init__(self, balls: BallStates, spans: Array, ender: Index) -> None:
        self.balls, self.modes, states, laws = balls, balls.modes, balls.states, balls.model.laws
        inertia = balls.bodies.inertia[:, None]
        self.slip_share, self.push_share = 1 / slip_rate(inertia), push_share(inertia)
        found = {mode: np.flatnonzero(self.modes == mode) for mode in (ROLL, SLIDE, FLY)}
        self.rows: dict[int, Any] = {mode: rows for mode, rows in found.items() if len(rows)}
        if any(len(rows) == len(states) for rows in found.values()):
            self.rows = {mode: slice(None) for mode in self.rows}
        forces = Forces.of(balls.model, balls.bodies)
        self.forces = {mode: forces[rows] for mode, rows in self.rows.items()}
        k = len(balls)
        self.spans = np.tile(spans, balls.each)[:, None]
        self.pacer = np.tile(ender * k + np.arange(k), balls.each)  # the row whose slip paces each ball
        self.ends = (self.pacer == np.arange(len(states)))[:, None]
        self.slides, self.paced = SLIDE in self.rows, bool(np.any(self.ends))
        self.free = self.slides and not self.ends.all()  # some slips do not pace: they are integrated
        self.pushes, self.drills = laws.has_effect_on("push"), laws.has_effect_on("drilling")
        self.straight = self.paced and not (self.free or self.pushes or self.drills)
        constant = {"slip_speed", "slip", "gravity", "radius", "of_a"}  # laws of these keep the direction of the slip
        self.straight &= all(laws.inputs_of(law) <= constant for law in ("friction", "normal_load"))
        self.at = 4 if self.slides else 0  # of q among the components: hat, wz, s; q; x; the time
        u = contact_velocity(states, balls.bodies.radius).T[..., None] * (self.modes == SLIDE)[:, None]
        self.first = np.hypot(u[0], u[1])
        self.hat = u / np.maximum(self.first, TINY)
        floor = balls.floor[:, None]
        drilling = self.first > floor * (1 + FLOOR_TOLERANCE)
        self.spins = np.where(drilling, 1.0, 0.0) if self.drills else 1.0
        self.least = np.where(drilling, floor * (1 - FLOOR_TOLERANCE), 0.0)  # lowest slip while another one paces
        self.cut = np.where(drilling, floor, END_SLIP_SHARE * self.first)
        self.late = bool(np.any(self.ends & drilling))  # slides that continue without drilling; pairs in a new phase
        self.closes = self.paced and not self.straight and not (self.late and balls.each > 1)
        self.log = np.log(np.where(self.ends, self.cut / np.maximum(self.first, TINY), 1.0))
        q = rolling_velocity(states, balls.bodies.radius, balls.bodies.inertia) if self.slides else states[:, 3:5]
        q = np.where((self.modes == SLIDE)[:, None], q, states[:, 3:5])
        start = [*q.T[..., None], *states[:, :2].T[..., None]]
        if self.slides:
            start = [*self.hat, states[:, 8:], self.first, *start]
        self.start = np.stack([*start, 0 * self.first] if self.paced else start)  # (c, m, 1)

    def count_feedback_parts(self) -> int | None:
        """Count the groups of `right_hand_side` on which it depends itself; None: on all."""
        laws = self.balls.model.laws
        asked = set().union(*(laws.inputs_of(law) for law in (*LAWS[SLIDE], "rolling")))
        if self.balls.each > 1 or "position" in asked:
            return None
        own = self.pushes + self.drills + self.free  # direction, spin and size of the slip, as `right_hand_side` yields
        return max(own + (self.pushes and "velocity" in asked), 1) if self.slides else 1

    def slip_speed(self, z: Any, y: Array) -> tuple[Any, Any]:
        """Return slip speeds (m, n), and how fast they fall along z where a slip paces."""
        if not self.paced:
            return (y[3], 0.0) if self.slides else (0.0, 0.0)
        if self.straight:
            return self.first * (1 - z), self.first
        log, slip = self.log, self.first
        if late := bool(np.mean(z) > 1):  # the remaining slip, without drilling
            log, slip = np.where(self.ends, np.log(END_SLIP_SHARE), 0.0), self.cut
        slip = slip * np.exp(log * (z - late))
        return np.where(self.ends, slip, y[3]) if self.free else slip, -log * slip

    def evaluate_forces(self, slip: Any, y: Array, late: bool = False) -> tuple[Any, ...]:
        """Evaluate dq/dt, A, u_hat x p and dwz/dt; late: in the rest of slides, which no longer drill."""
        at, rows = self.at, self.rows
        q, place, shape = y[at : at + 2], y[at + 2 : at + 4], y[at].shape
        v = q + self.slip_share * slip * y[:2] if self.slides else q
        other = move_vectors_to_last_axis(place[:, self.balls.partner] - place) if self.balls.each > 1 else NOWHERE
        spins = np.where(self.ends, 0.0, self.spins) if late and self.drills else self.spins

        def known(mode: int) -> tuple[Any, ...]:
            own = rows[mode]
            return place[:, own], v[:, own], other if self.balls.each == 1 else other[own]

        found: dict[int, Array] = {}
        slowing: Any = 0.0
        across: Any = 0.0
        twist: Any = 0.0
        if FLY in rows:
            found[FLY] = self.forces[FLY].push(*known(FLY))
        if ROLL in rows:
            found[ROLL] = self.forces[ROLL].accelerate_rolling(*known(ROLL))
        if self.slides:
            own = rows[SLIDE]
            state = slip[own], y[:2, own], (y[2] * spins)[own], *known(SLIDE)
            slowing, across, push, twist = self.forces[SLIDE].act_on_sliding(*state)
            found[SLIDE] = self.push_share[own] * push
            if len(found) > 1 or not isinstance(own, slice):
                slowing, across, twist = (_scatter(f, own, shape) for f in (slowing, across, twist))
        if len(rows) == 1 and isinstance(next(iter(rows.values())), slice):
            return next(iter(found.values())), slowing, across, twist
        dq = np.zeros((2, *shape))
        for mode, own in rows.items():
            dq[:, own] = found[mode]
        return dq, slowing, across, twist

    def time_rate(self, fall: Any, slowing: Any) -> Any:
        """Return dt/dz. Raises ValueError where friction does not end a slide."""
        if not self.paced:
            return self.spans
        if not np.all(slowing[self.ends[:, 0]] > 0):
            raise ValueError("sliding friction does not end the slide: the push along the slip is too strong")
        return (fall / np.where(self.ends, slowing, 1.0))[self.pacer] if self.free else fall / slowing

    def right_hand_side(self, z: Array, y: Array) -> Parts:
        slip, fall = self.slip_speed(z, y)
        dq, slowing, across, twist = self.evaluate_forces(slip, y, bool(np.mean(z) > 1))
        rate, at = self.time_rate(fall, slowing), self.at
        if self.slides and self.pushes:
            turn = across / np.maximum(slip, TINY) * rate
            yield slice(0, 2), np.stack([-turn * y[1], turn * y[0]])
        if self.slides and self.drills:
            yield slice(2, 3), (twist * rate)[None]
        if self.free:
            yield slice(3, 4), (-slowing * rate)[None]
        if self.pushes or not self.slides:
            yield slice(at, at + 2), dq * rate
        v = y[at : at + 2] + self.slip_share * slip * y[:2] if self.slides else y[at : at + 2]
        yield slice(at + 2, at + 4), v * rate
        if self.paced:
            yield slice(at + 4, at + 5), rate[None]

    def make_guess(self) -> Callable[[Array], Array]:
        """Return a first guess of the solution: all forces stay as they are at the start."""
        at, first, start = self.at, self.first, self.start
        dq, slowing, across, twist = self.evaluate_forces(first, start)
        self.time_rate(first, slowing)

        def guess(z: Array) -> Array:
            y = np.repeat(start, len(z), axis=-1)
            t, left = self.spans * z, 0.0
            if self.paced:
                slip, _ = self.slip_speed(z, y)
                y[-1] = t = ((first - slip) / np.where(self.ends, slowing, 1.0))[self.pacer]
            if self.slides:
                left = np.maximum(first - slowing * t, 0.0)
                share = np.maximum(left, 1e-3 * self.cut) / np.maximum(first, TINY)
                half = across / np.where(slowing > 0, slowing, 1.0) / -2 * np.log(np.where(first > 0, share, 1.0))
                cos, sin = (1 - half * half) / (1 + half * half), 2 * half / (1 + half * half)
                y[0], y[1] = y[0] * cos - y[1] * sin, y[1] * cos + y[0] * sin
                y[2], y[3] = y[2] + twist * t, left
            slipping = (first + left) / 2 * self.slip_share * self.hat
            y[at + 2 : at + 4] += (start[at : at + 2] + dq / 2 * t + slipping) * t
            y[at : at + 2] += dq * t
            return y

        return guess

    def run(self) -> IntegrationStep:
        """Integrate the phase. Raises ValueError when a slide does not end, and where a law is not smooth."""
        first_nodes = 28  # of a piece in ln(slip)
        knots: tuple[float, ...] = (0.0, 1.0)
        if self.paced and not self.straight:
            knots = (0.0, LOG_SLIP_BREAK, 1.0, 2.0)[: 4 if self.late and self.closes else 3]
        few = first_nodes if len(knots) > 2 else NODE_COUNTS[0]
        guess, feed, pieces = self.make_guess(), self.count_feedback_parts(), list[tuple[Array, Array]]()
        sound = np.ones(len(self.modes), dtype=bool)
        start = self.start[..., 0]
        for z, y in integrate_by_collocation(self.right_hand_side, knots, start, guess, few=few, feed=feed):
            slip, _ = self.slip_speed(z, y)
            if self.free:
                sound &= (self.modes != SLIDE) | self.ends[:, 0] | (y[3] > self.least).all(axis=1)
            at, slid = self.at, [slip * y[:2], y[2:3]] if self.slides else []
            parts = np.concatenate([y[at + 2 : at + 4], y[at : at + 2], *slid])
            pieces.append((y[-1] if self.paced else self.spans * z, parts))
        if self.closes:
            pieces.append(self._finish_evenly(y[..., -1:], slip[:, -1:], self.ends))
        lasts = pieces[-1][0][:, -1] if self.paced else self.spans[:, 0]
        falls = np.full(len(self.modes), np.inf)
        if FLY in self.rows:
            balls = self.balls
            times = flight_time(balls.states, balls.bodies.radius, balls.model.gravity)
            falls = np.where(self.modes == FLY, times, np.inf)
        over = (lasts == falls) | (self.ends[:, 0] if self.closes or self.straight else False)
        return self._make_step(pieces, lasts, over, sound & (lasts <= falls))

    def stop_evenly(self) -> IntegrationStep:
        """Make the step in which a ball, of one or of two, rolls so slowly that it stops at an even rate."""
        slow = self.balls.slow
        piece = self._finish_evenly(self.start, self.first, slow[:, None])
        return self._make_step([piece], piece[0][:, -1], slow, np.ones(len(slow), dtype=bool))

    def _finish_evenly(self, y: Array, slip: Array, ends: Flags) -> tuple[Array, Array]:
        """End the rest of a slip or of a roll at an even rate, with all other forces constant, from y (c, m, 1).

        Returns times and the components of the motion there.
        """
        at, balls, slides = self.at, self.balls, (self.modes == SLIDE)[:, None]
        dq, slowing, across, twist = self.evaluate_forces(np.where(ends & slides, slip / 2, slip), y, True)
        q, dq = y[at : at + 2], dq + np.zeros((2, *slip.shape))
        left = np.where(slides, slip, np.hypot(q[0], q[1]))
        late = left / np.maximum(np.where(slides, slowing, np.hypot(dq[0], dq[1])), TINY)
        both = np.tile(balls.min_of_unit(np.where(ends, late, np.inf)[:, 0]), balls.each)[:, None]
        ends = ends & (late <= both)
        dq = np.where(ends & ~slides, -q / np.maximum(both, TINY), dq)
        t = both * (END_TIMES if self.paced else (1 + make_matrices(3).nodes) / 2)
        v, dv, kept = q, dq, [q + dq * t]
        if self.slides:
            u = slip * y[:2]
            du = across * np.stack([-y[1], y[0]]) - slowing * y[:2]
            du = np.where(ends & slides, -u / np.maximum(both, TINY), du)
            v, dv = v + self.slip_share * u, dv + self.slip_share * du
            kept += [u + du * t, y[2:3] + twist * t]
        kept.insert(0, y[at + 2 : at + 4] + (v + dv / 2 * t) * t)
        return (y[-1] if self.paced else 0.0) + t, np.concatenate(kept)

    def _make_step(self, pieces: Pieces, lasts: Array, over: Flags, sound: Flags) -> IntegrationStep:
        balls, flies = self.balls, self.modes == FLY
        power = 0 if not self.paced else 3 if self.closes else 1
        radius, gravity = balls.bodies.radius, balls.model.gravity
        motion = IntegratedMotion(0 * lasts, lasts, balls.states, balls.bodies, gravity, pieces, power, flies)
        last = motion.final_states()
        last[over & flies, 2] = radius[over & flies]
        return IntegrationStep(motion, last, lasts, over, sound)


def _scatter(values: Any, rows: Any, shape: tuple[int, ...]) -> Array:
    out = np.zeros(shape)
    out[rows] = values
    return out


Steps = Iterator[tuple[Index, IntegrationStep]]


def propagate(balls: BallStates, goal: Array) -> Steps:
    """Integrate the next step of k units, balls or pairs, towards `goal`, s from now (k,), which may be negative.

    A slide of a lone ball that lasts far beyond the goal is followed over time, and only until then. A step ends at the
    latest with the first slide, roll or flight of a unit that ends. Yields the numbers of the units that make a step,
    and the step of their balls.
    """
    k = len(balls)
    spans, ender, drills = np.zeros(k), np.zeros(k, dtype=np.intp), np.zeros(k, bool)
    stops = balls.any_of_unit(balls.slow)
    if balls.each > 1 or not np.all(balls.modes == SLIDE) or not np.all(goal == np.inf):
        spans, ender, drills = _plan_steps(balls, goal)
    for some in (stops, ~stops & (ender >= 0) & drills, ~stops & (ender >= 0) & ~drills, ~stops & (ender < 0)):
        if some.any():
            yield from _propagate_units(balls, np.flatnonzero(some), spans, ender, bool(np.any(stops & some)))


def _plan_steps(balls: BallStates, goal: Array) -> tuple[Array, Index, Flags]:
    """Return how long the next steps may be, (k,); which ball's slide ends each, or -1; and whether it drills."""
    max_growth = 3.0  # of the distance of two balls within a step
    far_beyond = 1.5  # the goal; a push may end a slide earlier than it seems at first
    phase = PhaseIntegrator(balls, goal, np.full(len(balls), -1))
    dq, slowing, *_ = phase.evaluate_forces(phase.first, phase.start)
    dq = dq + np.zeros((2, *phase.first.shape))
    v, modes, first = balls.states[:, 3:5].T, balls.modes, phase.first[:, 0]
    half = np.hypot(v[0], v[1]) / np.maximum(2 * np.hypot(dq[0], dq[1])[:, 0], TINY)
    falls = flight_time(balls.states, balls.bodies.radius, balls.model.gravity)
    half = balls.min_of_unit(np.where(modes == ROLL, half, np.where(modes == FLY, falls, np.inf)))
    drills = first > balls.floor * (1 + FLOOR_TOLERANCE)
    left = first - np.where(drills, balls.floor, 0.0)
    lasts = np.where(modes == SLIDE, left / np.maximum((slowing + 0 * phase.first)[:, 0], TINY), np.inf)
    lasts = np.where(np.tile(goal < 0, balls.each), np.inf, lasts)  # back in time a slip only grows
    ender, ends = np.argmin(lasts.reshape(balls.each, -1), axis=0), balls.min_of_unit(lasts)
    limit = np.minimum(half, np.abs(goal))
    if balls.each > 1:  # the balls must not pass through each other
        apart = np.diff(balls.states[:, :5].reshape(2, -1, 5), axis=0)[0]
        far, speed = np.hypot(apart[:, 0], apart[:, 1]), np.hypot(apart[:, 3], apart[:, 4])
        close = 0.85 * balls.bodies.radius.reshape(2, -1).sum(axis=0) / far
        nears = (apart[:, 0] * apart[:, 3] + apart[:, 1] * apart[:, 4]) * goal < 0
        share = np.where(nears, np.maximum(1 - close, 0.15), max_growth)
        limit = np.minimum(limit, share * far / np.maximum(speed, TINY))
    spans = np.where(ends > 1.25 * limit, limit, np.minimum(ends, limit) / 2)
    until_goal = np.where(np.isfinite(goal), np.abs(goal), 0.0)
    spans = np.where((balls.each == 1) & (modes[: len(balls)] == SLIDE), until_goal, spans)
    drills = drills.reshape(balls.each, -1)[ender, np.arange(len(balls))]
    ends_slide = (ends < 0.8 * half) & ((balls.each > 1) | (ends < far_beyond * np.abs(goal)))
    return np.copysign(spans, goal), np.where(ends_slide, ender, -1), drills


def _propagate_units(
    balls: BallStates, units: Index, spans: Array, ender: Index, stops: bool, depth: int = MAX_HALVINGS
) -> Steps:
    """Integrate a step of these units; those without a solution are integrated again for half the time.

    A lone slide that friction does not end has a motion if it lasts until a goal. spans: 0 where it has no goal.
    """
    some = balls[units]
    phase, good = PhaseIntegrator(some, spans[units], ender[units]), np.zeros(len(units), dtype=bool)
    try:
        step = phase.stop_evenly() if stops else phase.run()
        good = ~some.any_of_unit(~step.valid)
    except ValueError:
        ends_alone = balls.each == 1 and phase.slides and phase.paced
        if depth == 0 or (ends_alone and not spans[units].any()):
            raise
        if len(units) > 1 and (balls.each > 1 or ends_alone):
            for half in np.array_split(units, 2):
                yield from _propagate_units(balls, half, spans, ender, stops, depth)
            return
        if ends_alone:
            yield from _propagate_units(balls, units, spans, np.full_like(ender, -1), stops, 0)
            return
    if depth == 0 and not good.all():
        raise ValueError(_describe_failure(some[np.flatnonzero(~good)], float(abs(spans[units[~good][0]]))))
    if good.any():
        yield units[good], step if good.all() else step[some.rows(np.flatnonzero(good))]
    if not good.all():
        yield from _propagate_units(balls, units[~good], spans / 2, np.full_like(ender, -1), False, depth - 1)


def _describe_failure(balls: BallStates, span: float) -> str:
    """Describe why the first of these units has no step of `span`, s."""
    if balls.each > 1:
        return f"two balls that push each other could not be followed for {span:.3g} s: one changes its motion sooner"
    if balls.modes[0] == SLIDE:
        return f"a slide could not be followed for {span:.3g} s until its goal: it ends sooner, but not by friction"
    return f"a {'flight' if balls.modes[0] == FLY else 'roll'} could not be followed for {span:.3g} s: it ends sooner"


def propagate_back(balls: BallStates, now: Array, until: Array) -> Iterator[tuple[Index, IntegratedMotion]]:
    """Integrate backwards units whose balls roll, slide or rest at `now` (k,), until `until` (k,), s.

    A ball that slides now has slid all the time. Yields units and their motions. Raises ValueError where a ball would
    have started from rest, or come faster than MAX_SPEED_M_S.
    """
    states, now, floor = balls.states.copy(), now.copy(), np.full(len(balls.states), np.inf)
    if balls.model.laws.has_effect_on("drilling"):
        floor = np.where(balls.modes == SLIDE, find_ending_slip(balls.model, states, balls.bodies), np.inf)
    for _ in range(1000):  # steps; a past of more does not end
        speed = np.hypot(states[:, 3], states[:, 4])
        left = np.flatnonzero((now > until) & balls.any_of_unit(speed > ZERO_SPEED_M_S))
        if len(left) == 0:
            return
        slow = (speed > ZERO_SPEED_M_S) & (speed <= STOP_SPEED_M_S)
        if np.any(slow & (classify_modes(states, balls.bodies.radius) == ROLL)):
            raise ValueError(f"a ball has no past before {now[left].max():g} s: it would have had to come from rest")
        if not np.all(speed < MAX_SPEED_M_S):
            break
        some = BallStates(balls.model, balls.bodies, states, floor, balls.each)[left]
        for units, step in propagate(some, (until - now)[left]):
            mine = left[units]
            yield mine, step.motion.shift(np.tile(now[mine], balls.each))
            states[balls.rows(mine)] = step.final_states
            now[mine] = snap_to_goal(now[mine] + step.durations[: len(mine)], until[mine])
    raise ValueError(f"the past of a ball does not end: it would have had to come faster than {MAX_SPEED_M_S:g} m/s")
