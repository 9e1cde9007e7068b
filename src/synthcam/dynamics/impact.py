"""The two kinds of impact, both instantaneous: ball on ball (one pair or many), and ball on plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.dynamics.kinematics import Array, Real, State, apply_friction_impulse, contact_velocity
from synthcam.model import Bodies, Model

MAX_SPIN_TRANSFER = 5 / 7  # more would create energy
MIN_BOUNCE_SPEED_M_S = 1e-7  # a lower bounce, some 10 ns, and all that follow it are taken together


@dataclass(frozen=True)
class Impact:
    """The outcome of k collisions."""

    target: Array  # (k, 9) states just after
    striker: Array
    n: Array  # (k, 3) unit vectors from striker to target
    impulse_n: Array  # (k,) impulses on the target, N s
    impulse_t: Array


def collide(model: Model, target: Array, striker: Array, one: Bodies, two: Bodies) -> Impact:
    """Let k pairs collide: targets in states (k, 9), bodies `one`, and strikers, bodies `two`. See `strike`."""
    first, second = (tuple(np.ascontiguousarray(states.T)) for states in (target, striker))
    *vectors, along_n, along_t = strike(model, first, second, (one.radius, one.mass), (two.radius, two.mass))
    a, b, n = (np.stack(np.broadcast_arrays(*parts), axis=-1) for parts in vectors)
    return Impact(a, b, n, along_n, along_t)


def strike(
    model: Model, target: State, striker: State, one: tuple[Real, Real], two: tuple[Real, Real]
) -> tuple[State, State, tuple[Real, Real, Real], Real, Real]:
    """Let two balls that touch collide, by the laws `restitution`, `spin_transfer` and `loft` of the model.

    With the reduced mass m:

    - The normal impulse is P = (1 + r) v_n m along n.
    - The tangential impulse is J = (2/5) C |u_t| 2 m against u_t. This is the velocity of the striker's surface
      relative to the target's at the contact, its vertical part included.
    - The spin of both balls changes by dw = (5/2) n x J / (mass R).
    - The plate holds back the vertical impulse except for the share `loft`. The part held back spins the balls but
      lifts neither.

    C has no Coulomb limit mu P, which J exceeds at grazing hits; the effect `ball_friction` has it. A ball that leaves
    the impact with vz < 0 is pressed on the plate and lands in the same instant.

    The law of r and C is that of Painter & Behringer, Phys. Rev. E 62 (2000) 2380.

    one, two: radius, m, and mass, kg, of target and striker. Returns the states just after, the unit vector from
    striker to target, and the impulses on the target along n and along z x n, N s.
    """
    (r1, m1), (r2, m2) = one, two
    nx, ny, nz = target[0] - striker[0], target[1] - striker[1], target[2] - striker[2]
    apart = (nx * nx + ny * ny + nz * nz) ** 0.5
    nx, ny, nz = nx / apart, ny / apart, nz / apart
    ax, ay, az = striker[3] - target[3], striker[4] - target[4], striker[5] - target[5]
    v_n = ax * nx + ay * ny + az * nz
    sx, sy, sz = (r1 * target[k] + r2 * striker[k] for k in (6, 7, 8))
    ux = ax - v_n * nx + sy * nz - sz * ny
    uy = ay - v_n * ny + sz * nx - sx * nz
    uz = az - v_n * nz + sx * ny - sy * nx
    r, c = _contact_coefficients(model, v_n, (ux, uy, uz), (ax, ay), (nx, ny))
    reduced = m1 * m2 / (m1 + m2)
    normal, pull = (1 + r) * v_n * reduced, 0.8 * c * reduced
    tx, ty, tz = pull * ux, pull * uy, pull * uz  # on the target; the striker gets its opposite
    px, py, pz = normal * nx + tx, normal * ny + ty, (normal * nz + tz) * model.laws("loft", 0.0, {})
    turn = -2.5 * (ny * tz - nz * ty), -2.5 * (nz * tx - nx * tz), -2.5 * (nx * ty - ny * tx)

    def after(state: State, radius: Real, mass: Real) -> State:
        x, y, z, vx, vy, vz, wx, wy, wz = state
        size = abs(mass) * radius
        wx, wy, wz = wx + turn[0] / size, wy + turn[1] / size, wz + turn[2] / size
        return x, y, z, vx + px / mass, vy + py / mass, vz + pz / mass, wx, wy, wz

    return after(target, r1, m1), after(striker, r2, -m2), (nx, ny, nz), normal, ty * nx - tx * ny


def _contact_coefficients(
    model: Model, v_n: Real, u: tuple[Real, ...], approach: tuple[Real, Real], normal: tuple[Real, Real]
) -> tuple[Any, Any]:
    """Return restitution and spin transfer of these impacts, with the effects on them, within their limits."""
    r, c = model.restitution, model.spin_transfer
    if model.laws.has_effect_on("restitution", "spin_transfer"):
        ax, ay, nx, ny = (np.atleast_1d(x) for x in (*approach, *normal))
        speed = np.hypot(ax, ay)
        approach_direction = {
            "heading": np.stack([ax, ay], axis=-1) / speed[:, None],
            "obliqueness": abs(ax * ny - ay * nx) / speed,
        }
        r = model.laws("restitution", r, approach_direction | {"normal_speed": np.maximum(np.atleast_1d(v_n), 0.0)})
        instant = approach_direction | {
            "contact_speed": np.sqrt(sum(np.atleast_1d(x * x) for x in u)),
            "normal_impulse": np.atleast_1d((1 + r) * v_n / 2),
            "approach_speed": speed,
        }
        c = model.laws("spin_transfer", c, instant)
    if isinstance(v_n, float):
        limits = ((r, 1.0), (c, MAX_SPIN_TRANSFER))
        one, two = (min(max(float(np.ravel(x)[0]) if isinstance(x, np.ndarray) else x, 0.0), top) for x, top in limits)
        return one, two
    return np.clip(r, 0.0, 1.0), np.clip(c, 0.0, MAX_SPIN_TRANSFER)


def land(model: Model, state: Array, body: Bodies) -> Array:
    """Let balls in states (k, 9) that come down at -vz hit the plate.

    The impulse of the plate over the mass is (1 + e) |vz|, with its restitution e. Friction mu times that acts on the
    lowest point until it no longer slips. Bounces slower than MIN_BOUNCE_SPEED_M_S are summed: compared with sliding
    for the same time they lack a friction impulse of mu vz, so this impulse is smaller by as much.
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
        "of_a": body.of_a,
    }
    mu = model.laws("friction", model.sliding_friction, instant)
    up = rebound * down
    last = up < MIN_BOUNCE_SPEED_M_S
    out = apply_friction_impulse(state, mu * (down + np.where(last, 0.0, up)), body.radius)
    out[:, 2] = body.radius
    out[:, 5] = np.where(last, 0.0, up)
    return out
