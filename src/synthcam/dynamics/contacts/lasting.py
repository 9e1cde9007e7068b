"""Contacts that last: a spring with a damper between two bodies, while the plate or the air acts on both.

The force F along the line of the centres depends on the overlap h and its rate h', with the reduced mass m:

- linear: F = m [(w^2 + g^2) h + 2 g h'], with w = pi/T and g = -ln(r)/T. Alone, it lasts for T and returns the share r
  of the speed.
- hertz: F = K h^(3/2) + a sqrt(m K) h^(1/4) h', with K = 4/3 E* sqrt(R*) and a = -sqrt(5) ln r/sqrt(pi^2 + ln^2 r).
  Alone, it returns the share r at any speed (Antypov & Elliott, Europhys. Lett. 94 (2011) 50004). Without damping it
  lasts for 2.868 (m^2/(R* E*^2 v))^(1/5).

The impulses are those of `collide_pair`, handed out as F is: in the time dt, the share F dt/P of them. So r and the
friction between the bodies are those of the model, and the contact becomes `collide_pair` as its duration goes to zero.
The line of the centres may turn meanwhile. The weight alone presses a ball on the plate, and its rolling loss is left
out.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from synthcam.dynamics.contacts.rigid_group import find_connected, split_into_groups
from synthcam.dynamics.forces import Forces
from synthcam.dynamics.kinematics import State, contact_velocity, slip_rate
from synthcam.dynamics.supports import Support
from synthcam.dynamics.trajectory import Leg, NumericLeg
from synthcam.model import Bodies, Model
from synthcam_shared.arrays import Array

STICKING_M_S = 1e-6  # friction of the plate fades at slips below it


@dataclass(frozen=True)
class ContactSpring:
    """The spring of every contact of two bodies."""

    law: Literal["linear", "hertz"] = "linear"
    duration: float = 1e-4  # T of the linear spring, s
    modulus: float = 1e9  # E* of the Hertz spring, Pa: (1 - nu1^2)/E1 + (1 - nu2^2)/E2 is its inverse

    def stiffness(self, mass: float, radius: float, r: float) -> tuple[float, float]:
        """Return the factors of the spring and of the damper: masses and radii are reduced ones."""
        loss = -math.log(max(r, 1e-6))
        if self.law == "linear":
            damping = loss / self.duration
            return mass * ((math.pi / self.duration) ** 2 + damping**2), 2 * mass * damping
        stiff = 4 / 3 * self.modulus * math.sqrt(radius)
        return stiff, math.sqrt(5) * loss / math.hypot(math.pi, loss) * math.sqrt(mass * stiff)

    def lasts(self, mass: float, stiff: float, v: float) -> float:
        """Return how long a contact at the speed v lasts without damping, s."""
        if self.law == "linear":
            return self.duration
        deepest = math.pow(5 * mass * v * v / (4 * stiff), 0.4)
        return 2.943 * deepest / v  # Hertz

    def force(self, factors: tuple[float, float], overlap: Any, rate: Any) -> Any:
        if self.law == "linear":
            return factors[0] * overlap + factors[1] * rate
        deep = np.maximum(overlap, 0.0)
        return factors[0] * deep**1.5 + factors[1] * deep**0.25 * rate


@dataclass(frozen=True)
class SpringContact:
    """One contact: bodies i, the target, and j; what the impact would change; and the number of its event."""

    i: int
    j: int
    factors: tuple[float, float]
    lasts: float  # alone, s
    reach: float
    angle: float  # of the normal at its beginning, rad
    changes: tuple[Array, Array]  # (6,) of velocity and spin of i and j for a unit of `whole`, with the normal along x
    impulses: tuple[float, float]  # of the impact, along n and z x n, N s
    whole: float  # the horizontal part of the first, N s
    event: int
    given: float = 0.0  # of `whole`, so far


def _turn(vectors: Array, angle: Any) -> Array:
    """Turn the horizontal parts of a velocity and a spin (6,) about the vertical."""
    (vx, vy, vz, wx, wy, wz), c, s = vectors, math.cos(angle), math.sin(angle)
    return np.array([c * vx - s * vy, s * vx + c * vy, vz, c * wx - s * wy, s * wx + c * wy, wz])


@dataclass(frozen=True)
class TouchingGroup:
    """Bodies that lasting contacts connect, from the time t, s, until the first of these contacts ends.

    members: their numbers, in the order of the rows. ended: numbers of the contacts that end at t1.
    """

    members: tuple[int, ...]
    contacts: tuple[SpringContact, ...]
    t: float
    t1: float
    solution: Any  # of scipy: maps times since t (n,) to (9 m + contacts, n), with the normal impulses so far, N s
    ended: tuple[int, ...]

    def impulses(self, t: float) -> list[float]:
        """Return the normal impulse of each contact so far, N s."""
        given = self.solution(np.array([t]) - self.t)[9 * len(self.members) :, 0]
        return given.tolist()  # type: ignore[no-any-return]

    def legs(self, on_plate: Sequence[bool]) -> dict[int, Leg]:
        def states(row: int, t: Array) -> Array:
            return np.asarray(self.solution(t - self.t)[9 * row : 9 * row + 9].T)

        legs = dict[int, Leg]()
        for row, (k, plate) in enumerate(zip(self.members, on_plate, strict=True)):
            legs[k] = NumericLeg.of(self.t, self.t1, "slide" if plate else "glide", partial(states, row))
        return legs


class TouchingBodies:
    """The bodies of a run that are in contact at present."""

    def __init__(self, model: Model, bodies: Bodies, spring: ContactSpring) -> None:
        self.model, self.bodies, self.spring = model, bodies, spring
        self.contacts: list[SpringContact] = []
        self.groups: dict[int, TouchingGroup] = {}

    @property
    def joined(self) -> set[tuple[int, int]]:
        return {(min(c.i, c.j), max(c.i, c.j)) for c in self.contacts}

    def find_fellows(self, *balls: int) -> set[int]:
        """Return the bodies that contacts connect with any of these, themselves among them."""
        return find_connected(self.joined, *balls)

    def begin(
        self,
        i: int,
        j: int,
        befores: tuple[State, State],
        afters: tuple[State, State],
        impulses: tuple[float, float],
        event: int,
    ) -> None:
        """Begin the contact of two bodies from what `collide_pair` gives: states, and impulses along n and z x n, N s.

        event: the number of its event.
        """
        own = self.bodies[[i, j]]
        apart = np.subtract(befores[0], befores[1])
        reach, angle = math.hypot(apart[0], apart[1]), math.atan2(apart[1], apart[0])
        mass, radius = float(own.mass.prod() / own.mass.sum()), float(own.radius.prod() / own.radius.sum())
        n = np.array([math.cos(angle), math.sin(angle)])
        v_n, parting = -float(apart[3:5] @ n), float(np.subtract(afters[0], afters[1])[3:5] @ n)
        whole = (v_n + parting) * mass
        gains = (np.subtract(after, before)[3:] / whole for before, after in zip(befores, afters, strict=True))
        one, two = (_turn(gain, -angle) for gain in gains)
        factors = self.spring.stiffness(mass, radius, parting / v_n)
        lasts = self.spring.lasts(mass, factors[0], v_n)
        self.contacts.append(SpringContact(i, j, factors, lasts, reach, angle, (one, two), impulses, whole, event))

    def legs(self, states: dict[int, State], supports: Sequence[Support | None], t: float) -> dict[int, Leg]:
        """Return new legs of those of these bodies that are in contact."""
        out: dict[int, Leg] = {}
        in_contact = {k for pair in self.joined for k in pair} & set(states)
        self._keep_impulses(in_contact, t)
        for part in split_into_groups(self.joined, in_contact):
            contacts = [c for c in self.contacts if c.i in part]
            own = {k: states[k] for k in part}
            group = _follow_contacts(_GroupForces(self, sorted(own), contacts, supports), own, t)
            self.groups |= dict.fromkeys(part, group)
            out |= group.legs([supports[k] is None for k in group.members])
        return out

    def _keep_impulses(self, balls: set[int], t: float) -> None:
        """Keep the impulses so far of the contacts of these bodies, whose motion is to be integrated again."""
        for group in {id(g): g for k in balls if (g := self.groups.pop(k, None))}.values():
            now = dict(zip((c.event for c in group.contacts), group.impulses(min(t, group.t1)), strict=True))
            self.contacts = [replace(c, given=now.get(c.event, c.given)) for c in self.contacts]

    def finish(self, k: int) -> list[SpringContact]:
        """End the contacts that end when the motion of a body's group does; returns them."""
        group = self.groups[k]
        self._keep_impulses(set(group.members), group.t1)
        over = {group.contacts[number].event for number in group.ended}
        ended = [c for c in self.contacts if c.event in over]
        self.contacts = [c for c in self.contacts if c.event not in over]
        return ended


