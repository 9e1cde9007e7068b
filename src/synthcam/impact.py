"""The two kinds of impact: ball on ball, and ball on plate. Instants; many at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synthcam.kinematics import Array, contact_velocity, push_back
from synthcam.model import Bodies, Model

MOST = 5 / 7  # spin transfer: more would make energy


@dataclass(frozen=True)
class Impact:
    """Outcome of collisions. target, striker: states (k, 9) just after; n (k, 3); impulses (k,) on the target, N s."""

    target: Array
    striker: Array
    n: Array
    impulse_n: Array
    impulse_t: Array


def collide(model: Model, target: Array, striker: Array, one: Bodies, two: Bodies) -> Impact:
    """Balls at contact: states (k, 9) of the targets, bodies `one`, and of the strikers, bodies `two`.

    With m the reduced mass. Normal: P = (1 + r) v_n m along n, from striker to target. Tangential:
    J = (2/5) C |u_t| 2 m against u_t, the velocity of the striker's touching surface over the target's, its vertical
    part included; both balls turn by dw = (5/2) n x J / (mass R). Of the vertical impulse the plate holds back all but
    the share `loft`: what it holds back spins the balls but lifts neither. A ball may come out with vz < 0, pressed on
    the plate: it then lands in the same instant.
    """
    n = target[:, :3] - striker[:, :3]
    n = n / np.linalg.norm(n, axis=1, keepdims=True)
    approach = striker[:, 3:6] - target[:, 3:6]
    v_n = (approach * n).sum(axis=1)
    spin = one.radius[:, None] * target[:, 6:9] + two.radius[:, None] * striker[:, 6:9]
    u_t = approach - v_n[:, None] * n + np.cross(spin, n)
    reduced = one.mass * two.mass / (one.mass + two.mass)
    heading = np.stack([approach[:, 0], approach[:, 1]], axis=-1) / np.hypot(approach[:, 0], approach[:, 1])[:, None]

    r = np.clip(
        model.laws("restitution", model.restitution, {"normal_speed": np.maximum(v_n, 0.0), "heading": heading}),
        0.0,
        1.0,
    ) * np.ones(len(n))
    instant = {
        "contact_speed": np.linalg.norm(u_t, axis=1),
        "normal_impulse": (1 + r) * v_n / 2,
        "striker_speed": np.hypot(striker[:, 3], striker[:, 4]),
    }
    c = np.clip(model.laws("spin_transfer", model.spin_transfer, instant), 0.0, MOST) * np.ones(len(n))

    normal = (1 + r) * v_n * reduced
    tangential = (0.8 * c * reduced)[:, None] * u_t  # on the target; the striker gets its opposite
    total = normal[:, None] * n + tangential
    total[:, 2] *= model.laws("loft", 0.0, {})
    turn = -2.5 * np.cross(n, tangential)
    after = []
    for state, body, sign in ((target, one, 1), (striker, two, -1)):
        new = state.copy()
        new[:, 3:6] += sign * total / body.mass[:, None]
        new[:, 6:9] += turn / (body.mass * body.radius)[:, None]
        after.append(new)
    along_t = tangential[:, 1] * n[:, 0] - tangential[:, 0] * n[:, 1]
    return Impact(after[0], after[1], n, normal, along_t)


LOWEST = 1e-7  # m/s: a bounce lower than this, some 10 ns, and all that follow it are taken together


def land(model: Model, state: Array, body: Bodies) -> Array:
    """States (k, 9) after the impact on the plate of balls that come down at -vz.

    The plate's impulse is (1 + e) |vz| a mass, with e its restitution; friction mu times that acts on the lowest
    point, until it no longer slips. Bounces that begin slower than LOWEST are summed: beside sliding for the same time
    they lack a friction impulse of mu vz, which is given back.
    """
    down = np.maximum(-state[:, 5], 0.0)
    rebound = model.laws("rebound", 0.0, {})
    u = contact_velocity(state, body.radius)
    speed = np.hypot(u[:, 0], u[:, 1])
    instant = {
        "slip_speed": speed,
        "slip": u / np.where(speed > 0, speed, 1)[:, None],
        "position": state[:, :2],
        "velocity": state[:, 3:5],
        "spin": state[:, 8],
        "radius": body.radius,
    }
    mu = model.laws("friction", model.sliding_friction, instant)
    out = push_back(state, mu * (1 + rebound) * down, body.radius)
    up = rebound * down
    last = up < LOWEST
    out = np.where(last[:, None], push_back(out, -mu * up, body.radius), out)
    out[:, 2] = body.radius
    out[:, 5] = np.where(last, 0.0, up)
    return out
