"""Thousands of two-ball collisions at once: the motion of `dynamics.solve`, vectorised over collisions.

A collision here is one impact of a rolling ball on a ball at rest, and what follows: flights, slides, rolls. Where two
balls would touch again, or push each other, that collision is handed to `solve`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam import rolling, sliding
from synthcam.dynamics import AGREED, STILL, SWEEPS, solve, uncoupled
from synthcam.hermite import Table, around, between
from synthcam.impact import collide, land
from synthcam.kinematics import (
    Array,
    contact_velocity,
    fly,
    roll,
    rolling_state,
    rolling_velocity,
    slide,
    slide_time,
    stop_time,
)
from synthcam.launch import Launch, touching
from synthcam.model import Bodies, Model
from synthcam.trajectory import GAUSS

Ints = NDArray[np.intp]
LAUNCH = ("x", "y", "t_c", "v0", "heading", "b")  # the contact's place, m; s; m/s; rad; over the sum of the radii
AGAIN = 1e-7  # m: balls that come closer than touching by more have met again
LOOKS = 24  # at whether balls overlap: one that catches up takes tens of ms to pass through
ROUNDS = 400  # legs after an impact, at most


@dataclass(frozen=True)
class Segment:
    """Legs of one kind: balls `who` (k,) from `begins` to `ends`; states(times (k, m)) -> (k, m, 9)."""

    who: Ints
    begins: Array
    ends: Array
    states: Callable[[Array], Array]


@dataclass
class Batch:
    """The motion of n collisions from `start` to `end`. Balls 0..n-1 are the targets, n..2n-1 the strikers.

    breaks (2n, e): times at which a ball's motion has a kink, padded with infinity. slide_ends (2n,): when each ball
    stops sliding; its t_c if it never slid.
    """

    start: float
    end: float
    segments: list[Segment] = field(default_factory=list)
    breaks: Array = field(default_factory=lambda: np.empty((0, 0)))
    slide_ends: Array = field(default_factory=lambda: np.empty(0))
    odd: set[int] = field(default_factory=set)  # collisions in which a ball stops and starts again: left to `solve`

    @property
    def size(self) -> int:
        return len(self.breaks) // 2

    def add(self, who: Ints, begins: Array, ends: Array, states: Callable[[Array], Array]) -> None:
        self.segments.append(Segment(who, begins, ends, states))

    def at(self, times: Array) -> Array:
        """States (2, n, m, 9) at times (m,), or at times (2n, m) of each ball's own, within [start, end]."""
        own = np.broadcast_to(times, (2 * self.size, times.shape[-1]))
        out = np.empty((*own.shape, 9))
        for segment in self.segments:
            mine = own[segment.who]
            here = (mine >= segment.begins[:, None]) & (mine <= segment.ends[:, None])
            columns = np.flatnonzero(here.any(axis=0))
            if len(columns) == 0:
                continue
            inside = np.clip(mine[:, columns], segment.begins[:, None], segment.ends[:, None])
            rows, cols = np.nonzero(here[:, columns])
            out[segment.who[rows], columns[cols]] = segment.states(inside)[rows, cols]
        return out.reshape(2, self.size, own.shape[-1], 9)

    def means(self, starts: Array, exposure: float) -> Array:
        """Centres (2, n, frames, 2) averaged over exposures, split at every kink.

        starts: when they open, rising, (frames,) or of each ball's own, (2n, frames).
        """
        nodes, weights = np.polynomial.legendre.leggauss(GAUSS)
        nodes, weights = (1 + nodes) / 2, weights / 2
        frames = starts.shape[-1]
        plain = self.at((starts[..., None] + exposure * nodes).reshape(*starts.shape[:-1], -1))[..., :2]
        out = (plain.reshape(2 * self.size, frames, GAUSS, 2) * weights[:, None]).sum(axis=2)
        if exposure > 0:
            own = np.broadcast_to(starts, (2 * self.size, frames))
            for kink in range(self.breaks.shape[1]):
                self._split(out, kink, own, exposure, nodes, weights)
        return np.asarray(out.reshape(2, self.size, frames, 2))

    def _split(self, out: Array, kink: int, starts: Array, exposure: float, nodes: Array, weights: Array) -> None:
        """Do again the exposures in which each ball's `kink`-th break falls, in pieces between all its breaks."""
        when = self.breaks[:, kink]
        frame = (starts <= when[:, None]).sum(axis=1) - 1
        inside = (frame >= 0) & (when < starts[np.arange(len(when)), frame] + exposure)
        rows = np.flatnonzero(inside)
        if len(rows) == 0:
            return
        opens = starts[rows, frame[rows]][:, None]
        cuts = np.sort(np.clip(self.breaks[rows], opens, opens + exposure), axis=1)
        edges = np.concatenate([opens, cuts, opens + exposure], axis=1)
        width = np.diff(edges, axis=1)
        times = np.repeat(starts[:, :1], width.shape[1] * GAUSS, axis=1)
        times[rows] = (edges[:, :-1, None] + width[..., None] * nodes).reshape(len(rows), -1)
        states = self.at(times)[..., :2].reshape(2 * self.size, width.shape[1], GAUSS, 2)[rows]
        share = (width / exposure)[..., None] * weights
        out[rows, frame[rows]] = (states * share[..., None]).sum(axis=(1, 2))


