"""The two kinds of impact: ball on ball, of one pair or of many, and ball on plate. Instants."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.dynamics.kinematics import Array, Real, State, apply_friction_impulse, contact_velocity
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
    """`strike` of many pairs at once: states (k, 9) of the targets, bodies `one`, and of the strikers, bodies `two`."""
    first, second = (tuple(np.ascontiguousarray(states.T)) for states in (target, striker))
    *vectors, along_n, along_t = strike(model, first, second, (one.radius, one.mass), (two.radius, two.mass))
    a, b, n = (np.stack(np.broadcast_arrays(*parts), axis=-1) for parts in vectors)
    return Impact(a, b, n, along_n, along_t)


def strike(
    model: Model, target: State, striker: State, one: tuple[Real, Real], two: tuple[Real, Real]
) -> tuple[State, State, tuple[Real, Real, Real], Real, Real]:
    """The impact of two balls that touch.

    With m the reduced mass. Normal impulse: P = (1 + r) v_n m along n. Tangential:
    J = (2/5) C |u_t| 2 m against u_t, the velocity of the striker's touching surface over the target's, its vertical
    part included; both balls turn by dw = (5/2) n x J / (mass R). Of the vertical impulse the plate holds back all but
    the share `loft`: what it holds back spins the balls but lifts neither, as if the plate could pull too. C knows no
    Coulomb cap mu P, which J exceeds at grazing hits; `ball_friction` has it. A ball may come out with vz < 0, pressed
    on the plate: it then lands in the same instant.

    Parameters
    ----------
    model : Model
        For the laws `restitution`, `spin_transfer` and `loft`.
    target, striker : tuple of 9 floats, or of 9 arrays
        States at the contact, as in `kinematics`.
    one, two : (radius, mass)
        Of target and striker, m and kg.

    Returns
    -------
    target, striker : tuple
        States just after.
    normal : tuple of 3
        Unit vector from striker to target.
    along_n, along_t : float or array
        Impulses on the target along n and along z x n, N s.
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
    """The restitution and the spin transfer of these impacts."""
    r, c = model.restitution, model.spin_transfer
    if model.laws.has_effect_on("restitution", "spin_transfer"):
        ax, ay, nx, ny = (np.atleast_1d(x) for x in (*approach, *normal))
        speed = np.hypot(ax, ay)
        ways = {"heading": np.stack([ax, ay], axis=-1) / speed[:, None], "obliqueness": abs(ax * ny - ay * nx) / speed}
        r = model.laws("restitution", r, ways | {"normal_speed": np.maximum(np.atleast_1d(v_n), 0.0)})
        instant = ways | {
            "contact_speed": np.sqrt(sum(np.atleast_1d(x * x) for x in u)),
            "normal_impulse": np.atleast_1d((1 + r) * v_n / 2),
            "approach_speed": speed,
        }
        c = model.laws("spin_transfer", c, instant)
    limits = ((r, 1.0), (c, MOST))
    if isinstance(v_n, float):
        one, two = (min(max(float(np.ravel(x)[0]) if isinstance(x, np.ndarray) else x, 0.0), top) for x, top in limits)
        return one, two
    return np.clip(r, 0.0, 1.0), np.clip(c, 0.0, MOST)


LOWEST = 1e-7  # m/s: a bounce lower than this, some 10 ns, and all that follow it are taken together


def land(model: Model, state: Array, body: Bodies) -> Array:
    """States (k, 9) after the impact on the plate of balls that come down at -vz.

    The plate's impulse is (1 + e) |vz| a mass, with e its restitution; friction mu times that acts on the lowest
    point, until it no longer slips. Bounces that begin slower than LOWEST are summed: beside sliding for the same time
    they lack a friction impulse of mu vz, which this one is the smaller by.
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
    last = up < LOWEST
    out = apply_friction_impulse(state, mu * (down + np.where(last, 0.0, up)), body.radius)
    out[:, 2] = body.radius
    out[:, 5] = np.where(last, 0.0, up)
    return out
