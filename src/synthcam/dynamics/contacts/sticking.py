"""Which bodies stick together, and what a hit does to them: it pushes a group, parts it, or joins a body to it."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from synthcam.dynamics.contacts.impact import ImpactChange, combine_inertia_factors, find_contact_coefficients
from synthcam.dynamics.contacts.rigid_group import (
    RigidGroup,
    Vector,
    collide_groups,
    find_connected,
    find_meeting_velocities,
    split_into_groups,
)
from synthcam.dynamics.contacts.walls import Wall
from synthcam.dynamics.kinematics import State
from synthcam.dynamics.supports import Air, DryPlate, Support
from synthcam.dynamics.trajectory import Event, Leg
from synthcam.model import Bodies, Model

Bonds = dict[tuple[int, int], float]


class StickingBodies:
    """The bodies of a run that may stick. strength: of each body's contacts, N s; 0: it does not stick."""

    def __init__(self, model: Model, bodies: Bodies, strength: Sequence[float]) -> None:
        self.model, self.strength, self.bonds = model, strength, Bonds()
        numbers = zip(bodies.radius.tolist(), bodies.mass.tolist(), bodies.inertia.tolist(), strict=True)
        self.bodies = dict(enumerate(numbers))
        self.radius = {k: body[0] for k, body in self.bodies.items()}

    def find_fellows(self, *balls: int) -> set[int]:
        """Return the bodies that move as one with any of these, themselves among them."""
        return find_connected(self.bonds, *balls)

    def concerns(self, *balls: int) -> bool:
        """Tell whether a hit of these bodies is one of a group, or makes one."""
        joins = len(balls) == 2 and max(self.strength[k] for k in balls) > 0
        return joins or any(k in pair for pair in self.bonds for k in balls)

    @property
    def joined(self) -> set[tuple[int, int]]:
        """All pairs that move as one."""
        parts = split_into_groups(self.bonds, {k for pair in self.bonds for k in pair})
        return {pair for part in parts for pair in combinations(sorted(part), 2)}

    def legs(self, states: Mapping[int, State], supports: Sequence[Support | None], t: float) -> dict[int, Leg]:
        """Return the legs of those of these bodies that move as one with others, on the support of the first."""
        out: dict[int, Leg] = {}
        for part in split_into_groups(self.bonds, {k for pair in self.bonds for k in pair} & set(states)):
            support, group = supports[min(part)], self._join({k: states[k] for k in part})
            if isinstance(support, DryPlate):
                out |= group.slide(support, self.bodies, t)
            else:
                assert isinstance(support, Air)
                out |= group.glide(support, t)
        return out

    def stop(self, states: Mapping[int, State], supports: Sequence[Support | None]) -> dict[int, State]:
        """Let the centre of mass of a group rest; on air its spin stays."""
        group = self._join(states)
        spin = group.spin if isinstance(supports[min(states)], Air) else 0.0
        return replace(group, velocity=(0.0, 0.0), spin=spin).states()

    def part(self, t: float, broken: Iterable[tuple[int, int]]) -> list[Event]:
        """Part pairs; returns the events."""
        for pair in (broken := sorted(broken)):
            del self.bonds[pair]
        return [Event(t, "apart", *pair) for pair in broken]

    def collide(
        self, t: float, i: int, j: int, states: Mapping[int, State], change: ImpactChange | None
    ) -> tuple[list[Event], dict[int, State]]:
        """Let the groups of two bodies hit. states: of all their bodies. Returns events and the states just after."""
        model, (one, two) = self.model, (self._group_of(k, states) for k in (i, j))
        x, y = (states[i][axis] - states[j][axis] for axis in (0, 1))
        n: Vector = (x / math.hypot(x, y), y / math.hypot(x, y))
        relative = tuple(states[j][axis] - states[i][axis] for axis in (3, 4))
        if change and change.turn:
            n = change.turn_normal(*n, *relative)
        point = _find_point(states[i], self.radius[i], n)
        v_n, u_t, soft_n, soft_t = find_meeting_velocities(one, two, point, n)
        ratio = soft_t / soft_n
        alone = len(one.places) == len(two.places) == 1
        (_, m1, k1), (_, m2, k2) = self.bodies[i], self.bodies[j]
        ratio = max(ratio, 1.01)  # of K_t to K_n, in the model's laws: a body alone has 1 + 1/k
        k = combine_inertia_factors(k1, m1, k2, m2) if alone else 1 / (ratio - 1)
        slip = (-n[1] * u_t, n[0] * u_t, 0.0)
        r, c = find_contact_coefficients(model, v_n, slip, relative, n, k)
        if change:
            r, c = change.change_restitution(r, v_n), c * change.friction
        new_one, new_two, impulse_n, impulse_t = collide_groups(one, two, point, n, r, 2 * c * (1 + k))
        if broken := one.break_bonds(i, impulse_n) | two.break_bonds(j, impulse_n):
            events = self.part(t, broken)
            more, after = self.collide(t, i, j, states, change)
            rest = {k: s for k, s in states.items() if k not in after}
            return events + more, after | rest
        assert new_two is not None
        after, together = new_one.states() | new_two.states(), []
        if (strength := max(self.strength[k] for k in (i, j))) > 0:
            own = {k: states[k] for k in (*one.places, *two.places)}
            whole = RigidGroup.join(own, self.bodies, {})
            after = whole.states()
            momenta = ([self.bodies[k][1] * np.array(s[k][3:5]) for k in one.places] for s in (own, after))
            was, now = (np.sum(of_each, axis=0) for of_each in momenta)
            impulse_n, impulse_t = float((now - was) @ n), float((now - was) @ (-n[1], n[0]))
            self.bonds[min(i, j), max(i, j)] = strength
            together = [Event(t, "together", min(i, j), max(i, j))]
        early, late = (np.array([s[i], s[j]]) for s in (states, after))
        drawn = change.drawn if change else {}
        return [Event(t, "contact", i, j, early, late, n, impulse_n, impulse_t, drawn), *together], after

    def bounce(
        self, t: float, i: int, number: int, wall: Wall, states: Mapping[int, State], change: ImpactChange | None
    ) -> tuple[list[Event], dict[int, State]]:
        """Let the group of a body hit a wall, as `collide_groups` does for two groups."""
        one = self._group_of(i, states)
        _, *normal = wall.distance(*states[i][:2])
        n: Vector = (normal[0], normal[1])
        point = _find_point(states[i], self.radius[i], n)
        v_n, u_t, soft_n, soft_t = find_meeting_velocities(one, None, point, n)
        r = change.change_restitution(wall.restitution, v_n) if change else wall.restitution
        most = wall.friction * (1 + r) * v_n / soft_n * soft_t
        friction = min(1 + wall.tangential_restitution, most / max(abs(u_t), 1e-300))
        new_one, _, impulse_n, impulse_t = collide_groups(one, None, point, n, r, friction)
        if broken := one.break_bonds(i, impulse_n):
            events = self.part(t, broken)
            more, after = self.bounce(t, i, number, wall, states, change)
            return events + more, {k: s for k, s in states.items() if k not in after} | after
        after = new_one.states()
        early, late = (np.array([s[i]]) for s in (states, after))
        return [Event(t, "wall", i, number, early, late, n, impulse_n, impulse_t)], after

    def _group_of(self, k: int, states: Mapping[int, State]) -> RigidGroup:
        return self._join({member: states[member] for member in self.find_fellows(k)})

    def _join(self, states: Mapping[int, State]) -> RigidGroup:
        bonds = {pair: strength for pair, strength in self.bonds.items() if set(pair) <= set(states)}
        return RigidGroup.join(states, self.bodies, bonds)


def _find_point(state: State, radius: float, n: Vector) -> Vector:
    return state[0] - radius * n[0], state[1] - radius * n[1]
