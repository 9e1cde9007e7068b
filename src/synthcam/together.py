"""Collisions of balls that push each other, many at once: the approach, the impact, and all that follows in pieces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from synthcam.coupled import CLINGING, Ints, Pair, Piece, approach, excess, floors, mode_of, step
from synthcam.impact import collide, land
from synthcam.kinematics import Array, contact_velocity, rolling_state, rolling_velocity
from synthcam.model import Bodies, Model
from synthcam.pulled import STILL, Flags
from synthcam.segment import Resting, Segment

BLOCK = 2000  # pairs led together
AGAIN = 1e-7  # m: balls that come closer than touching by more have met again
ROUNDS = 1000  # pieces of a motion, at most


@dataclass
class Led:
    """The motion of n pairs: balls 0..n-1 are the targets, n..2n-1 the strikers; as in a Batch."""

    segments: list[Segment] = field(default_factory=list)
    kinks: list[Array] = field(default_factory=list)  # (2n,) each
    slide_ends: Array = field(default_factory=lambda: np.empty(0))
    odd: set[int] = field(default_factory=set)


def collisions(model: Model, bodies: Pair, touching: Array, t_c: Array, start: float, end: float) -> Led:
    """From states (2, n, 9) of targets and strikers that touch at t_c (n,), but for what the pull does to targets."""
    n = len(t_c)
    out = Led(slide_ends=np.concatenate([t_c, t_c]), kinks=[np.concatenate([t_c, t_c])])
    for first in range(0, n, BLOCK):
        who = np.arange(first, min(first + BLOCK, n))
        _Block(model, (bodies[0][who], bodies[1][who]), who, n, out).run(touching[:, who], t_c[who], start, end)
    return out


class _Block:
    """Some of the pairs, `who` of all n."""

    def __init__(self, model: Model, bodies: Pair, who: Ints, n: int, out: Led) -> None:
        self.model, self.bodies, self.who, self.n, self.out = model, bodies, who, n, out
        self.odd = np.zeros(len(who), dtype=bool)
        self.rolled = np.zeros((2, len(who)), dtype=bool)  # balls whose slide ended as they bounced

    def run(self, touching: Array, t_c: Array, start: float, end: float) -> None:
        hit, pieces, lost = approach(self.model, self.bodies, touching, t_c, np.full(len(t_c), start))
        self.odd[lost] = True
        onset, rested = t_c.copy(), hit[0].copy()
        for piece in pieces:
            if piece.courses[0].motion == "roll":
                onset[piece.who], rested[piece.who] = piece.then, piece.last[0]
                self._add(piece, (0, 1))
                self._kink(0, piece.who, piece.then)
            else:
                self._add(piece, (1,))
        rested[:, 3:8] = 0.0
        early = np.flatnonzero(onset > start)
        self.out.segments.append(Resting(self.who[early], np.full(len(early), start), onset[early], rested[early]))
        after = collide(self.model, hit[0], hit[1], *self.bodies)
        self._odd_if(after.impulse_n < CLINGING * np.maximum(self.bodies[0].mass, self.bodies[1].mass))  # if any
        states = np.stack([after.target, after.striker])
        self.floor = floors(self.model, self.bodies, states)
        self._after(states, t_c.copy(), end)
        self.out.odd |= set(self.who[self.odd].tolist())

    def _after(self, states: Array, now: Array, end: float) -> None:
        for ball in (0, 1):
            self._land(ball, np.flatnonzero(states[ball, :, 5] < 0), states, now)
        radii = [body.radius for body in self.bodies]
        for _ in range(ROUNDS):
            one, two = (mode_of(*each) for each in zip(states, radii, self.floor, strict=True))
            live = (now < end) & ~self.odd
            kinds = sorted(set(zip(one[live].tolist(), two[live].tolist(), strict=True)))
            if len(kinds) == 0:
                return
            for names in kinds:
                todo = np.flatnonzero(live & (one == names[0]) & (two == names[1]))
                if names == ("rest", "rest"):
                    self._rest(todo, states, now)
                    now[todo] = end
                    continue
                pair = self.bodies[0][todo], self.bodies[1][todo]
                goal = np.full(len(todo), end)
                found, failed = step(self.model, pair, names, states[:, todo], self.floor[:, todo], now[todo], goal)
                self.odd[todo[failed]] = True
                for piece in found:
                    self._on(piece.among(todo), names, states, now)
        self.odd |= now < end

    def _on(self, piece: Piece, names: Sequence[str], states: Array, now: Array) -> None:
        """To the end of a piece."""
        who = piece.who
        self._add(piece, (0, 1))
        self._odd_if(_overlap(piece, [b[who] for b in self.bodies]), who)
        states[:, who], now[who] = piece.last, piece.then
        for ball, name in enumerate(names):
            over = who[piece.over[ball]]
            if name == "rest":
                loose = excess(self.model, self.bodies[ball][who], states[ball, who], piece.places[1 - ball]) > 0
                self._odd_if(np.any(loose, axis=1), who)
            elif name == "fly":
                self._land(ball, over, states, now)
            elif name == "drill":
                self.floor[ball, over] = np.inf
            elif len(over):
                some, radius = states[ball, over], self.bodies[ball].radius[over]
                velocity = rolling_velocity(some, radius) if name == "slide" else np.zeros((len(over), 2))
                states[ball, over] = rolling_state(some[:, :2], velocity, some[:, 8], radius)
                self._kink(ball, over, now[over])
                if name == "slide":
                    self.out.slide_ends[self.who[over] + ball * self.n] = now[over]

    def _land(self, ball: int, who: Ints, states: Array, now: Array) -> None:
        if len(who) == 0:
            return
        body = self.bodies[ball][who]
        down = states[ball, who]
        up = land(self.model, down, body)
        slips = [np.hypot(*contact_velocity(s, body.radius).T) for s in (down, up)]
        rolls = (slips[0] > STILL) & (slips[1] <= 1e-9 * slips[0])
        vertical = up[:, 5].copy()
        up[rolls] = rolling_state(
            up[rolls, :2], rolling_velocity(up, body.radius)[rolls], up[rolls, 8], body.radius[rolls]
        )
        up[:, 5] = vertical
        states[ball, who] = up
        pair = self.bodies[0][who], self.bodies[1][who]
        self.floor[ball, who] = floors(self.model, pair, states[:, who])[ball]
        first = who[rolls & ~self.rolled[ball, who]]
        self.out.slide_ends[self.who[first] + ball * self.n] = now[first]
        self.rolled[ball, who[rolls]] = True
        self._kink(ball, who, now[who])

    def _rest(self, who: Ints, states: Array, now: Array) -> None:
        for ball in (0, 1):
            other = states[1 - ball, who, :2].T[..., None]
            self._odd_if(excess(self.model, self.bodies[ball][who], states[ball, who], other)[:, 0] > 0, who)
            ever = np.full(len(who), np.inf)
            self.out.segments.append(Resting(self.who[who] + ball * self.n, now[who], ever, states[ball, who]))

    def _odd_if(self, which: Flags, who: Ints | None = None) -> None:
        """These pairs are left to `solve`."""
        self.odd[(np.arange(len(self.odd)) if who is None else who)[which]] = True

    def _add(self, piece: Piece, balls: Sequence[int]) -> None:
        for ball in balls:
            self.out.segments.append(replace(piece.courses[ball], who=self.who[piece.who] + ball * self.n))

    def _kink(self, ball: int, who: Ints, when: Array) -> None:
        if len(who):
            self.out.kinks.append(np.full(2 * self.n, np.inf))
            self.out.kinks[-1][self.who[who] + ball * self.n] = when


def _overlap(piece: Piece, bodies: Sequence[Bodies]) -> Flags:
    """Whose balls overlap within a piece, (k,): looked for closely where they approach."""
    reach = 2 * np.sqrt(bodies[0].radius * bodies[1].radius)  # seen from above
    x, v = piece.places[0] - piece.places[1], piece.velocities[0] - piece.velocities[1]
    nearest = np.sqrt((x * x).sum(axis=0).min(axis=1))
    near = np.flatnonzero(((x * v).sum(axis=0).min(axis=1) < 0) & (nearest < 1.5 * reach))
    if len(near):
        share = np.linspace(0, 1, 65)
        times = piece.now[near, None] + (piece.then - piece.now)[near, None] * share
        one, two = (course.of(near).states(times)[..., :2] for course in piece.courses)
        nearest[near] = np.sqrt(((one - two) ** 2).sum(axis=-1).min(axis=1))
    return np.asarray(nearest < reach - AGAIN)
