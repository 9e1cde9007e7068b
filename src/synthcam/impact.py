"""The collision of two balls: an instant, two impulses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synthcam.model import Model
from synthcam.trajectory import Array


@dataclass(frozen=True)
class Impact:
    """Outcome of a collision. states: (2, 9) of the balls i and j just after; impulses over the mass, on i, m/s."""

    states: Array
    n: tuple[float, float]
    impulse_n: float
    impulse_t: float


def collide(model: Model, target: Array, striker: Array) -> Impact:
    """Equal balls at contact, `target` i and `striker` j, states (9,) on the plate.

    Normal: P/m = (1 + r) v_n / 2 along n, from j to i. Tangential: J/m = (2/5) C |u_t| against u_t, the velocity of
    the striker's touching surface over the target's, its vertical part included; both balls turn by
    R dw = (5/2) n x J/m. The plate takes up J's vertical part: it spins the balls and lifts neither.
    """
    radius = model.ball.radius
    n = target[:3] - striker[:3]
    n = n / np.linalg.norm(n)
    approach = striker[3:6] - target[3:6]
    v_n = float(approach @ n)
    u_t = approach - v_n * n + radius * np.cross(striker[6:9] + target[6:9], n)
    r = model.laws("restitution", model.restitution, {"normal_speed": v_n})
    c = model.laws("spin_transfer", model.spin_transfer, {"contact_speed": float(np.linalg.norm(u_t))})

    normal = (1 + min(max(float(r), 0.0), 1.0)) * v_n / 2
    tangential = 0.4 * c * u_t  # on the target; the striker gets its opposite
    kick = normal * n + tangential
    kick[2] = 0.0
    turn = -2.5 / radius * np.cross(n, tangential)
    after = np.stack([target, striker])
    after[0, 3:6] += kick
    after[1, 3:6] -= kick
    after[:, 6:9] += turn
    t = np.array([-n[1], n[0]])
    return Impact(after, (float(n[0]), float(n[1])), normal, float(tangential[:2] @ t))
