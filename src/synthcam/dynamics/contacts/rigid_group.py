"""Bodies that stick together, on air or on a dry plate: they move as one rigid body until a hit parts them.

A hit on one of them acts at the point of contact. With the directions n and t = z x n, and

    K_n = sum of 1/M + (r x n)^2/I,   K_t = sum of 1/M + (r x t)^2/I

over both sides, mass M and moment of inertia I about the centre of mass, friction acts first. Its impulse is J = a
u_t/K_t, with a = 1 where the contact sticks. Then P = (1 + r) v_n/K_n. Neither adds energy. For two bodies alone this
is `collide_pair`.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

from synthcam.dynamics.dry_discs import DryBody, DryDisc
from synthcam.dynamics.kinematics import State
from synthcam.dynamics.supports import Air, DryPlate
from synthcam.dynamics.trajectory import CarriedLeg, Leg, Motion
from synthcam.model import Body

Vector = tuple[float, float]


@dataclass(frozen=True)
class RigidGroup:
    """Bodies that move as one, or a single body. bonds: pairs that stick, and the impulse that parts each, N s."""

    places: Mapping[int, tuple[float, float, float]]  # of the bodies' centres, m
    bonds: Mapping[tuple[int, int], float]
    mass: float
    inertia: float  # about the centre of mass, kg m^2
    centre: Vector
    velocity: Vector
    spin: float

    @classmethod
    def join(
        cls, states: Mapping[int, State], bodies: Mapping[int, Body], bonds: Mapping[tuple[int, int], float]
    ) -> Self:
        """Join bodies with these states; momentum and angular momentum stay."""
        mass = sum(bodies[k][1] for k in states)

        def mean(axis: int) -> float:
            return float(sum(bodies[k][1] * s[axis] for k, s in states.items()) / mass)

        (x, y), (vx, vy) = (mean(0), mean(1)), (mean(3), mean(4))
        turning = inertia = 0.0
        for k, s in states.items():
            radius, own, share = bodies[k]
            dx, dy, about = s[0] - x, s[1] - y, share * own * radius * radius
            inertia += about + own * (dx * dx + dy * dy)
            turning += about * s[8] + own * (dx * (s[4] - vy) - dy * (s[3] - vx))
        places = {k: (s[0], s[1], s[2]) for k, s in states.items()}
        return cls(places, bonds, mass, inertia, (x, y), (vx, vy), turning / inertia)

    def velocity_at(self, point: Sequence[float]) -> Vector:
        rx, ry = point[0] - self.centre[0], point[1] - self.centre[1]
        return self.velocity[0] - self.spin * ry, self.velocity[1] + self.spin * rx

    def yielding(self, point: Vector, along: Vector) -> float:
        """Return by how much a point moves along a direction for an impulse along it, 1/kg."""
        return 1 / self.mass + self._arm(point, along) ** 2 / self.inertia

    def push(self, point: Vector, impulse: Vector) -> Self:
        """Return the group after an impulse at a point, N s."""
        vx, vy = self.velocity[0] + impulse[0] / self.mass, self.velocity[1] + impulse[1] / self.mass
        return replace(self, velocity=(vx, vy), spin=self.spin + self._arm(point, impulse) / self.inertia)

    def _arm(self, point: Vector, along: Vector) -> float:
        return (point[0] - self.centre[0]) * along[1] - (point[1] - self.centre[1]) * along[0]

    def states(self) -> dict[int, State]:
        """Return the states of the bodies."""
        out: dict[int, State] = {}
        for k, place in self.places.items():
            out[k] = (*place, *self.velocity_at(place), 0.0, 0.0, 0.0, self.spin)
        return out

    def slide(self, plate: DryPlate, bodies: Mapping[int, Body], t: float) -> dict[int, Leg]:
        """Return the legs of discs of these radii and masses on a dry plate from the time t, s."""
        discs = [
            DryDisc(x - self.centre[0], y - self.centre[1], z, bodies[k][1], bodies[k][0])
            for k, (x, y, z) in self.places.items()
        ]
        legs = DryBody(discs, plate.slowing).legs((*self.centre, *self.velocity, self.spin), t)
        return dict(zip(self.places, legs, strict=True))

    def glide(self, air: Air, t: float) -> dict[int, Leg]:
        """Return the legs of the bodies from the time t, s: the centre of mass glides as one body on this air does."""
        state = (*self.centre, 0.0, *self.velocity, 0.0, 0.0, 0.0, self.spin)
        centre = air.leg(state, 0.0, t)
        motion: Motion = "rest" if centre.motion == "rest" and self.spin == 0 else "glide"
        legs = dict[int, Leg]()
        for k, (x, y, z) in self.places.items():
            offset = x - self.centre[0], y - self.centre[1]
            legs[k] = CarriedLeg(centre.t0, centre.t1, centre, t, offset, z, air.spin_drag, motion=motion)
        return legs

    def break_bonds(self, body: int, impulse: float) -> set[tuple[int, int]]:
        """Return the bonds of a body that an impulse on it parts."""
        return {pair for pair, strength in self.bonds.items() if body in pair and strength < impulse}


def find_meeting_velocities(
    one: RigidGroup, two: RigidGroup | None, point: Vector, n: Vector
) -> tuple[float, float, float, float]:
    """Return the velocities with which rigid groups meet, v_n and u_t (along z x n), and their factors K_n and K_t.

    n: the unit vector towards the first group. two: None for a wall.
    """
    (ax, ay), t = one.velocity_at(point), (-n[1], n[0])
    bx, by = two.velocity_at(point) if two else (0.0, 0.0)
    ux, uy = bx - ax, by - ay
    soft = [one.yielding(point, e) + (two.yielding(point, e) if two else 0.0) for e in (n, t)]
    return ux * n[0] + uy * n[1], ux * t[0] + uy * t[1], soft[0], soft[1]


def collide_groups(
    one: RigidGroup, two: RigidGroup | None, point: Vector, n: Vector, restitution: float, friction: float
) -> tuple[RigidGroup, RigidGroup | None, float, float]:
    """Let two rigid groups hit, or one a wall; return them, and the impulses on the first along n and z x n, N s.

    friction: the tangential impulse over the one that would make the contact stick.
    """
    t = (-n[1], n[0])

    def push(impulse: float, along: Vector) -> None:
        nonlocal one, two
        one = one.push(point, (impulse * along[0], impulse * along[1]))
        two = two and two.push(point, (-impulse * along[0], -impulse * along[1]))

    _, u_t, _, soft_t = find_meeting_velocities(one, two, point, n)
    impulse_t = friction * u_t / soft_t
    push(impulse_t, t)
    v_n, _, soft_n, _ = find_meeting_velocities(one, two, point, n)
    impulse_n = max((1 + restitution) * v_n / soft_n, 0.0)
    push(impulse_n, n)
    return one, two, impulse_n, impulse_t


def find_connected(bonds: Collection[tuple[int, int]], *balls: int) -> set[int]:
    """Find the bodies that bonds connect with any of these, themselves among them."""
    found = set(balls)
    while grown := {k for pair in bonds if found & set(pair) for k in pair} - found:
        found |= grown
    return found


def split_into_groups(bonds: Collection[tuple[int, int]], members: set[int]) -> list[set[int]]:
    """Split bodies into rigid groups: those that bonds connect."""
    parts = list[set[int]]()
    while members:
        parts.append(find_connected(bonds, min(members)))
        members = members - parts[-1]
    return parts
