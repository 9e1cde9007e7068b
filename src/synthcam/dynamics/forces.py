"""Decide whether balls rest, roll, slide or fly, and compute the forces on them, many at once.

With a drilling spin w, friction fades with the slip u as F u/(u + c), with c proportional to |w|. A push p then keeps
up a slip of u = c p/(F - p), micrometres per second. It lasts until the spin is gone, perhaps a second later. In every
observable such a ball rolls, and the rolling loss slows it. A slide is therefore over once its slip is small compared
with the drilling (`find_ending_slip`); the remaining slip ends as without drilling. That slip is fixed when the slide
begins, and does not depend on whether the ball is solved alone or with another.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np

from synthcam.dynamics.kinematics import TOUCH_TOLERANCE, contact_velocity, push_share, rolling_velocity, slip_rate
from synthcam.model import Bodies, Model
from synthcam_shared.arrays import Array, Flags, Index

REST, ROLL, SLIDE, FLY = range(4)
ZERO_SPEED_M_S = 1e-12  # slower is rest, or rolling for a contact velocity
STOP_SPEED_M_S = 1e-7  # a rolling ball slower than this has stopped
END_SLIP_SHARE = 1e-5  # of the first slip: the rest of the slide, a microsecond, is a uniform deceleration
MOTION_PARAMETERS = ("sliding_friction", "rolling_drag", "rolling_decel")  # of the base model, between impacts
LAWS = {SLIDE: ("friction", "normal_load", "push", "drilling"), ROLL: ("rolling", "push"), FLY: ("push",)}
NOWHERE = np.full(2, np.inf)  # position of the other ball where there is none
TINY = 1e-300  # keeps quotients finite


def classify_modes(states: Array, radius: Array) -> Index:
    """Return REST, ROLL, SLIDE or FLY for balls in states (m, 9)."""
    x, y, vx, vy = *contact_velocity(states, radius).T, states[:, 3], states[:, 4]
    slips, moves = x * x + y * y > ZERO_SPEED_M_S**2, vx * vx + vy * vy > ZERO_SPEED_M_S**2  # quicker than hypot
    aloft = (states[:, 5] > 0) | (states[:, 2] > radius * (1 + TOUCH_TOLERANCE))
    modes = np.where(moves, ROLL, REST)
    modes[slips], modes[aloft] = SLIDE, FLY
    return modes


@dataclass(frozen=True)
class Forces:
    """The forces on m balls.

    constants: inputs of the laws that do not change with time; base: friction and rolling loss without effects; both
    (m, 1) or a number.
    """

    model: Model
    constants: dict[str, Any]
    base: dict[str, Any]
    inertia: Array  # (m, 1)

    @classmethod
    def of(cls, model: Model, bodies: Bodies) -> Self:
        known: dict[str, Any] = dict(gravity=model.gravity, radius=bodies.radius[:, None], mass=bodies.mass[:, None])
        base: dict[str, Any] = {name: getattr(model, name) for name in MOTION_PARAMETERS}
        base |= {name: values[:, None] for name, values in bodies.base.items()}
        return cls(model, known | dict(of_a=bodies.of_a[:, None], ball=model.ball), base, bodies.inertia[:, None])

    @cached_property
    def slip_rate(self) -> Array:
        return np.asarray(slip_rate(self.inertia))

    @cached_property
    def push_share(self) -> Array:
        return np.asarray(push_share(self.inertia))

    def __getitem__(self, rows: Any) -> Self:
        constants, base = (
            {k: v[rows] if isinstance(v, np.ndarray) else v for k, v in values.items()}
            for values in (self.constants, self.base)
        )
        return type(self)(self.model, constants, base, self.inertia[rows])

    def list_inputs(self, place: Array, v: Array, other: Any, **more: Any) -> dict[str, Any]:
        """List the inputs of laws by name. place, v: (2, m, n), m and m/s; other: as of `act_on_sliding`."""
        vectors = {"position": move_vectors_to_last_axis(place), "velocity": move_vectors_to_last_axis(v)}
        return self.constants | vectors | {"other": other} | more

    def act_on_sliding(self, slip: Array, hat: Array, spin: Any, place: Array, v: Array, other: Any) -> tuple[Any, ...]:
        """Evaluate the forces on m sliding balls at n instants each.

        slip, hat: (m, n) slip speeds, m/s, and their directions (2, m, n).
        spin: about the vertical, rad/s.
        place, v: (2, m, n), m and m/s.
        other: position of the other ball relative to this one, m.

        Returns

        - slowing (m, n): the rate at which the slip speed falls, m/s^2;
        - across (m, n) or 0: the component of the push across the slip, hat x push;
        - push (2, m, n) or 0, m/s^2;
        - twist: the rate of change of the spin about the vertical, rad/s^2.
        """
        laws = self.model.laws
        instant = self.list_inputs(place, v, other, spin=spin, slip_speed=slip, slip=move_vectors_to_last_axis(hat))
        friction = laws("friction", self.base["sliding_friction"], instant)
        load = laws("normal_load", self.model.gravity, instant)
        slowing = self.slip_rate * friction * load + np.zeros_like(slip)
        twist = 0.0
        if laws.has_effect_on("drilling"):
            twist = laws("drilling", 0.0, instant | {"friction": friction, "load": load})
        if not laws.has_effect_on("push"):
            return slowing, 0.0, 0.0, twist
        push = laws("push", move_vectors_to_last_axis(np.zeros_like(v)), instant).transpose(2, 0, 1)
        slowing -= push[0] * hat[0] + push[1] * hat[1]
        return slowing, hat[0] * push[1] - hat[1] * push[0], push, twist

    def accelerate_rolling(self, place: Array, v: Array, other: Any) -> Array:
        """Return the acceleration of rolling balls, (2, m, n) m/s^2."""
        model, speed = self.model, np.hypot(v[0], v[1])
        plain = self.base["rolling_drag"] * speed + self.base["rolling_decel"]
        loss = model.laws("rolling", plain, self.list_inputs(place, v, other, speed=speed))
        out = v * (-loss / np.maximum(speed, TINY))
        if model.laws.has_effect_on("push"):
            out = out + self.push_share * self.push(place, v, other)
        return np.asarray(out)

    def push(self, place: Array, v: Array, other: Any) -> Array:
        """Return the push on balls at these positions with these velocities, (2, m, n) m/s^2."""
        nothing, instant = move_vectors_to_last_axis(np.zeros_like(v)), self.list_inputs(place, v, other)
        return np.asarray(self.model.laws("push", nothing, instant)).transpose(2, 0, 1)


@dataclass(frozen=True)
class BallStates:
    """Balls in states (m, 9): each alone, or, with `each` = 2, pairs that push each other.

    A unit is one ball or one pair. Rows hold the first balls of all pairs, then the second ones. floor (m,): the slip
    at which a spin no longer drills, infinite if it never does.
    """

    model: Model
    bodies: Bodies
    states: Array
    floor: Array
    each: int = 1

    @classmethod
    def without_drilling(cls, model: Model, bodies: Bodies, states: Array, each: int = 1) -> Self:
        return cls(model, bodies, states, np.full(len(states), np.inf), each)

    def __len__(self) -> int:
        return len(self.states) // self.each

    @property
    def slow(self) -> Flags:
        """Which balls are about to stop."""
        return np.asarray((self.modes == ROLL) & (np.hypot(self.states[:, 3], self.states[:, 4]) <= STOP_SPEED_M_S))

    def rows(self, units: Index) -> Index:
        return np.concatenate([units + k * len(self) for k in range(self.each)])

    def __getitem__(self, units: Index) -> Self:
        rows = self.rows(units)
        return type(self)(self.model, self.bodies[rows], self.states[rows], self.floor[rows], self.each)

    @cached_property
    def modes(self) -> Index:
        return classify_modes(self.states, self.bodies.radius)

    @cached_property
    def partner(self) -> Index:
        """The row of the other ball of each pair."""
        return (np.arange(len(self.states)) + len(self)) % len(self.states)

    def any_of_unit(self, flags: Flags) -> Flags:
        """Tell whether the flag of any ball of each unit is set."""
        return np.asarray(flags.reshape(self.each, -1).any(axis=0))

    def min_of_unit(self, values: Array) -> Array:
        """Return the smaller value of each unit."""
        return np.asarray(values.reshape(self.each, -1).min(axis=0))


def find_ending_slip(model: Model, state: Array, bodies: Bodies, other: Any = NOWHERE) -> Array:
    """Find the slips (k,), m/s, at which slides beside a drilling spin are over (see the head of this file).

    That is c sqrt(0.1^2 + (2 p/(F - p))^2). It is small compared with the drilling, and at least twice the steady slip
    that the push p keeps up. It is no less than END_SLIP_SHARE of the first slip, and infinite where the first slip is
    smaller.

    state: (k, 9), at the beginning of the slides. other: (k, 1, 2), positions of the other balls relative to these, m.
    """
    probe = 1e-9  # m/s: so slow a slip shows how far the spin makes friction fade
    small = 0.1  # of c: with so small a slip, friction is a tenth and the slide is over
    u, forces = contact_velocity(state, bodies.radius), Forces.of(model, bodies)
    first = np.hypot(u[:, 0], u[:, 1])
    hat, slip = (u.T / np.maximum(first, TINY))[..., None], np.full((len(state), 1), probe)
    inertia = bodies.inertia
    v = rolling_velocity(state, bodies.radius, inertia).T[..., None] + 1 / slip_rate(inertia)[:, None] * slip * hat
    there = state[:, :2].T[..., None], v, other
    found = [forces.act_on_sliding(slip, hat, spins * state[:, 8:], *there) for spins in (0.0, 1.0)]
    push = found[0][2] + np.zeros((2, len(state), 1))
    along = push[0] * hat[0] + push[1] * hat[1]
    whole, faded = (np.maximum(slowing + along, TINY) for slowing, *_ in found)
    size = np.hypot(push[0], push[1])
    creep = size / np.maximum(whole - size, small * whole)
    beside = probe * (whole / faded - 1) * np.sqrt(small**2 + 4 * creep**2)
    late = np.maximum(beside[:, 0], END_SLIP_SHARE * first)
    return np.where(late < first, late, np.inf)


def move_vectors_to_last_axis(vectors: Array) -> Array:
    """Turn the vectors of forces (2, m, n) into (m, n, 2), as effects take them."""
    return vectors.transpose(1, 2, 0)
