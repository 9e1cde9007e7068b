"""How two balls move before and after they collide: the tracker's own closed-form model.

Ball 1 rests or rolls, ball 2 rolls at it. At t_c they exchange an impulse; then each ball slides on a parabola
until its slip is used up, and rolls on. Positions are averages over the camera's exposure, because that is what
a streaked image measures, and come with exact derivatives.

Two parameter vectors describe the same path:

- **free** (20 numbers, `FREE`): after the hit each ball has any velocity, any slide time, any final velocity;
- **tied** (13 numbers, `TIED`): restitution, friction and spin transfer decide them (`release`).

Both end with ball 1's velocity before the hit (`TARGET`), which a fit holds at zero where that ball rests; v0
and heading are those of ball 2's velocity relative to it. The impact parameter enters as an angle beta, b/2R =
sin(beta); friction and slide times as logarithms, so that every real vector is a valid motion. Source: Painter &
Behringer 2000, eqs 1-4 for the head-on case; the impulse of two rolling balls is derived in `release`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

GRAVITY = 9.81  # m/s^2; only the product mu_k * g shows in a track
SLIP_RATE = 3.5  # |u| falls at 7/2 mu g: friction slows a sphere by mu g and spins it up by 5/2 mu g
SHORTEST_EXPOSURE = 1e-8  # s; stands for an instant: below any jitter, above the integrals' rounding

LAUNCH = ("t_c", "x", "y", "heading", "beta", "v0", "drag", "decel")
TARGET = ("wx", "wy")  # m/s, ball 1's velocity just before the hit
TIED = (*LAUNCH, "r", "log_mu", "C", *TARGET)
FREE = (
    *LAUNCH,
    *("v1x", "v1y", "f1x", "f1y", "log_tau1"),
    *("v2x", "v2y", "f2x", "f2y", "log_tau2"),
    *TARGET,
)
AFTER = {1: 8, 2: 13}  # where a ball's own five numbers begin in FREE


# --- rolling ---


def _phis(z: Floats) -> list[Floats]:
    """phi_k(z) = sum_j (-z)^j / (j + k)! for k = 0..4: exp(-z) with its first k terms divided out.

    A series where those terms would cancel, the recurrence phi_k = 1/k! - z phi_(k+1) elsewhere.
    """
    wide = np.abs(z) > 1.0
    near = np.where(wide, 0.0, z)
    terms = 4 + int(14 * min(1.0, float(np.max(np.abs(near), initial=0.0)) + 0.15))
    phi4 = np.full(z.shape, 1.0 / factorial(terms + 4))
    for j in range(terms - 1, -1, -1):
        phi4 = 1.0 / factorial(j + 4) - near * phi4
    phis = [phi4]
    for k in (3, 2, 1, 0):
        phis.insert(0, 1.0 / factorial(k) - near * phis[0])
    if wide.any():
        far = np.where(wide, z, 1.0)
        upward = np.exp(-far)
        for k in range(5):
            phis[k] = np.where(wide, upward, phis[k])
            upward = (1.0 / factorial(k) - upward) / far
    return phis


@dataclass(frozen=True)
class Rolled:
    """A rolling ball after time t: way, integral of the way, and what they owe to speed, drag and decel."""

    way: Floats
    area: Floats  # integral of `way` from 0 to t
    area_speed: Floats
    area_drag: Floats
    area_decel: Floats


def rolled(speed: float, drag: float, decel: float, t: Floats) -> Rolled:
    """Rolling under a = -(drag v + decel), at `speed` (m/s) at t = 0, until it stops; t may be negative.

    Everything is written with phi functions, so drag = 0 needs no special case.
    """
    stop = stopping_time(speed, drag, decel)
    run, rest = np.minimum(t, stop), np.maximum(t - stop, 0.0)
    _, p1, p2, p3, p4 = _phis(drag * run)
    way = run * (speed * p1 - decel * run * p2)
    way_drag = run**2 * (speed * (p2 - p1) - decel * run * (2 * p3 - p2))  # phi_k' = k phi_(k+1) - phi_k
    return Rolled(
        way=way,
        area=run**2 * (speed * p2 - decel * run * p3) + way * rest,
        area_speed=run**2 * p2 + run * p1 * rest,
        area_drag=run**3 * (speed * (2 * p3 - p2) - decel * run * (3 * p4 - p3)) + way_drag * rest,
        area_decel=-(run**3) * p3 - run**2 * p2 * rest,
    )


def stopping_time(speed: float, drag: float, decel: float) -> float:
    """Seconds until a = -(drag v + decel) brings `speed` to rest; inf if it never does."""
    if decel <= 0 or speed <= 0 or drag * speed <= -decel:
        return np.inf
    ratio = drag * speed / decel
    return speed / decel * (np.log1p(ratio) / ratio if abs(ratio) > 1e-8 else 1 - ratio / 2)


# --- the path of both balls ---


def directions(heading: float, beta: float) -> tuple[Floats, Floats, Floats]:
    """Unit vectors d (ball 2's motion relative to ball 1), n (from ball 2 to ball 1 at contact), t = z x n."""
    d = np.array([np.cos(heading), np.sin(heading)])
    n = np.array([np.cos(heading - beta), np.sin(heading - beta)])
    return d, n, np.array([-n[1], n[0]])


def path(free: Floats, ball: int, start: Floats, exposure: float, diameter: float) -> tuple[Floats, Floats]:
    """Mean positions of one ball over [start, start + exposure], and their derivatives.

    free: (20,) in the order of FREE. ball: 1 (struck) or 2 (striker). start: (n,) s. exposure: s, 0 for
    instants. diameter: m. Returns positions (n, 2) m and derivatives (n, 2, 20). Exact: closed-form
    integrals over each leg, so an exposure that holds the impact or the end of a slide needs no care.
    """
    if exposure < SHORTEST_EXPOSURE:
        start = start - SHORTEST_EXPOSURE / 2
        exposure = SHORTEST_EXPOSURE
    edges = np.concatenate([start, start + exposure])
    area, slope = _areas(free, ball, edges)
    n = len(start)
    place, slope_place = _contact_place(free, ball, diameter)
    position = place + (area[n:] - area[:n]) / exposure
    return position, slope_place + (slope[n:] - slope[:n]) / exposure


def _contact_place(free: Floats, ball: int, diameter: float) -> tuple[Floats, Floats]:
    """Centre of a ball at t_c and its derivatives (2, 20)."""
    place, slope = free[1:3].copy(), np.zeros((2, len(FREE)))
    slope[0, 1] = slope[1, 2] = 1.0
    if ball == 2:
        _, n, t = directions(free[3], free[4])
        place = place - diameter * n
        slope[:, 3], slope[:, 4] = -diameter * t, diameter * t
    return place, slope


def _areas(free: Floats, ball: int, when: Floats) -> tuple[Floats, Floats]:
    """Integral over time, from t_c, of the displacement since t_c; (n, 2) m s and derivatives (n, 2, 20)."""
    since = when - free[0]
    area, slope = np.zeros((len(when), 2)), np.zeros((len(when), 2, len(FREE)))
    before = since < 0
    if before.any() and (ball == 2 or free[-2:].any()):
        _approach(free, ball, since[before], area, slope, before)
    if not before.all():
        _departure(free, AFTER[ball], since[~before], area, slope, ~before)
    return area, slope


def _approach(free: Floats, ball: int, s: Floats, area: Floats, slope: Floats, rows: NDArray[np.bool_]) -> None:
    """A ball rolling up to the contact."""
    heading, v0, drag, decel = free[[3, 5, 6, 7]]
    d = np.array([np.cos(heading), np.sin(heading)])
    velocity = free[-2:] + v0 * d if ball == 2 else free[-2:]
    speed = float(np.hypot(velocity[0], velocity[1]))
    along = velocity / max(speed, 1e-300)
    roll = rolled(speed, drag, decel, s)
    area[rows] = roll.area[:, None] * along
    part = np.zeros((len(s), 2, len(FREE)))
    part[:, :, 0] = -roll.way[:, None] * along
    part[:, :, 6] = roll.area_drag[:, None] * along
    part[:, :, 7] = roll.area_decel[:, None] * along
    turned = _by_velocity(roll, speed, along)
    part[:, :, -2:] = turned
    if ball == 2:
        part[:, :, 3] = turned @ (v0 * np.array([-d[1], d[0]]))
        part[:, :, 5] = turned @ d
    slope[rows] = part


def _by_velocity(roll: Rolled, speed: float, along: Floats) -> Floats:
    """d(area)/d(velocity), (n, 2, 2): a velocity that turns takes the whole rolled way with it."""
    projector = np.outer(along, along)
    turn = roll.area / max(speed, 1e-300)
    return roll.area_speed[:, None, None] * projector + turn[:, None, None] * (np.eye(2) - projector)


def _departure(free: Floats, at: int, s: Floats, area: Floats, slope: Floats, rows: NDArray[np.bool_]) -> None:
    """A ball sliding, then rolling, after the contact; `at` is where its numbers begin in FREE."""
    v, f, tau = free[at : at + 2], free[at + 2 : at + 4], float(np.exp(free[at + 4]))
    speed = float(np.hypot(f[0], f[1]))
    along = f / speed if speed > 0 else np.zeros(2)
    slide, roll_time = np.minimum(s, tau), np.maximum(s - tau, 0.0)
    roll = rolled(speed, free[6], free[7], roll_time)

    both = slide**2 / 2 + slide * roll_time  # weight of the velocity a ball keeps throughout
    gain = slide**2 * (slide / 6 + roll_time / 2) / tau  # weight of the change from v to f
    change = f - v
    area[rows] = both[:, None] * v + gain[:, None] * change + roll.area[:, None] * along

    part = np.zeros((len(s), 2, len(FREE)))
    way = slide[:, None] * v + (slide**2 / (2 * tau))[:, None] * change + roll.way[:, None] * along
    part[:, :, 0] = -way
    part[:, :, at + 2 : at + 4] = _by_velocity(roll, speed, along)
    for axis in (0, 1):
        part[:, axis, at + axis] = both - gain
        part[:, axis, at + 2 + axis] += gain
    late = np.where(roll_time > 0, roll_time / 2 - tau / 6, -(slide**3) / (6 * tau**2))
    by_tau = roll_time[:, None] * v + late[:, None] * change - roll.way[:, None] * along
    part[:, :, at + 4] = by_tau * tau
    part[:, :, 6] = roll.area_drag[:, None] * along
    part[:, :, 7] = roll.area_decel[:, None] * along
    slope[rows] = part


# --- the impact ---


def release(tied: NDArray[np.inexact], spin: float = 0.0) -> NDArray[np.inexact]:
    """The free vector (..., 20) that restitution, friction and spin transfer make of a tied one (..., 13).

    Equal balls, both rolling or ball 1 at rest. P/m = (1 + r) v_n / 2 along n; J/m = -(2/5) C u_t on ball 2, u_t
    the relative velocity of the touching surfaces: its part in the plane is the relative velocity along t, its
    vertical part -S, S the sum of both balls' speeds along n, for a rolling ball's surface moves there at v_n; spin,
    m/s, is R times the sum of their spins about the vertical, which an earlier oblique hit leaves. The
    vertical impulse spins the balls, R dw = -C S t, and lifts nothing. A ball's lowest point then slips at
    u = dv + C S n, dv its change of velocity; tau = |u| / (3.5 mu g) and v_f = v - 2u/7, for a force there leaves
    (5v + 2R w x z)/7 as it is. Accepts complex input, for derivatives by complex steps.
    """
    heading, beta, v0, target = tied[..., 3], tied[..., 4], tied[..., 5], tied[..., -2:]
    r, mu, c = tied[..., 8, None], np.exp(tied[..., 9]), tied[..., 10, None]
    d = np.stack([np.cos(heading), np.sin(heading)], -1)
    n = np.stack([np.cos(heading - beta), np.sin(heading - beta)], -1)
    t = np.stack([-n[..., 1], n[..., 0]], -1)
    normal, tangent = (v0 * np.cos(beta))[..., None] * n, (v0 * np.sin(beta))[..., None] * t
    twist = c * (normal + 2 * (target * n).sum(-1)[..., None] * n)  # C S n
    kick = (1 + r) / 2 * normal + 0.4 * c * (tangent + spin * t)  # ball 1's change of velocity
    parts = [tied[..., :8]]
    for v, change in ((target, kick), (target + v0[..., None] * d, -kick)):
        u = change + twist
        slip = np.sqrt((u**2).sum(-1) + 1e-30)  # keeps the logarithm when there is no slip at all
        parts += [v + change, v + change - 2 * u / 7, np.log(slip / (SLIP_RATE * mu * GRAVITY))[..., None]]
    return np.concatenate([*parts, target], -1)


def release_slope(tied: Floats, spin: float = 0.0) -> Floats:
    """d(free)/d(tied), (20, 13), exact to rounding (complex step)."""
    steps = tied + 1e-30j * np.eye(len(TIED))
    return np.asarray(release(steps, spin).imag.T / 1e-30, dtype=np.float64)
