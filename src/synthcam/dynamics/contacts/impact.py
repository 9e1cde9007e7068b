"""The kinds of impact, all instantaneous: ball on ball (one pair or many), ball on wall, and ball on plate."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from synthcam.dynamics.contacts.cushion import press_cushion
from synthcam.dynamics.contacts.walls import Wall, WallImpact
from synthcam.dynamics.kinematics import Real, State, apply_friction_impulse, contact_velocity, push_share, slip_rate
from synthcam.model import Bodies, Body, Model
from synthcam_shared.arrays import Array

MIN_BOUNCE_SPEED_M_S = 1e-7  # a lower bounce, some 10 ns, and all that follow it are taken together


@dataclass(frozen=True)
class Impact:
    """The outcome of k collisions."""

    target: Array  # (k, 9) states just after
    striker: Array
    n: Array  # (k, 3) unit vectors from striker to target
    impulse_n: Array  # (k,) impulses on the target, N s
    impulse_t: Array


@dataclass(frozen=True)
class ImpactChange:
    """Changes of one impact: by chance, by a contact duration, and by the plate."""

    restitution: float = 0.0  # added to r
    friction: float = 1.0  # factor on the tangential impulse
    turn: float = 0.0  # of the normal about the vertical, rad
    elastic: bool = False
    slowest: float = 0.0  # the bodies part at least at this speed, m/s
    plate_share: float = 0.0  # of the momentum of both, which the plate takes
    drawn: Mapping[str, float] = field(default_factory=dict)  # what was drawn, by the names of events.parquet

    def change_restitution(self, r: float, v_n: float) -> float:
        changed = r + self.restitution if self.restitution else r
        return max(1.0 if self.elastic else min(max(changed, 0.0), 1.0), self.slowest / v_n)

    def turn_normal(self, nx: float, ny: float, ax: float, ay: float) -> tuple[float, float]:
        """Turn a normal, unless the balls, with the relative velocity (ax, ay), would then not approach along it."""
        c, s = math.cos(self.turn), math.sin(self.turn)
        new = c * nx - s * ny, s * nx + c * ny
        return new if ax * new[0] + ay * new[1] > 0 else (nx, ny)


def collide_pairs(model: Model, target: Array, striker: Array, one: Bodies, two: Bodies) -> Impact:
    """Let k pairs collide: targets in states (k, 9), bodies `one`, and strikers, bodies `two`. See `collide_pair`."""
    first, second = (tuple(np.ascontiguousarray(states.T)) for states in (target, striker))
    own, other = ((bodies.radius, bodies.mass, bodies.inertia) for bodies in (one, two))
    *vectors, along_n, along_t = collide_pair(model, first, second, own, other)
    a, b, n = (np.stack(np.broadcast_arrays(*parts), axis=-1) for parts in vectors)
    return Impact(a, b, n, along_n, along_t)


def collide_pair(
    model: Model, target: State, striker: State, one: Body, two: Body, change: ImpactChange | None = None
) -> tuple[State, State, tuple[Real, Real, Real], Real, Real]:
    """Let two balls that touch collide, by the laws `restitution`, `spin_transfer` and `loft` of the model.

    With the reduced mass m and k = I/(m R^2), 2/5 for solid balls:

    - The normal impulse is P = (1 + r) v_n m along n.
    - The tangential impulse is J = k C |u_t| 2 m against u_t. This is the velocity of the striker's surface
      relative to the target's at the contact, its vertical part included.
    - The spin of both balls changes by dw = n x J / (k mass R). With two values of k,
      J has the k of `combine_inertia_factors`.
    - The plate holds back the vertical impulse except for the share `loft`. The part held back spins the balls but
      lifts neither.

    C has no Coulomb limit mu P, which J exceeds at grazing hits; the effect `ball_friction` has it. A ball that leaves
    the impact with vz < 0 is pressed on the plate and lands in the same instant.

    The law of r and C is that of Painter & Behringer, Phys. Rev. E 62 (2000) 2380.

    one, two: target and striker. change: of this impact, for floats alone. Returns the states just after, the unit
    vector n from striker to target, and the impulses on the target along n and z x n, N s.
    """
    (r1, m1, k1), (r2, m2, k2) = one, two
    nx, ny, nz = target[0] - striker[0], target[1] - striker[1], target[2] - striker[2]
    apart = (nx * nx + ny * ny + nz * nz) ** 0.5
    nx, ny, nz = nx / apart, ny / apart, nz / apart
    if change and change.turn:
        nx, ny = change.turn_normal(nx, ny, striker[3] - target[3], striker[4] - target[4])
    ax, ay, az = striker[3] - target[3], striker[4] - target[4], striker[5] - target[5]
    v_n = ax * nx + ay * ny + az * nz
    sx, sy, sz = r1 * target[6] + r2 * striker[6], r1 * target[7] + r2 * striker[7], r1 * target[8] + r2 * striker[8]
    ux = ax - v_n * nx + sy * nz - sz * ny
    uy = ay - v_n * ny + sz * nx - sx * nz
    uz = az - v_n * nz + sx * ny - sy * nx
    inertia = combine_inertia_factors(k1, m1, k2, m2)
    r, c = find_contact_coefficients(model, v_n, (ux, uy, uz), (ax, ay), (nx, ny), inertia)
    if change:
        r, c = change.change_restitution(r, v_n), c * change.friction
    reduced = m1 * m2 / (m1 + m2)
    normal, pull = (1 + r) * v_n * reduced, 2 * inertia * c * reduced
    tx, ty, tz = pull * ux, pull * uy, pull * uz  # on the target; the striker gets its opposite
    px, py, pz = normal * nx + tx, normal * ny + ty, (normal * nz + tz) * model.laws("loft", 0.0, {})
    along, across, up = nz * ty - ny * tz, nx * tz - nz * tx, ny * tx - nx * ty  # n x J
    lost_x = lost_y = 0.0
    if change and change.plate_share:
        share = change.plate_share / (m1 + m2)
        lost_x, lost_y = share * (m1 * target[3] + m2 * striker[3]), share * (m1 * target[4] + m2 * striker[4])

    def after(state: State, radius: Real, mass: Real, inertia: Real) -> State:
        x, y, z, vx, vy, vz, wx, wy, wz = state
        inverse, size = 1 / inertia, abs(mass) * radius
        spin = wx + inverse * along / size, wy + inverse * across / size, wz + inverse * up / size
        return x, y, z, vx + px / mass - lost_x, vy + py / mass - lost_y, vz + pz / mass, *spin

    return after(target, r1, m1, k1), after(striker, r2, -m2, k2), (nx, ny, nz), normal, ty * nx - tx * ny


def hit_wall(model: Model, wall: Wall, ball: State, body: Body, change: ImpactChange | None = None) -> WallImpact:
    """Let a ball hit a wall that it touches.

    The normal points from the wall to the ball's centre, downwards where the wall touches above it. With k = I/(m R^2):

    - The normal impulse is P = (1 + e) m v_n.
    - The tangential impulse is J = min(mu P, (1 + beta) m |u|/(1 + 1/k)) against u, the velocity of the ball's surface.
    - The plate holds back the vertical impulse except for the share `loft`, as in `collide_pair`.

    For a cushion this is the law of I. Han, J. Mech. Sci. Technol. 19 (2005) 976, with beta = 0. `press_cushion` has
    the other law of cushions.

    change: as in `collide_pair`.
    """
    (radius, mass, inertia), (x, y, z, vx, vy, vz, wx, wy, wz) = body, ball
    _, ax, ay = wall.distance(x, y)
    nz = -wall.rise(radius)
    level = (1 - nz * nz) ** 0.5
    nx, ny = level * ax, level * ay
    v_n = -(vx * nx + vy * ny + vz * nz)
    ux = vx + v_n * nx - radius * (wy * nz - wz * ny)
    uy = vy + v_n * ny - radius * (wz * nx - wx * nz)
    uz = vz + v_n * nz - radius * (wx * ny - wy * nx)
    r = change.change_restitution(wall.restitution, v_n) if change else wall.restitution
    if wall.cushion == "mathavan":
        return press_cushion(wall, model.sliding_friction, ball, body, r)
    slip, normal = (ux * ux + uy * uy + uz * uz) ** 0.5, (1 + r) * v_n  # impulses over the mass
    stick = (1 + wall.tangential_restitution) / slip_rate(inertia)
    pull = -(min(stick, wall.friction * normal / slip) if slip > 0 else 0.0)
    tx, ty, tz = pull * ux, pull * uy, pull * uz
    loft, turn = float(model.laws("loft", 0.0, {})), 1 / (inertia * radius)
    after = (
        *(x, y, z, vx + normal * nx + tx, vy + normal * ny + ty, vz + loft * (normal * nz + tz)),
        *(wx + turn * (nz * ty - ny * tz), wy + turn * (nx * tz - nz * tx), wz + turn * (ny * tx - nx * ty)),
    )
    return WallImpact(after, (ax, ay), mass * normal, mass * (ax * ty - ay * tx))


def combine_inertia_factors(k1: Real, m1: Real, k2: Real, m2: Real) -> Real:
    """Return the factor k of an impact, k1 k2 (m1 + m2)/(m1 k1 + m2 k2); exactly k where both bodies have one."""
    return k1 + (k2 - k1) * (k1 * m1 / (m1 * k1 + m2 * k2))


def find_contact_coefficients(
    model: Model, v_n: Real, u: tuple[Real, ...], approach: tuple[Real, Real], normal: tuple[Real, Real], inertia: Real
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
        slip, impulse = np.sqrt(sum(np.atleast_1d(x * x) for x in u)), np.atleast_1d((1 + r) * v_n / 2)
        instant = approach_direction | {"contact_speed": slip, "normal_impulse": impulse, "approach_speed": speed}
        c = model.laws("spin_transfer", c, instant | {"inertia": inertia})
        if isinstance(v_n, float):
            r, c = (float(np.ravel(x)[0]) for x in (r, c))
    if isinstance(v_n, float):
        return min(max(r, 0.0), 1.0), min(max(c, 0.0), push_share(inertia))
    return np.clip(r, 0.0, 1.0), np.clip(c, 0.0, push_share(inertia))


def land_on_plate(model: Model, state: Array, body: Bodies) -> Array:
    """Let balls in states (k, 9) that come down at -vz hit the plate: an impact with it.

    The impulse of the plate over the mass is (1 + e) |vz|, with its restitution e. Friction mu times that acts on the
    lowest point until it no longer slips. Bounces slower than MIN_BOUNCE_SPEED_M_S are summed. Compared with sliding
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
    mu = model.laws("friction", body.base_value(model, "sliding_friction"), instant)
    up = rebound * down
    last = up < MIN_BOUNCE_SPEED_M_S
    out = apply_friction_impulse(state, mu * (down + np.where(last, 0.0, up)), body.radius, body.inertia)
    out[:, 2] = body.radius
    out[:, 5] = np.where(last, 0.0, up)
    return out