def collisions(model: Model, launches: Array, start: float, end: float, striker_is_a: Any = False) -> Batch:
    """The collisions of `launches` (n, 6), columns LAUNCH, from `start` to `end`, s.

    striker_is_a: (n,) or one for all: was the experimenter's ball a launched? Raises ValueError as `solve` does.
    """
    count = len(launches)
    is_a = np.broadcast_to(np.asarray(striker_is_a, dtype=bool), (count,))
    one = model.bodies(["b" if a else "a" for a in is_a])
    two = model.bodies(["a" if a else "b" for a in is_a])
    both = Bodies(*(np.concatenate([getattr(one, f), getattr(two, f)]) for f in ("radius", "mass", "of_a")))
    t_c = launches[:, 2].astype(float)
    target, striker = touching(one, two, launches[:, 3], launches[:, 5], launches[:, 4], launches[:, :2])

    def motion(model: Model, known: Batch | None) -> Batch:
        run = _Run(model, both, Batch(float(start), float(end)), np.concatenate([t_c, t_c]), known)
        run.before(target, striker)
        hit = collide(model, target, striker, one, two)
        run.after(np.concatenate([hit.target, hit.striker]))
        return run.out

    out = _swept(motion, model) if model.laws.asks("push", "other") else motion(model, None)
    odd = sorted({*_met_again(out, both).tolist(), *out.odd})
    return _by_solve(model, launches, is_a, out, np.array(odd, dtype=np.intp))


def _swept(motion: Callable[[Model, Batch | None], Batch], model: Model) -> Batch:
    """Balls that push each other: each in the other's last known path, until both agree."""
    grid = np.linspace(0, 1, 64)
    out = motion(uncoupled(model), None)
    for _ in range(SWEEPS):
        new = motion(model, out)
        times = out.start + grid * (out.end - out.start)
        change = np.abs(new.at(times)[..., :2] - out.at(times)[..., :2]).max()
        out = new
        if change < AGREED:
            break
    return out


def _table(known: Batch, t_c: Array) -> Table:
    """Where all balls were in the last sweep."""
    knots = np.concatenate([around(t_c, known.start, known.end), np.clip(known.breaks, known.start, known.end)], axis=1)
    return Table.of(lambda times: known.at(times)[..., [0, 1, 3, 4]].reshape(len(times), -1, 4), knots)


def _met_again(out: Batch, both: Bodies) -> Ints:
    """Collisions whose balls overlap after the impact, so that a second impact is missing.

    Looked for between the kinks, where paths are parabolas or nearly; where they come near, at many instants.
    """
    n = out.size
    reach = (both.radius[:n] + both.radius[n:])[:, None]
    kinks = np.clip(np.concatenate([out.breaks[:n], out.breaks[n:]], axis=1), out.start, out.end)
    suspects = np.arange(n)
    if kinks.shape[1] < LOOKS // 2:
        knots = np.sort(np.concatenate([kinks, np.full((n, 1), out.end)], axis=1), axis=1)
        states = out.at(np.concatenate([knots, knots]))
        apart = states[0, ..., :6] - states[1, ..., :6]
        places = between(apart[..., [0, 1, 3, 4]], np.diff(knots), np.linspace(0, 1, 9))
        suspects = np.flatnonzero(np.hypot(places[..., 0], places[..., 1]).min(axis=(1, 2)) < reach[:, 0] - AGAIN / 2)
    if len(suspects) == 0:
        return suspects
    every = np.full((2 * n, LOOKS), out.start)
    rows = np.concatenate([suspects, suspects + n])
    every[rows] = np.linspace(out.start, out.end, LOOKS)
    places = out.at(every)[:, suspects, :, :3]
    gap = np.linalg.norm(places[0] - places[1], axis=-1) - reach[suspects]
    return np.asarray(suspects[gap.min(axis=1) < -AGAIN])