class _GroupForces:
    """What accelerates the bodies of a group, whose states are rows (m, 9) in the order of `members`."""

    def __init__(
        self,
        touching: TouchingBodies,
        members: Sequence[int],
        contacts: Sequence[SpringContact],
        supports: Sequence[Support | None],
    ) -> None:
        self.spring, self.contacts = touching.spring, contacts
        self.row = {k: row for row, k in enumerate(members)}
        self.bodies, self.supports = touching.bodies[list(members)], [supports[k] for k in members]
        self.on_plate = np.array([support is None for support in self.supports])
        own = self.bodies[np.flatnonzero(self.on_plate)]
        self.forces = Forces.of(touching.model, own) if self.on_plate.any() else None

    def carry(self, now: Array) -> Array:
        """Return the accelerations (m, 6) of velocities and spins by plate and air."""
        out, plate, radius = np.zeros((len(now), 6)), self.on_plate, self.bodies.radius
        if self.forces is not None:
            out[plate] = _slide(self.forces, now[plate], radius[plate], self.bodies.inertia[plate])
        for row, support in enumerate(self.supports):
            if support is not None:
                ax, ay, turning = support.accelerate(tuple(now[row].tolist()), float(radius[row]))
                out[row, [0, 1, 5]] = ax, ay, turning
        return out

    def press(self, now: Array, contact: SpringContact) -> tuple[float, float, float]:
        """Return force, overlap and the angle of the normal."""
        x, y, _, vx, vy, *_ = now[self.row[contact.i]] - now[self.row[contact.j]]
        far = math.hypot(x, y)
        overlap, rate = contact.reach - far, -(x * vx + y * vy) / far
        return float(self.spring.force(contact.factors, overlap, rate)), overlap, math.atan2(y, x)

    def change(self, _: float, y: Array) -> Array:
        """Return the rates of states and normal impulses (9 m + contacts,)."""
        now, given = y[: 9 * len(self.row)].reshape(-1, 9), np.zeros(len(self.contacts))
        rates = np.zeros_like(now)
        rates[:, :2], rates[:, 3:] = now[:, 3:5], self.carry(now)
        for number, contact in enumerate(self.contacts):
            force, _, angle = self.press(now, contact)
            given[number] = force
            for k, change in zip((contact.i, contact.j), contact.changes, strict=True):
                rates[self.row[k], 3:] += force * _turn(change, angle)
        return np.concatenate([rates.ravel(), given])

    def find_end(self, contact: SpringContact) -> Any:
        """Return the event of `solve_ivp` at which a contact ends."""
        end_gap = 1e-10  # over the reach: many contacts begin without overlap and almost without speed

        def overlap(_: float, y: Array) -> float:
            overlapping = self.press(y[: 9 * len(self.row)].reshape(-1, 9), contact)[1]
            return overlapping + end_gap * contact.reach

        overlap.terminal, overlap.direction = True, -1  # type: ignore[attr-defined]
        return overlap


