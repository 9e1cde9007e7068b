"""How a run begins: the balls' states at one instant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from synthcam.dynamics.contact_time import TOUCHING
from synthcam.dynamics.kinematics import Array, rolling_state
from synthcam.model import Bodies


@dataclass(frozen=True)
class Launch:
    """States (balls, 9) of `bodies` at `time`, s. Before it every ball rolled or was at rest.

    Where balls push each other, one that rests while another touches it was at rest long before, until it was pulled
    off: its place here is that of the contact, its velocity then follows.
    """

    time: float
    states: Array
    bodies: Bodies

    @property
    def touches(self) -> bool:
        """Does any ball touch another?"""
        reach = self.bodies.radius[:, None] + self.bodies.radius
        gap = np.linalg.norm(self.states[:, None, :3] - self.states[:, :3], axis=-1) - reach
        return bool(np.any(gap[~np.eye(len(gap), dtype=bool)] <= TOUCHING * self.bodies.radius.min()))

    @classmethod
    def pair(cls, bodies: Bodies, time: float, v0: float, b: float, heading: float, contact: ArrayLike) -> Launch:
        """Ball 1, bodies[0], at rest is touched by the rolling ball 2 at `time`, at the place `contact` between them.

        v0 in m/s, heading in rad from x to y; b is the impact parameter over the sum of the radii, |b| < 1: with d the
        heading, b = z . [d x (x2 - x1)] / (R1 + R2). All are those of ball 2, whatever ball 1 does by then.
        """
        numbers = np.array([v0]), np.array([b]), np.array([heading])
        states = touching(bodies[:1], bodies[1:], *numbers, np.array([contact]))
        return cls(time, np.concatenate(states), bodies)

    @classmethod
    def single(cls, bodies: Bodies, time: float, v0: float, heading: float, place: ArrayLike) -> Launch:
        """One ball that rolls through `place` (x, y) at `time`."""
        v = v0 * np.array([np.cos(heading), np.sin(heading)])
        return cls(time, rolling_state(np.array([place], dtype=float), v[None], 0.0, bodies.radius), bodies)


def touching(one: Bodies, two: Bodies, v0: Array, b: Array, heading: Array, contact: Array) -> tuple[Array, Array]:
    """Place balls at their contacts: targets at rest, and strikers that roll and touch them.

    Parameters
    ----------
    one, two : Bodies
        Of targets and strikers.
    v0, b, heading : (k,) array
        The strikers' speed, m/s, impact parameter over the sum of radii, and heading, rad.
    contact : (k, 2) array
        Place between the balls, m.

    Returns
    -------
    target, striker : (k, 9) array
        States.

    Raises
    ------
    ValueError
        Where balls of these sizes pass each other without touching.
    """
    d = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    apart = 2 * np.sqrt(one.radius * two.radius)  # of the centres, seen from above
    sine = -b * (one.radius + two.radius) / apart
    if np.any(np.abs(sine) >= 1):
        raise ValueError(f"b = {b[np.abs(sine).argmax()]:.6g}: balls of these sizes pass each other without touching")
    n = np.sqrt(1 - sine * sine)[:, None] * d + sine[:, None] * np.stack([-d[:, 1], d[:, 0]], axis=-1)
    share = (one.radius / (one.radius + two.radius))[:, None]
    target = rolling_state(contact + share * apart[:, None] * n, np.zeros_like(n), 0.0, one.radius)
    striker = rolling_state(contact - (1 - share) * apart[:, None] * n, v0[:, None] * d, 0.0, two.radius)
    return target, striker
