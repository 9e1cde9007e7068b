"""How a run begins: the states of the balls at one instant."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from synthcam.dynamics.kinematics import TOUCH_TOLERANCE, plate_state, rolling_state, slip_rate
from synthcam.model import Bodies
from synthcam_shared.arrays import Array

SPIN_COLUMNS = ("slip_along", "slip_across", "side")  # of a striker, m/s: see `Launch.pair`
NO_SPIN = (0.0, 0.0, 0.0)  # a striker that rolls


@dataclass(frozen=True)
class LaterLaunch:
    """A launch of one body in the course of a run, wherever it is then.

    body: its number.
    time: s.
    velocity: the last six numbers of its state just after.

    A hand may push it from then until the time `until` with a constant acceleration (x, y), m/s^2, or until it hits
    something.
    """

    body: int
    time: float
    velocity: tuple[float, ...]
    until: float = -math.inf
    acceleration: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Launch:
    """States (balls, 9) of `bodies` at `time`, s. Before it each ball rolled, slid all the time, or was at rest.

    later: launches of single bodies after that time.

    If balls push each other, a target that another ball touches was at rest long before, until the push pulled it off.
    Its position here is that of the contact; its velocity at the contact follows from the solution.
    """

    time: float
    states: Array
    bodies: Bodies
    later: tuple[LaterLaunch, ...] = ()

    @property
    def touches(self) -> bool:
        """Whether any ball touches another."""
        reach = self.bodies.radius[:, None] + self.bodies.radius
        gap = np.linalg.norm(self.states[:, None, :3] - self.states[:, :3], axis=-1) - reach
        return bool(np.any(gap[~np.eye(len(gap), dtype=bool)] <= TOUCH_TOLERANCE * self.bodies.radius.min()))

    @classmethod
    def pair(
        cls,
        bodies: Bodies,
        time: float,
        v0: float,
        b: float,
        heading: float,
        contact: ArrayLike,
        spin: ArrayLike = NO_SPIN,
    ) -> Self:
        """Launch ball 2 so that it touches ball 1, at rest, at `time`, s.

        v0: speed of ball 2 at the contact, m/s.
        b: impact parameter over the sum of the radii, |b| < 1. With the heading d, b = z . [d x (x2 - x1)]/(R1 + R2).
        heading: direction of ball 2 at the contact, rad from x towards y.
        contact: position (2,) between the balls at the contact, m.
        spin: (3,) of ball 2, m/s. The first two are the velocity of its lowest point, along the heading and to the left
        of it; zero if it rolls. The third is R times its spin about the vertical.
        """
        numbers = (np.array([x], dtype=float) for x in (v0, b, heading, contact, spin))
        return cls(time, np.concatenate(launch_touching_pairs(bodies[:1], bodies[1:], *numbers)), bodies)

    @classmethod
    def single(cls, bodies: Bodies, time: float, v0: float, heading: float, place: ArrayLike) -> Self:
        """Launch one ball that rolls through `place` (x, y), m, at `time`."""
        v = v0 * np.array([np.cos(heading), np.sin(heading)])
        return cls(time, rolling_state(np.array([place], dtype=float), v[None], 0.0, bodies.radius), bodies)


def launch_touching_pairs(
    one: Bodies, two: Bodies, v0: Array, b: Array, heading: Array, contact: Array, spin: Array | None = None
) -> tuple[Array, Array]:
    """Launch balls at their contacts: the states (k, 9) of targets at rest, and of strikers that touch them.

    one, two: of targets and strikers.
    v0, b, heading: (k,), the strikers' speed, m/s, impact parameter over the sum of radii, and heading, rad.
    contact: (k, 2), the position between the balls, m.
    spin: (k, 3) of the strikers, as in `Launch.pair`; without it they roll.

    Raises ValueError if balls of these sizes pass each other without touching.
    """
    d = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    apart = 2 * np.sqrt(one.radius * two.radius)  # of the centres, seen from above
    sine = -b * (one.radius + two.radius) / apart
    if np.any(np.abs(sine) >= 1):
        raise ValueError(f"b = {b[np.abs(sine).argmax()]:.6g}: balls of these sizes pass each other without touching")
    n = np.sqrt(1 - sine * sine)[:, None] * d + sine[:, None] * np.stack([-d[:, 1], d[:, 0]], axis=-1)
    share = (one.radius / (one.radius + two.radius))[:, None]
    target = rolling_state(contact + share * apart[:, None] * n, np.zeros_like(n), 0.0, one.radius)
    place, v = contact - (1 - share) * apart[:, None] * n, v0[:, None] * d
    if spin is None:
        return target, rolling_state(place, v, 0.0, two.radius)
    u = spin[:, :1] * d + spin[:, 1:2] * np.stack([-d[:, 1], d[:, 0]], axis=-1)
    q = v - u / slip_rate(two.inertia)[:, None]
    return target, plate_state(place, q, u, spin[:, 2] / two.radius, two.radius, two.inertia)
