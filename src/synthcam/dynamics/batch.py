"""Thousands of two-ball collisions at once: the motion of `dynamics.solve`, vectorised over collisions.

A collision is one impact of a striker on a ball at rest, followed by flights, slides and rolls. If two balls would
touch again, or a ball that stopped starts again, `solve` takes over that collision. With |b| > 1 the striker meets
nothing: its motion is free from the time of its launch on, and straight on before it.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from synthcam.dynamics import kinematics
from synthcam.dynamics.contacts.contact_time import STAYING
from synthcam.dynamics.contacts.impact import collide_pairs, land_on_plate
from synthcam.dynamics.forces import (
    FLY,
    LAWS,
    MOTION_PARAMETERS,
    REST,
    ROLL,
    SLIDE,
    ZERO_SPEED_M_S,
    BallStates,
    classify_modes,
    find_ending_slip,
)
from synthcam.dynamics.integrated_motion import snap_to_goal
from synthcam.dynamics.kinematics import contact_velocity, rolling_state, rolling_velocity
from synthcam.dynamics.launch import NO_SPIN, Launch, launch_touching_pairs
from synthcam.dynamics.propagate import IntegrationStep, propagate, propagate_back
from synthcam.dynamics.segments import (
    FlightSegment,
    IntegratedSegment,
    PackedRows,
    RestSegment,
    RollSegment,
    Segment,
    SlideSegment,
    TrajectorySegment,
    drop_balls,
    split_segment,
    write_states,
)
from synthcam.dynamics.solve import solve
from synthcam.dynamics.start_from_rest import (
    MIN_IMPACT_SPEED_OF_PAIR_M_S,
    PUSHED_AWAY,
    UNKNOWN_PAST,
    excess_push,
    solve_approach,
)
from synthcam.model import Bodies, Model
from synthcam_shared.arrays import Array, Flags, Index

# position of the contact, m; its time, s; speed, m/s, and heading, rad, of the striker; b over the sum of the radii
LAUNCH_COLUMNS = ("x", "y", "t_c", "v0", "heading", "b")
IMPACT_PARAMETERS = ("restitution", "spin_transfer")  # of the base model
VARIABLE_BASE_PARAMETERS = IMPACT_PARAMETERS + MOTION_PARAMETERS  # may differ between collisions of one batch
MAX_GROUP = 400  # balls that are integrated or evaluated together: more leave the processor's cache


@dataclass
class CollisionBatch:
    """The motion of n collisions from `start` to `end`, s. Balls 0..n-1 are the targets, n..2n-1 the strikers."""

    start: float
    end: float
    segments: list[Segment] = field(default_factory=list)
    # (2n, e): times at which the motion of a ball has a kink, padded with infinity
    breaks: Array = field(default_factory=lambda: np.empty((0, 0)))
    # (2n,): when each ball stops sliding; its t_c if it never slid, at least its end if it then still slides
    slide_ends: Array = field(default_factory=lambda: np.empty(0))
    # collisions in which a ball stops and starts again; `solve` takes them over
    restarting: set[int] = field(default_factory=set)
    # (k,): collisions whose balls may meet again
    recontact_candidates: Index = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    radius: Array = field(default_factory=lambda: np.empty(0))  # (2n,)

    @property
    def size(self) -> int:
        return len(self.breaks) // 2

    def at(self, times: Array) -> Array:
        """Return states (2, n, m, 9) at times (m,), or (2n, m) of each ball, within [start, end].

        They are NaN after the end of a free striker.
        """
        own = np.broadcast_to(times, (2 * self.size, times.shape[-1]))
        out = np.full((*own.shape, 9), np.nan)
        for segment in self.segments:
            write_states(segment, own, out, slice(9))
        return out.reshape(2, self.size, own.shape[-1], 9)

    def heights(self, times: Array) -> Array:
        """Return the heights of the centres over the plate, (2, n, m) m, at times as for `at`."""
        own = np.broadcast_to(times, (2 * self.size, times.shape[-1]))
        out = np.repeat(self.radius, own.shape[-1]).reshape(*own.shape, 1)
        for segment in self.segments:
            if segment.aloft:
                write_states(segment, own, out, slice(2, 3))
        return out.reshape(2, self.size, own.shape[-1])

    def average_centres(self, starts: Array, exposure: float) -> Array:
        """Average the centres over exposures, (2, n, frames, 2) m, exactly across every kink.

        starts: when the exposures open, (frames,) or (2n, frames) of each ball; all within [start, end].
        """
        own = np.broadcast_to(starts, (2 * self.size, starts.shape[-1]))
        first, last = (of(np.atleast_2d(starts), axis=0) for of in (np.min, np.max))
        out = np.zeros((2, *own.shape))
        for segment in (part for whole in self.segments for part in split_segment(whole, MAX_GROUP)):
            begins, ends = segment.begins[:, None], segment.ends[:, None]
            near = np.flatnonzero((first <= ends.max()) & (last >= begins.min() - exposure))
            if len(near) == 0:
                continue
            where = segment.who, slice(near[0], near[-1] + 1)
            here = PackedRows((own[where] <= ends) & (own[where] >= begins - exposure))
            if not here.any:
                continue
            opens = here.gather(own[where])
            whole = np.clip(opens + exposure / 2, begins, ends)
            found = segment.average_centres(whole, exposure)
            some = PackedRows(here.inside & ((opens < begins) | (opens + exposure > ends)))
            if some.any:  # a kink splits these exposures
                a = np.clip(some.gather(opens), begins, ends)
                b = np.clip(some.gather(opens) + exposure, begins, ends)
                parts = segment.average_centres((a + b) / 2, b - a) * ((b - a) / exposure)
            for axis in (0, 1):
                rows, new = out[axis][where], found[axis]
                if some.any:
                    new = new.copy()
                    new[some.mask] = here.gather(rows)[some.mask] + parts[axis][some.inside]
                rows[here.mask] = new[here.inside]
                out[axis][where] = rows
        return np.moveaxis(out.reshape(2, 2, self.size, own.shape[-1]), 0, -1)


def may_vary_base(model: Model) -> bool:
    """Tell if base parameters may differ between the collisions of one batch: not if balls push each other."""
    return not model.laws.needs("push", "other")


def solve_collisions(
    model: Model,
    launches: Array,
    start: float,
    end: float,
    striker_is_a: Any = False,
    ends: Array | None = None,
    base: Mapping[str, Array] | None = None,
) -> CollisionBatch:
    """Solve many collisions at once. Raises ValueError as `solve` does.

    launches: (n, 6) or (n, 9), columns LAUNCH_COLUMNS and, of strikers that do not roll, `SPIN_COLUMNS` of `launch`.
    The x and y of a free striker, |b| > 1, are its own position; the target, which nobody sees, then rests there.
    start, end: s.
    striker_is_a: whether the striker is ball a of the experimenter, (n,) or one for all.
    ends: (n,) s, until when each free striker is followed; by default all are followed until `end`.
    base: base parameters of each collision, (n,), by name, instead of the model's; only if `may_vary_base`.
    """
    is_a = np.broadcast_to(np.asarray(striker_is_a, dtype=bool), len(launches))
    own: Any = base or {}
    at_hit = dataclasses.replace(model, **{name: own[name] for name in IMPACT_PARAMETERS if name in own})
    moving = {name: own[name] for name in MOTION_PARAMETERS if name in own}
    one, two = (dataclasses.replace(model.bodies_where(a), base=moving) for a in (~is_a, is_a))
    n, both = len(launches), Bodies.join(one, two)
    t_c = launches[:, 2].astype(float)
    spin = launches[:, 6:] if launches.shape[1] > len(LAUNCH_COLUMNS) else None
    free = np.abs(launches[:, 5]) > 1
    b = np.where(free, 0.0, launches[:, 5])
    # with a collision for each free striker too, whose outcome is not used
    states = np.concatenate(launch_touching_pairs(one, two, launches[:, 3], b, launches[:, 4], launches[:, :2], spin))
    alone = np.flatnonzero(free)
    strikers, targets = states[alone + n], states[alone]
    strikers[:, :2] = targets[:, :2] = launches[alone, :2]

    until = np.full(n, float(end)) if ends is None else np.where(free, np.minimum(ends, end), end)
    batch = CollisionBatch(float(start), float(end), radius=both.radius)
    run = _BatchSolver(model, both, batch, np.tile(t_c, 2), np.concatenate([np.where(free, t_c, until), until]))
    if run.mutual and len(alone):
        raise ValueError("a ball that meets nothing has no partner to push it")
    run.start_alone(alone, targets, strikers)
    states = run.solve_approach(states, ~free)
    hit = collide_pairs(at_hit, states[:n], states[n:], one, two)
    if run.mutual and np.any(soft := hit.impulse_n < MIN_IMPACT_SPEED_OF_PAIR_M_S * one.mass):
        raise ValueError("balls 0 and 1 " + STAYING.format(t_c[soft][0]))
    after = np.concatenate([hit.target, hit.striker])
    after[alone], after[alone + n] = targets, strikers
    run.solve_after_impact(after, hit.n[:, :2])
    candidates = run.out.recontact_candidates
    run.out.recontact_candidates = candidates[~free[candidates]]
    odd = np.array(sorted({*_find_second_contacts(run.out, both).tolist(), *run.out.restarting}), dtype=np.intp)
    models = {k: model.replace({name: float(values[k]) for name, values in own.items()}) for k in odd.tolist()}
    _solve_free_balls(models, strikers[np.isin(alone, odd)], (t_c, until), two, run.out, odd[free[odd]])
    return _solve_one_by_one(models, launches, is_a, run.out, odd[~free[odd]])


def _find_second_contacts(out: CollisionBatch, both: Bodies) -> Index:
    """Find collisions whose balls overlap after the impact, so that a second impact is missing.

    Between kinks the paths are parabolas or nearly so, which selects suspects; these are checked at many times.
    """
    overlap = 1e-7  # m: balls that overlap by more have met again
    samples = 24  # a ball that catches up takes tens of ms to pass through the other
    n = out.size
    if len(out.recontact_candidates) == 0:
        return out.recontact_candidates
    reach = (both.radius[:n] + both.radius[n:])[:, None]
    kinks = np.clip(np.concatenate([out.breaks[:n], out.breaks[n:]], axis=1), out.start, out.end)
    suspects = out.recontact_candidates
    if kinks.shape[1] < samples // 2:
        knots = np.sort(np.concatenate([kinks, np.full((n, 1), out.end)], axis=1), axis=1)
        states = out.at(np.concatenate([knots, knots]))
        apart = states[0, ..., :6] - states[1, ..., :6]
        places = interpolate_hermite(apart[..., [0, 1, 3, 4]], np.diff(knots), np.linspace(0, 1, 9))
        least = np.hypot(places[..., 0], places[..., 1]).min(axis=(1, 2))
        suspects = suspects[least[suspects] < reach[suspects, 0] - overlap / 2]
    if len(suspects) == 0:
        return suspects
    every = np.full((2 * n, samples), out.start)
    rows = np.concatenate([suspects, suspects + n])
    every[rows] = np.linspace(out.start, out.end, samples)
    places = out.at(every)[:, suspects, :, :3]
    gap = np.linalg.norm(places[0] - places[1], axis=-1) - reach[suspects]
    return np.asarray(suspects[gap.min(axis=1) < -overlap])


def _solve_one_by_one(
    models: Mapping[int, Model], launches: Array, is_a: Flags, out: CollisionBatch, which: Index
) -> CollisionBatch:
    """Replace the motion of some collisions by that of `solve`. models: of each of them."""
    if len(which) == 0:
        return out
    n, kinks = out.size, [list(row) for row in out.breaks]
    out.segments = [drop_balls(s, np.isin(s.who % n, which)) for s in out.segments]
    for k in which:
        x, y, t_c, v0, heading, b, *spin = launches[k]
        model = models[int(k)]
        labels = ("b", "a") if is_a[k] else ("a", "b")
        launch = Launch.pair(model.bodies(labels), t_c, v0, b, heading, (x, y), spin or NO_SPIN)
        motion = solve(model, launch, out.start, out.end, finish_slides=False)  # a slide may last for hours
        for ball in (0, 1):
            row, its = np.array([k + ball * n]), dataclasses.replace(motion, legs=motion.legs[ball : ball + 1])
            out.segments.append(TrajectorySegment(row, np.array([out.start]), np.array([out.end]), its))
            kinks[row[0]] = [e.t for e in motion.events if ball in (e.i, e.j)]
            ends = [e.t for e in motion.events if e.kind == "slide_end" and e.i == ball]
            later = out.end if its.legs[0][-1].motion in ("slide", "fly") else t_c
            out.slide_ends[row[0]] = ends[0] if ends else later
    most = max(map(len, kinks))
    out.breaks = np.array([row + [np.inf] * (most - len(row)) for row in kinks])
    return out


def _solve_free_balls(
    models: Mapping[int, Model],
    states: Array,
    spans: tuple[Array, Array],
    bodies: Bodies,
    out: CollisionBatch,
    which: Index,
) -> None:
    """Replace the motion of some balls that meet nothing, from their states (k, 9) on, by that of `solve`.

    models: of each of their collisions. spans: when the ball of each collision has that state, and until when it is
    followed, (n,) s. which: (k,).
    """
    if len(which) == 0:
        return
    t_c, ends = spans
    out.segments = [drop_balls(s, np.isin(s.who, which + out.size)) for s in out.segments]
    for k, state in zip(which, states[:, None], strict=True):
        row, time, radius = np.array([k + out.size]), t_c[[k]], bodies.radius[[k]]
        own = dataclasses.replace(bodies[[k]], base={})
        its = solve(models[int(k)], Launch(t_c[k], state, own), t_c[k], ends[k], finish_slides=False)
        if t_c[k] > out.start:
            out.segments.append(RollSegment(row, np.array([out.start]), time, time, state, radius, 0.0, 0.0))
        out.segments.append(TrajectorySegment(row, time, ends[[k]], its))
        slid = [e.t for e in its.events if e.kind == "slide_end"]
        out.slide_ends[row] = slid[0] if slid else t_c[k]  # all these balls have stopped, so none still slides


def _group_by_size(who: Index, size: Array) -> list[Index]:
    """Group the balls `who` by size, at most MAX_GROUP each: similar balls need the same pieces and as many frames."""
    return np.array_split(who[np.argsort(size)], -(-len(who) // MAX_GROUP)) if len(who) else []


class _BatchSolver:
    """Builds the segments of a batch leg by leg, with all balls in one mode of motion together."""

    def __init__(self, model: Model, bodies: Bodies, out: CollisionBatch, t_c: Array, ends: Array) -> None:
        self.model, self.bodies, self.out, self.t_c, self.ends = model, bodies, out, t_c, ends
        self.kinks = [t_c.copy()]
        out.slide_ends = t_c.copy()
        self.rolled = np.zeros(len(t_c), dtype=bool)  # balls whose slide ended as they bounced
        self.mutual = model.laws.needs("push", "other")
        self.bent = {mode: model.laws.has_effect_on(*laws) for mode, laws in LAWS.items()}  # without closed form
        self.floor = np.full(len(t_c), np.inf)

    def start_alone(self, which: Index, targets: Array, strikers: Array) -> None:
        """Add what is known of strikers that meet nothing until their launch, in states (k, 9): they move straight on.

        targets: states of the balls beside them, which rest and which nobody sees.
        """
        if len(which) == 0:
            return
        who = which + len(self.t_c) // 2
        self.out.segments.append(RestSegment(which, np.full(len(which), self.out.start), self.ends[who], targets))
        early = self.t_c[who] > self.out.start
        past, launched = who[early], self.t_c[who[early]]
        begins, radius = np.full(len(past), self.out.start), self.bodies.radius[past]
        self.out.segments.append(RollSegment(past, begins, launched, launched, strikers[early], radius, 0.0, 0.0))

    def solve_approach(self, states: Array, meet: Flags) -> Array:
        """Solve the approach, targets at rest, strikers rolling or sliding; return their states at the contact.

        states: (2n, 9), at the contact. meet: (n,), collisions that happen.
        """
        n, start = len(states) // 2, np.full(len(self.t_c), self.out.start)
        if self.mutual:
            return self._approach_with_push(states)
        rests = np.flatnonzero(meet & (self.t_c[:n] > self.out.start))
        self._rest(rests, states[rests], start, self.t_c)
        who = rests + n
        modes = classify_modes(states[who], self.bodies.radius[who])
        for mode in (ROLL, SLIDE):
            own = who[modes == mode]
            if self.bent[mode]:
                for some in _group_by_size(own, np.hypot(states[own, 3], states[own, 4])):
                    balls = BallStates.without_drilling(self.model, self.bodies[some], states[some])
                    for units, motion in propagate_back(balls, self.t_c[some], start[some]):
                        self.out.segments += IntegratedSegment.of(some[units], motion, self.out.start)
            elif mode == ROLL:
                self._add_roll(own, states[own], start[own], self.t_c[own], self.t_c[own])
            else:  # slides in closed form that end in these states at the contacts
                slowing = np.full(
                    len(own), self.bodies[own].base_value(self.model, "sliding_friction") * self.model.gravity
                )
                law, back = (self.bodies.radius[own], slowing), (start[own] - self.t_c[own])[:, None]
                first = kinematics.slide(states[own], *law, back, self.bodies.inertia[own])[:, 0]
                slides = SlideSegment(own, start[own], self.t_c[own], first, *law, self.bodies.inertia[own])
                self.out.segments.append(slides)
        return states

    def _approach_with_push(self, states: Array) -> Array:
        """Solve the approach of balls that push each other."""
        n, t_c = len(states) // 2, self.t_c[: len(states) // 2]
        if np.any(classify_modes(states, self.bodies.radius) == SLIDE):
            raise ValueError(UNKNOWN_PAST)
        hit, pieces, onset = solve_approach(self.model, self.bodies, states, np.maximum(t_c - self.out.start, 0.0))
        for units, motion in pieces:
            rows = np.concatenate([units, units + n])
            self.out.segments += IntegratedSegment.of(rows, motion.shift(self.t_c[rows]), self.out.start)
        if np.any(onset < 0):
            self._add_kink(np.arange(n), np.where(onset < 0, t_c + onset, np.inf))
        if np.any(((hit[:n, :6] - hit[n:, :6])[:, :3] * (hit[:n] - hit[n:])[:, 3:6]).sum(axis=1) >= 0):
            raise ValueError(PUSHED_AWAY)
        return hit

    def solve_after_impact(self, states: Array, n: Array) -> None:
        """Solve from the impact to the end.

        states: (2n, 9) after the impact; their array is used for the later ones. n: normal of the impact, from striker
        to target, (n, 2).
        """
        max_legs = 2000  # after an impact
        now, out_x, out_y = self.t_c.copy(), np.append(n[:, 0], -n[:, 0]), np.append(n[:, 1], -n[:, 1])
        parting = slowest = states[:, 3] * out_x + states[:, 4] * out_y  # of each ball from the other
        self._set_ending_slips(np.arange(len(now)), states)
        alone = {FLY: self._fly, SLIDE: self._slide, ROLL: self._roll_on, REST: self._stay}
        for _ in range(max_legs):
            modes = classify_modes(states, self.bodies.radius)
            down = np.flatnonzero((states[:, 5] < 0) & (modes != FLY))
            if len(down):
                self._land(down, states, now)
                modes[down] = classify_modes(states[down], self.bodies.radius[down])
            live = now < self.ends
            if not live.any():
                break
            if self.mutual:
                self._propagate_pairs(np.flatnonzero(live[: len(n)]), states, now, modes)
            else:
                for mode, advance in alone.items():
                    who = np.flatnonzero(live & (modes == mode))
                    if len(who):
                        advance(who, states, now)
            slowest = np.minimum(slowest, states[:, 3] * out_x + states[:, 4] * out_y)
        else:
            raise ValueError(f"the motion does not settle: {max_legs} legs after an impact")
        self.out.breaks = np.stack(self.kinks, axis=1)
        both = [one[: len(n)] + one[len(n) :] for one in (parting, slowest)]
        # balls that separate at the ends of their legs at over a tenth of their first speed do not meet again; within
        # a leg a push may slow a ball by 5 mm/s more than at its ends
        waver = 5e-3 if self.bent[ROLL] else 0.0
        self.out.recontact_candidates = np.flatnonzero(both[1] < 0.1 * both[0] + waver)

    def _add_kink(self, who: Index, when: Array) -> None:
        if np.any(np.isfinite(self.kinks[-1][who])):
            self.kinks.append(np.full(len(self.t_c), np.inf))
        self.kinks[-1][who] = when

    def _set_ending_slips(self, who: Index, states: Array) -> None:
        """Set the slips at which balls with an event will no longer drill."""
        n = len(states) // 2
        if self.model.laws.has_effect_on("drilling"):
            other = [(states[(who + n) % (2 * n)] - states[who])[:, None, :2]] if self.mutual else []
            self.floor[who] = find_ending_slip(self.model, states[who], self.bodies[who], *other)

    def _propagate(self, who: Index, states: Array, now: Array) -> None:
        balls = BallStates(self.model, self.bodies[who], states[who], self.floor[who])
        for units, step in propagate(balls, self.ends[who] - now[who]):
            self._add_step(who[units], step, states, now)

    def _propagate_pairs(self, who: Index, states: Array, now: Array, modes: Index) -> None:
        """Integrate pairs of balls that push each other by one step."""
        samples = 24  # within the step, at which a ball at rest is checked for the push that starts it
        n, rows = len(states) // 2, np.concatenate([who, who + len(states) // 2])
        balls = BallStates(self.model, self.bodies[rows], states[rows], self.floor[rows], 2)
        for units, step in propagate(balls, self.ends[who] - now[who]):
            mine = np.concatenate([who[units], who[units] + n])
            still = np.flatnonzero(modes[mine] == REST)
            if len(still):
                sampled = step.motion.at(step.durations[:, None] * np.linspace(0, 1, samples))
                other = sampled[..., :2].transpose(2, 0, 1)[:, (still + len(units)) % len(mine)]
                loose = excess_push(self.model, self.bodies[mine[still]], states[mine[still]], other).max(axis=1) > 0
                self.out.restarting |= set((mine[still[loose]] % n).tolist())
            self._add_step(mine, step, states, now)

    def _add_step(self, who: Index, step: IntegrationStep, states: Array, now: Array) -> None:
        """Record an integrated step of the balls `who`."""
        self.out.segments += IntegratedSegment.of(who, step.motion.shift(now[who]), self.ends[who])
        modes = classify_modes(states[who], self.bodies.radius[who])
        states[who], now[who] = step.final_states, snap_to_goal(now[who] + step.durations, self.ends[who])
        slid, ended = who[step.ended & (modes == SLIDE)], who[step.ended & (modes != FLY)]
        self.out.slide_ends[who[modes == SLIDE]] = now[who[modes == SLIDE]]  # or later, where it goes on
        self.floor[slid] = np.inf
        if len(ended):
            self._add_kink(ended, now[ended])

    def _stay(self, who: Index, states: Array, now: Array) -> None:
        self._rest(who, states[who], now, np.full(len(now), np.inf))
        now[who] = self.ends[who]

    def _rest(self, who: Index, held: Array, now: Array, until: Array) -> None:
        held[:, 3:8] = 0.0
        if self.bent[FLY]:
            loose = excess_push(self.model, self.bodies[who], held, np.full((2, 1, 1), np.inf))[:, 0] > 0
            self.out.restarting |= set((who[loose] % (len(self.t_c) // 2)).tolist())
        self.out.segments.append(RestSegment(who, now[who], until[who], held))

    def _land(self, who: Index, states: Array, now: Array) -> None:
        before = contact_velocity(states[who], self.bodies.radius[who])
        after = land_on_plate(self.model, states[who], self.bodies[who])
        slips = contact_velocity(after, self.bodies.radius[who])
        slip, left = np.hypot(before[:, 0], before[:, 1]), np.hypot(slips[:, 0], slips[:, 1])
        rolls = (slip > ZERO_SPEED_M_S) & (left <= 1e-9 * slip)
        vertical = after[:, 5].copy()
        radius = self.bodies.radius[who]
        q = rolling_velocity(after, radius, self.bodies.inertia[who])
        after[rolls] = rolling_state(after[rolls, :2], q[rolls], after[rolls, 8], radius[rolls])
        after[:, 5] = vertical
        states[who] = after
        self._set_ending_slips(who, states)
        first = who[rolls & ~self.rolled[who]]
        self.out.slide_ends[first] = now[first]
        self.rolled[who[rolls]] = True
        self._add_kink(who, now[who])

    def _fly(self, who: Index, states: Array, now: Array) -> None:
        if self.bent[FLY]:
            self._propagate(who, states, now)
            return
        begins, from_ = now[who], states[who]
        ends = begins + 2 * from_[:, 5] / self.model.gravity
        leg = FlightSegment(who, begins, ends, from_, self.model.gravity)
        self.out.segments.append(leg)
        states[who] = leg.states(ends[:, None])[:, 0]
        states[who, 2] = self.bodies.radius[who]
        now[who] = ends

    def _slide(self, who: Index, states: Array, now: Array) -> None:
        if self.bent[SLIDE]:
            u = contact_velocity(states[who], self.bodies.radius[who])
            for some in _group_by_size(who, np.hypot(u[:, 0], u[:, 1])):
                self._propagate(some, states, now)
            return
        begins, from_, radius, inertia = now[who], states[who], self.bodies.radius[who], self.bodies.inertia[who]
        slowing = np.full(len(who), self.bodies[who].base_value(self.model, "sliding_friction") * self.model.gravity)
        lasts = kinematics.slide_time(from_, radius, slowing, inertia)
        ends, last = begins + lasts, kinematics.slide(from_, radius, slowing, lasts[:, None], inertia)[:, 0]
        self.out.segments.append(SlideSegment(who, begins, ends, from_, radius, slowing, inertia))
        states[who] = rolling_state(last[:, :2], rolling_velocity(last, radius, inertia), last[:, 8], radius)
        now[who] = ends
        self.out.slide_ends[who] = ends
        self._add_kink(who, ends)

    def _roll_on(self, who: Index, states: Array, now: Array) -> None:
        """Roll to the end or to the stop."""
        end, speed = self.ends[who], np.hypot(states[who, 3], states[who, 4])
        if self.bent[ROLL]:
            for some in _group_by_size(who, speed * (end - now[who])):
                self._propagate(some, states, now)
            return
        drag, decel = (self.bodies[who].base_value(self.model, name) for name in ("rolling_drag", "rolling_decel"))
        lasts = kinematics.stop_time(speed, drag, decel)
        ends = np.minimum(end, now[who] + lasts)
        leg = self._add_roll(who, states[who], now[who], ends, now[who])
        states[who] = leg.states(ends[:, None])[:, 0]
        stopped = ends != end
        states[who[stopped], 3:8] = 0.0
        now[who] = ends
        self._add_kink(who[stopped], ends[stopped])

    def _add_roll(self, who: Index, states: Array, begins: Array, ends: Array, time: Array) -> RollSegment:
        """Add rolls in closed form through these states at `time`."""
        loss = (self.bodies[who].base_value(self.model, name) for name in ("rolling_drag", "rolling_decel"))
        leg = RollSegment(who, begins, ends, time, states, self.bodies.radius[who], *loss)
        self.out.segments.append(leg)
        return leg


def interpolate_hermite(ends: Array, wide: Array, shares: Array) -> Array:
    """Interpolate the paths of many collisions between knots with known velocities, by cubic Hermite polynomials.

    ends: (k, n, 4), x, y, vx, vy at the n knots of each of k balls. wide: (k, n - 1), times between the knots, s.
    shares: (m,), where to evaluate, as a share of each interval, 0 to 1.
    """
    s, h = shares[:, None], wide[..., None, None]
    a, b = ends[:, :-1, None], ends[:, 1:, None]
    left = (1 - s) ** 2 * ((1 + 2 * s) * a[..., :2] + s * h * a[..., 2:])
    return np.asarray(left + s**2 * ((3 - 2 * s) * b[..., :2] + (s - 1) * h * b[..., 2:]))
