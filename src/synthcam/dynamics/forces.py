"""What acts on balls that slide, roll or fly, many at once; and where a slide with a drilling spin is over.

Where a spin w drills, friction fades with the slip as F u/(u + c), c ~ |w|. A push p then keeps a slip of
u = c p/(F - p) creeping, micrometres a second, until the spin is gone, perhaps a second later. For all that can be seen
such a ball rolls, and what slows a rolling ball slows it: so a slide is over once its slip is small beside the
drilling, at `ending_slip`, and what is left of the slip ends as if nothing drilled. That slip is fixed when the slide
begins, and is the same whether the ball is solved alone or with another.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.dynamics.kinematics import Array, contact_velocity, rolling_velocity
from synthcam.model import Bodies, Model

Ints = NDArray[np.intp]
Flags = NDArray[np.bool_]
REST, ROLL, SLIDE, FLY = range(4)
STILL = 1e-12  # m/s: slower than this is rest, or rolling for a contact velocity
SLOWEST = 1e-7  # m/s: a ball slower than this has stopped
TOUCHING = 1e-12  # of a radius
FINISH = 1e-5  # of the first slip: the rest of the slide, a microsecond, is taken as a uniform deceleration
PROBE = 1e-9  # m/s: a slip at which it is seen how far a spin has friction fade
SMALL = 0.1  # of c: so small a slip beside the drilling, friction being a tenth, is no longer a slide
LAWS = {SLIDE: ("friction", "normal_load", "push", "drilling"), ROLL: ("rolling", "push"), FLY: ("push",)}
NOWHERE = np.full(2, np.inf)  # where the other ball is when there is none
TINY = 1e-300


def classify_modes(states: Array, radius: Array) -> Ints:
    """What balls in states (m, 9) do: REST, ROLL, SLIDE or FLY."""
    u = contact_velocity(states, radius)
    slips, moves = np.hypot(u[:, 0], u[:, 1]) > STILL, np.hypot(states[:, 3], states[:, 4]) > STILL
    aloft = (states[:, 5] > 0) | (states[:, 2] > radius * (1 + TOUCHING))
    return np.where(aloft, FLY, np.where(slips, SLIDE, np.where(moves, ROLL, REST)))


@dataclass(frozen=True)
class Forces:
    """What acts on m balls. known: what the laws may ask for that does not change, (m, 1) or a number."""

    model: Model
    constants: dict[str, Any]

    @classmethod
    def of(cls, model: Model, bodies: Bodies) -> Forces:
        known: dict[str, Any] = dict(gravity=model.gravity, radius=bodies.radius[:, None], mass=bodies.mass[:, None])
        return cls(model, known | dict(of_a=bodies.of_a[:, None], ball=model.ball))

    def __getitem__(self, rows: Any) -> Forces:
        return Forces(self.model, {k: v[rows] if isinstance(v, np.ndarray) else v for k, v in self.constants.items()})

    def act_on_sliding(self, slip: Array, hat: Array, spin: Any, place: Array, v: Array, other: Any) -> tuple[Any, ...]:
        """What acts on m sliding balls at n instants each.

        Parameters
        ----------
        slip : (m, n) array
            Slip speeds, m/s.
        hat : (2, m, n) array
            Their directions.
        spin : array
            About the vertical, rad/s.
        place, v : (2, m, n) array
            m and m/s.
        other : array
            Position of the other ball relative to this one, as the push may ask for it, m.

        Returns
        -------
        slowing : (m, n) array
            How fast the slip speed falls, m/s^2.
        across : (m, n) array or 0
            The push's part across the slip, hat x push.
        push : (2, m, n) array or 0
            m/s^2.
        twist : array or 0
            The change of the spin about the vertical, rad/s^2.
        """
        laws = self.model.laws
        instant = self.constants | dict(
            slip_speed=slip, slip=last_axis(hat), position=last_axis(place), velocity=last_axis(v)
        )
        instant |= dict(spin=spin, other=other)
        friction = laws("friction", self.model.sliding_friction, instant)
        load = laws("normal_load", self.model.gravity, instant)
        slowing = 3.5 * friction * load + np.zeros_like(slip)
        twist = 0.0
        if laws.has_effect_on("drilling"):
            twist = laws("drilling", 0.0, instant | {"friction": friction, "load": load})
        if not laws.has_effect_on("push"):
            return slowing, 0.0, 0.0, twist
        push = laws("push", last_axis(np.zeros_like(v)), instant).transpose(2, 0, 1)
        slowing -= push[0] * hat[0] + push[1] * hat[1]
        return slowing, hat[0] * push[1] - hat[1] * push[0], push, twist

    def accelerate_rolling(self, place: Array, v: Array, other: Any) -> Array:
        """The acceleration of rolling balls, (2, m, n)."""
        model, speed = self.model, np.hypot(v[0], v[1])
        instant = self.constants | dict(position=last_axis(place), velocity=last_axis(v), other=other, speed=speed)
        loss = model.laws("rolling", model.rolling_drag * speed + model.rolling_decel, instant)
        out = v * (-loss / np.maximum(speed, TINY))
        return np.asarray(out + 5 / 7 * self.push(place, v, other) if model.laws.has_effect_on("push") else out)

    def push(self, place: Array, v: Array, other: Any) -> Array:
        """The push on balls at these places with these velocities, (2, m, n) m/s^2."""
        instant = self.constants | dict(position=last_axis(place), velocity=last_axis(v), other=other)
        return np.asarray(self.model.laws("push", last_axis(np.zeros_like(v)), instant)).transpose(2, 0, 1)


@dataclass(frozen=True)
class BallStates:
    """Balls in states (m, 9), alone or, `each` = 2, two and two that push each other: all first ones, all second ones.

    floor (m,): slips at which a spin no longer drills, infinite if it never does. A unit is one ball, or two.
    """

    model: Model
    bodies: Bodies
    states: Array
    floor: Array
    each: int = 1

    @classmethod
    def without_drilling(cls, model: Model, bodies: Bodies, states: Array, each: int = 1) -> BallStates:
        return cls(model, bodies, states, np.full(len(states), np.inf), each)

    def __len__(self) -> int:
        return len(self.states) // self.each

    @property
    def slow(self) -> Flags:
        """Which are about to stop."""
        return np.asarray((self.modes == ROLL) & (np.hypot(self.states[:, 3], self.states[:, 4]) <= SLOWEST))

    def rows(self, units: Ints) -> Ints:
        return np.concatenate([units + k * len(self) for k in range(self.each)])

    def __getitem__(self, units: Ints) -> BallStates:
        rows = self.rows(units)
        return BallStates(self.model, self.bodies[rows], self.states[rows], self.floor[rows], self.each)

    @cached_property
    def modes(self) -> Ints:
        return classify_modes(self.states, self.bodies.radius)

    @cached_property
    def partner(self) -> Ints:
        """The other ball of each."""
        return (np.arange(len(self.states)) + len(self)) % len(self.states)

    def any_of_unit(self, flags: Flags) -> Flags:
        """Of each unit."""
        return np.asarray(flags.reshape(self.each, -1).any(axis=0))

    def min_of_unit(self, values: Array) -> Array:
        """Of each unit."""
        return np.asarray(values.reshape(self.each, -1).min(axis=0))


def find_ending_slip(model: Model, state: Array, bodies: Bodies, other: Any = NOWHERE) -> Array:
    """Where a spin drills: the slips (k,), m/s, at which slides that begin in these states (k, 9) are as good as over.

    c sqrt(SMALL^2 + (2 p/(F - p))^2), no less than FINISH of the first one: small beside the drilling, twice the creep
    at least. Infinite where the first one is no more. other: places relative to these balls, (k, 1, 2) or NOWHERE.
    """
    u, forces = contact_velocity(state, bodies.radius), Forces.of(model, bodies)
    first = np.hypot(u[:, 0], u[:, 1])
    hat, slip = (u.T / np.maximum(first, TINY))[..., None], np.full((len(state), 1), PROBE)
    v = rolling_velocity(state, bodies.radius).T[..., None] + 2 / 7 * slip * hat
    there = state[:, :2].T[..., None], v, other
    found = [forces.act_on_sliding(slip, hat, spins * state[:, 8:], *there) for spins in (0.0, 1.0)]
    push = found[0][2] + np.zeros((2, len(state), 1))
    along = push[0] * hat[0] + push[1] * hat[1]
    whole, faded = (np.maximum(slowing + along, TINY) for slowing, *_ in found)
    size = np.hypot(push[0], push[1])
    creep = size / np.maximum(whole - size, SMALL * whole)
    beside = PROBE * (whole / faded - 1) * np.sqrt(SMALL**2 + 4 * creep**2)
    late = np.maximum(beside[:, 0], FINISH * first)
    return np.where(late < first, late, np.inf)


def flight_time(model: Model, states: Array, bodies: Bodies) -> Array:
    """How long balls stay in the air, (m,)."""
    up, height = states[:, 5], np.maximum(states[:, 2] - bodies.radius, 0.0)
    return np.asarray((up + np.sqrt(up * up + 2 * model.gravity * height)) / model.gravity)


def last_axis(vectors: Array) -> Array:
    """(2, m, n) as effects want it: (m, n, 2)."""
    return vectors.transpose(1, 2, 0)