def _by_solve(model: Model, launches: Array, is_a: NDArray[np.bool_], out: Batch, which: Ints) -> Batch:
    """Replace the motion of some collisions by that of `solve`."""
    if len(which) == 0:
        return out
    n, kinks = out.size, [list(row) for row in out.breaks]
    gone = np.concatenate([which, which + n])
    out.segments = [s for s in (_without(s, gone) for s in out.segments) if len(s.who)]
    for k in which:
        x, y, t_c, v0, heading, b = launches[k]
        labels = ("b", "a") if is_a[k] else ("a", "b")
        motion = solve(model, Launch.pair(model.bodies(labels), t_c, v0, b, heading, (x, y)), out.start, out.end)
        for ball in (0, 1):

            def states(times: Array, motion: Any = motion, ball: int = ball) -> Array:
                return np.asarray(motion.at(times.ravel())[ball].reshape(*times.shape, 9))

            row = np.array([k + ball * n])
            out.add(row, np.array([out.start]), np.array([out.end]), states)
            kinks[row[0]] = [e.t for e in motion.events if ball in (e.i, e.j)]
            ends = [e.t for e in motion.events if e.kind == "slide_end" and e.i == ball]
            out.slide_ends[row[0]] = ends[0] if ends else t_c
    most = max(map(len, kinks))
    out.breaks = np.array([row + [np.inf] * (most - len(row)) for row in kinks])
    return out


def _without(segment: Segment, gone: Ints) -> Segment:
    kept = np.flatnonzero(~np.isin(segment.who, gone))
    if len(kept) == len(segment.who):
        return segment

    def states(times: Array) -> Array:
        full = np.repeat(segment.begins[:, None], times.shape[1], axis=1)
        full[kept] = times
        return segment.states(full)[kept]

    return Segment(segment.who[kept], segment.begins[kept], segment.ends[kept], states)