def _follow_contacts(forces: _GroupForces, states: dict[int, State], t: float) -> TouchingGroup:
    """Integrate the bodies of a group from their states at the time t, s, until one of its contacts ends."""
    from scipy.integrate import solve_ivp  # here alone: slow to load

    contacts, members = tuple(forces.contacts), tuple(forces.row)
    longest = 20.0 * max(c.lasts for c in contacts)  # at most, s: contacts of a group may last longer than alone
    step = min(c.lasts for c in contacts) / 10
    first = np.concatenate([np.array([states[k] for k in members]).ravel(), [c.given for c in contacts]])
    how: Any = {"method": "LSODA", "rtol": 1e-9, "atol": 1e-14, "max_step": step, "dense_output": True}
    events = [forces.find_end(contact) for contact in contacts]
    done = solve_ivp(forces.change, (0.0, longest), first, events=events, **how)
    if not done.success or done.t_events is None:
        raise ValueError(f"a contact that lasts cannot be followed beyond {t + done.t[-1]:.6g} s: {done.message}")
    ended = tuple(number for number, times in enumerate(done.t_events) if len(times))
    return TouchingGroup(members, contacts, t, t + float(done.t[-1]), done.sol, ended)


def _slide(forces: Forces, states: Array, radius: Array, inertia: Array) -> Array:
    """Return the accelerations (m, 6) of balls that the plate rubs."""
    u, v, place = contact_velocity(states, radius).T[..., None], states[:, 3:5].T[..., None], states[:, :2].T[..., None]
    slip = np.sqrt(u[0] ** 2 + u[1] ** 2 + STICKING_M_S**2)
    hat = u / slip
    slowing, _, push, twist = forces.act_on_sliding(slip, hat, states[:, 8:], place, v, np.full(2, np.inf))
    push = push + np.zeros_like(v)
    rub = -hat * (slowing + push[0] * hat[0] + push[1] * hat[1]) / slip_rate(inertia)[:, None]
    out, turn = np.zeros((len(states), 6)), 1 / (inertia * radius)
    out[:, :2] = (rub + push)[..., 0].T
    out[:, 3], out[:, 4], out[:, 5] = turn * rub[1, :, 0], -turn * rub[0, :, 0], np.ravel(twist + 0 * slip)
    return out