class _Run:
    """Builds the segments of a batch, round by round, all balls that are in one state together."""

    def __init__(self, model: Model, bodies: Bodies, out: Batch, t_c: Array, known: Batch | None) -> None:
        self.model, self.bodies, self.out, self.t_c = model, bodies, out, t_c
        self.kinks = [t_c.copy()]
        self.table = _table(known, t_c) if known else None
        out.slide_ends = t_c.copy()

    def before(self, target: Array, striker: Array) -> None:
        """The approach: targets at rest, strikers rolling."""
        n, start = len(target), np.full(len(self.t_c), self.out.start)
        early = np.flatnonzero(self.t_c > self.out.start)
        self._rest(early[early < n], target[early[early < n]], start, self.t_c)
        who = early[early >= n]
        if len(who):
            self._roll(who, striker[who - n], self.t_c[who], start[who], back=True)

    def after(self, states: Array) -> None:
        """From the impact on, to the end."""
        states, now = states.copy(), self.t_c.copy()
        end = self.out.end
        for _ in range(ROUNDS):
            down = np.flatnonzero(states[:, 5] < 0)
            if len(down):
                self._land(down, states, now)
            live = now < end
            flying = np.flatnonzero(live & (states[:, 5] > 0))
            u = contact_velocity(states, self.bodies.radius)
            speed = np.hypot(states[:, 3], states[:, 4])
            slips = np.hypot(u[:, 0], u[:, 1]) > STILL
            sliding_ = np.flatnonzero(live & (states[:, 5] == 0) & slips)
            plain = np.flatnonzero(live & (states[:, 5] == 0) & ~slips)
            if len(flying) + len(sliding_) + len(plain) == 0:
                break
            if len(flying):
                self._fly(flying, states, now)
            if len(sliding_):
                self._slide(sliding_, states, now)
            moving = plain[speed[plain] > STILL]
            if len(moving):
                until = np.full(len(moving), end)
                states[moving], now[moving] = self._roll(moving, states[moving], now[moving], until)
            still = plain[speed[plain] <= STILL]
            if len(still):
                self._rest(still, states[still], now, np.full(len(now), np.inf))
                now[still] = end
        else:
            raise ValueError(f"the motion does not settle: {ROUNDS} legs after an impact")
        self.out.breaks = np.stack(self.kinks, axis=1)

    def _other(self, who: Ints) -> sliding.Other | None:
        """Where the partners of balls `who` were in the last sweep."""
        table = self.table
        if table is None:
            return None
        partners = (who + len(self.t_c) // 2) % len(self.t_c)
        return lambda times, which: table(
            partners[which], np.broadcast_to(times, (len(partners[which]), times.shape[1]))
        )

    def _kink(self, who: Ints, when: Array) -> None:
        if len(who):
            self.kinks.append(np.full(len(self.t_c), np.inf))
            self.kinks[-1][who] = when

    def _rest(self, who: Ints, states: Array, now: Array, until: Array) -> None:
        held = states.copy()
        held[:, 3:8] = 0.0
        self.out.odd |= set((who[self._loose(who, held)] % (len(self.t_c) // 2)).tolist())
        self.out.add(who, now[who], until[who], lambda t: np.repeat(held[:, None], t.shape[1], axis=1))

    def _loose(self, who: Ints, held: Array) -> NDArray[np.bool_]:
        """Which balls at rest would not stay there."""
        if not self.model.laws.bent("push") or self.model.laws.asks("push", "other"):
            return np.zeros(len(who), dtype=bool)
        some = self.bodies[who]
        instant = dict(position=held[:, :2], velocity=held[:, 3:5], gravity=self.model.gravity)
        instant |= dict(radius=some.radius, mass=some.mass, of_a=some.of_a)
        push = self.model.laws("push", np.zeros((len(who), 2)), instant)
        return np.asarray(5 / 7 * np.hypot(push[:, 0], push[:, 1]) > self.model.rolling_decel)

    def _land(self, who: Ints, states: Array, now: Array) -> None:
        before = contact_velocity(states[who], self.bodies.radius[who])
        after = land(self.model, states[who], self.bodies[who])
        slips = contact_velocity(after, self.bodies.radius[who])
        slip, left = np.hypot(before[:, 0], before[:, 1]), np.hypot(slips[:, 0], slips[:, 1])
        rolls = (slip > STILL) & (left <= 1e-9 * slip)
        vertical = after[:, 5].copy()
        radius = self.bodies.radius[who]
        q = rolling_velocity(after, radius)
        after[rolls] = rolling_state(after[rolls, :2], q[rolls], after[rolls, 8], radius[rolls])
        after[:, 5] = vertical
        states[who] = after
        self.out.slide_ends[who[rolls]] = now[who[rolls]]
        self._kink(who, now[who])

    def _fly(self, who: Ints, states: Array, now: Array) -> None:
        model, begins, from_ = self.model, now[who], states[who]
        ends = begins + 2 * from_[:, 5] / model.gravity
        plane = (
            rolling.flights(model, from_, self.bodies[who], begins, ends, self._other(who))
            if model.laws.bent("push")
            else None
        )

        def path(times: Array) -> Array:
            out = fly(from_, model.gravity, times - begins[:, None])
            if plane is not None:
                y = plane.plane(times)
                out[..., 0:2], out[..., 3:5] = y[..., :2], y[..., 2:]
            return out

        self.out.add(who, begins, ends, path)
        states[who] = path(ends[:, None])[:, 0]
        states[who, 2] = self.bodies.radius[who]
        now[who] = ends

    def _slide(self, who: Ints, states: Array, now: Array) -> None:
        model, begins, from_, bodies = self.model, now[who], states[who], self.bodies[who]
        path: Callable[[Array], Array]
        if model.laws.bent(*sliding.LAWS):
            found = sliding.slides(model, from_, bodies, begins, self._other(who))
            lasts, last = found.lasts, found.ends()

            def path(times: Array) -> Array:
                return found.states(times - begins[:, None])
        else:
            slowing = np.full(len(who), model.sliding_friction * model.gravity)
            lasts = slide_time(from_, bodies.radius, slowing)
            last = slide(from_, bodies.radius, slowing, lasts[:, None])[:, 0]

            def path(times: Array) -> Array:
                return slide(from_, bodies.radius, slowing, times - begins[:, None])

        self.out.add(who, begins, begins + lasts, path)
        states[who] = rolling_state(last[:, :2], rolling_velocity(last, bodies.radius), last[:, 8], bodies.radius)
        now[who] = begins + lasts
        self.out.slide_ends[who] = now[who]
        self._kink(who, now[who])

    def _roll(self, who: Ints, states: Array, now: Array, until: Array, back: bool = False) -> tuple[Array, Array]:
        """Roll until `until` or the stop; the states and times there."""
        model, bodies = self.model, self.bodies[who]
        path: Callable[[Array], Array]
        if model.laws.bent(*rolling.LAWS):
            found = rolling.rolls(model, states, bodies, now, until, self._other(who))
            ends, path = found.until, found.states
            if back and np.any(ends > until):
                raise ValueError("a ball would have had to come from rest within the run")
            stopped = ends != until
        else:
            speed = np.hypot(states[:, 3], states[:, 4])
            stop = now + stop_time(speed, model.rolling_drag, model.rolling_decel)
            stopped = stop < until
            ends = until if back else np.minimum(until, stop)

            def path(times: Array) -> Array:
                return roll(states, bodies.radius, model.rolling_drag, model.rolling_decel, times - now[:, None])

        self.out.add(who, np.minimum(now, ends), np.maximum(now, ends), path)
        if back:
            return states, now
        last = path(ends[:, None])[:, 0]
        last[stopped, 3:8] = 0.0
        self._kink(who[stopped], ends[stopped])
        return last, np.asarray(ends).copy()
