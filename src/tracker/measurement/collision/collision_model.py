"""The tracker's own closed-form model of a collision: two balls roll, collide, slide and roll on.

Ball 1 rests or rolls, ball 2 rolls at it. At t_c they exchange an impulse. Then each ball slides on a parabola until
its slip is used up, and rolls on. Positions are averages over the camera's exposure, because a streaked image measures
that average. They come with exact derivatives.

Two parameter vectors describe the same motion:

- **free** (22 numbers, `FREE`): after the hit each ball has any velocity, any slide time, any final velocity.
- **tied** (16 numbers, `TIED`): restitution, friction and spin transfer determine them (`tied_to_free`).

Conventions:

- Both vectors end with the velocity of ball 1 before the hit (`TARGET`). A fit holds it at zero if ball 1 rests.
- v0 and heading are those of the velocity of ball 2 relative to ball 1.
- `SPIN` describes the spin of a ball 2 that does not roll, and is zero if it rolls. In the free vector the
  acceleration that this causes (`SLIDING`) replaces it.
- The impact parameter enters as an angle beta, b/2R = sin(beta). Friction and slide times enter as logarithms. Every
  real vector is therefore a valid motion.

Source: Painter & Behringer 2000, eqs 1-4, for the head-on case. `tied_to_free` derives that of two rolling balls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import factorial

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array, Flags, Index, Ints

GRAVITY = 9.81  # m/s^2; only the product mu_k * g shows in a track
SLIP_RATE = 3.5  # |u| falls at 7/2 mu g: friction slows a sphere by mu g and spins it up by 5/2 mu g
SHORTEST_EXPOSURE = 1e-8  # s, for an instant: below any jitter, above the integrals' rounding

LAUNCH = ("t_c", "x", "y", "heading", "beta", "v0", "drag", "decel")
TARGET = ("wx", "wy")  # m/s, ball 1's velocity just before the hit
SPIN = ("ux", "uy", "side")  # m/s, ball 2 just before the hit: velocity of its lowest point, R times spin about z
SLIDING = ("ax", "ay")  # m/s^2, of ball 2 before the hit
TIED = (*LAUNCH, "r", "log_mu", "C", *SPIN, *TARGET)
FREE = (
    *LAUNCH,
    *("v1x", "v1y", "f1x", "f1y", "log_tau1"),
    *("v2x", "v2y", "f2x", "f2y", "log_tau2"),
    *SLIDING,
    *TARGET,
)
_SPIN, _SLIDING = TIED.index("ux"), FREE.index("ax")
AFTER = {1: 8, 2: 13}  # where a ball's own five numbers begin in FREE


# --- rolling ---


def _phis(z: Array) -> list[Array]:
    """phi_k(z) = sum_j (-z)^j / (j + k)! for k = 0..4: exp(-z) with its first k terms divided out.

    A series where those terms would cancel, the recurrence phi_k = 1/k! - z phi_(k+1) elsewhere.
    """
    size = float(np.abs(z).max(initial=0.0))
    wide = np.abs(z) > 1.0 if size > 1.0 else None
    near = z if wide is None else np.where(wide, 0.0, z)
    terms = 4 + int(14 * min(1.0, size + 0.15))
    phi4 = np.full(z.shape, 1.0 / factorial(terms + 4))
    for j in range(terms - 1, -1, -1):
        phi4 = 1.0 / factorial(j + 4) - near * phi4
    phis = [phi4]
    for k in (3, 2, 1, 0):
        phis.insert(0, 1.0 / factorial(k) - near * phis[0])
    if wide is not None:
        far = np.where(wide, z, 1.0)
        upward = np.exp(-far)
        for k in range(5):
            phis[k] = np.where(wide, upward, phis[k])
            upward = (1.0 / factorial(k) - upward) / far
    return phis


@dataclass(frozen=True)
class RollingMotion:
    """A rolling ball after time t: distance, its integral, and the derivatives of that by speed, drag and decel."""

    distance: Array
    area: Array  # integral of `distance` from 0 to t
    area_speed: Array
    area_drag: Array
    area_decel: Array


def roll_freely(speed: float | Array, drag: float, decel: float, t: Array) -> RollingMotion:
    """Roll in the tracker's model under a = -(drag v + decel) until the ball stops; drag = 0 is no special case.

    speed at t = 0 in m/s, one or (n,); drag in 1/s; decel in m/s^2; times t (n,) in s, which may be negative.
    """
    stop = compute_stopping_time(speed, drag, decel)
    run = np.minimum(t, stop)
    _, p1, p2, p3, p4 = _phis(drag * run)
    square = run * run
    distance = run * (speed * p1 - decel * run * p2)
    area = square * (speed * p2 - decel * run * p3)
    area_speed = square * p2
    area_drag = square * run * (speed * (2 * p3 - p2) - decel * run * (3 * p4 - p3))
    area_decel = -square * run * p3
    rest = t - run
    if np.count_nonzero(rest):  # it stands still from then on
        distance_drag = square * (speed * (p2 - p1) - decel * run * (2 * p3 - p2))  # phi_k' = k phi_(k+1) - phi_k
        area += distance * rest
        area_speed += run * p1 * rest
        area_drag += distance_drag * rest
        area_decel -= square * p2 * rest
    return RollingMotion(distance, area, area_speed, area_drag, area_decel)


def compute_stopping_time(speed: float | Array, drag: float, decel: float) -> Array:
    """Compute the time in which a = -(drag v + decel) stops a ball of the tracker's model; inf if it never does."""
    fast = np.asarray(speed, dtype=np.float64)
    if decel <= 0:
        return np.full(fast.shape, np.inf)
    stops = (fast > 0) & (drag * fast > -decel)
    ratio = np.where(stops, drag * fast / decel, 0.0)
    small = np.abs(ratio) < 1e-8
    share = np.where(small, 1 - ratio / 2, np.log1p(ratio) / np.where(small, 1.0, ratio))
    return np.where(stops, fast / decel * share, np.inf)


# --- the path of both balls ---


def compute_unit_vectors(
    heading: NDArray[np.inexact] | float, beta: NDArray[np.inexact] | float
) -> tuple[NDArray[np.inexact], NDArray[np.inexact], NDArray[np.inexact]]:
    """Compute the collision model's unit vectors (..., 2): d (motion of ball 2 against 1), n (from 2 to 1), z x n."""
    x, y = np.cos(heading - beta), np.sin(heading - beta)
    return _vectors(np.cos(heading), np.sin(heading)), _vectors(x, y), _vectors(-y, x)


def _vectors(x: NDArray[np.inexact], y: NDArray[np.inexact]) -> NDArray[np.inexact]:
    """Vectors (..., 2) from their components (...,), as np.stack makes them in several times the time."""
    out = np.empty((*x.shape, 2), x.dtype)
    out[..., 0], out[..., 1] = x, y
    return out


def _scalar_product(a: NDArray[np.inexact], b: NDArray[np.inexact]) -> NDArray[np.inexact]:
    """Scalar product of vectors (..., 2), quicker than a sum over an axis of two."""
    product = a * b
    return np.asarray(product[..., 0] + product[..., 1])


def mean_positions(
    free: Array, ball: int | Ints, start: Array, exposure: float, diameter: float
) -> tuple[Array, Array]:
    """Compute the positions that the collision model predicts, averaged over exposures, and their derivatives.

    An exposure that holds the impact or the end of a slide needs no care.

    free (22,): in the order of FREE.
    ball: 1 (struck) or 2 (striker), one or (n,).
    start (n,): of the exposures, s.
    exposure: s; 0 for instants.
    diameter: m.

    Returns positions (n, 2), m, and their derivatives (n, 2, 22) by `free`.
    """
    if exposure < SHORTEST_EXPOSURE:
        start = start - SHORTEST_EXPOSURE / 2
        exposure = SHORTEST_EXPOSURE
    n, second = len(start), np.broadcast_to(ball, len(start)) == 2
    since = np.concatenate([start, start + exposure]) - free[0]
    integrals = _integrate(free, np.concatenate([second, second]).astype(np.int64), since)
    mean = (integrals[:, n:] - integrals[:, :n]) / exposure
    directions, normal, tangent = compute_unit_vectors(free[3], free[4])
    own = second[:, None].astype(np.float64)
    position = mean[_PATH] + free[1:3] - own * (diameter * normal)
    slope, v0, d = np.zeros((len(FREE), n, 2)), free[5], np.asarray(directions, dtype=np.float64)
    slope[0], slope[6], slope[7] = mean[_CONTACT], mean[_DRAG], mean[_DECEL]
    slope[1, :, 0] = slope[2, :, 1] = 1.0
    turn = own * (diameter * tangent)
    launched_x, launched_y = mean[_TARGET_X] * own, mean[_TARGET_Y] * own
    slope[3] = v0 * (launched_y * d[0] - launched_x * d[1]) - turn
    slope[4] = turn
    slope[5] = launched_x * d[0] + launched_y * d[1]
    for rows, at in zip(_find_rows_of_balls(second), AFTER.values(), strict=True):
        slope[at, rows, 0] = slope[at + 1, rows, 1] = mean[_START, rows, 0]
        slope[at + 2, rows], slope[at + 3, rows] = mean[_FINAL_X, rows], mean[_FINAL_Y, rows]
        slope[at + 4, rows] = mean[_TAU, rows]
    if len(mean) > _PULL:
        slope[_SLIDING], slope[_SLIDING + 1] = mean[_PULL], mean[_PULL + 1]
    slope[-2], slope[-1] = mean[_TARGET_X], mean[_TARGET_Y]
    return position, slope.transpose(1, 2, 0)


def _find_rows_of_balls(second: Flags) -> Sequence[slice | Index]:
    """The rows of ball 1 and of ball 2; slices where those of ball 1 come first."""
    first = len(second) - np.count_nonzero(second)
    if not second[:first].any():
        return slice(first), slice(first, None)
    return np.flatnonzero(~second), np.flatnonzero(second)


# What `_integrate` integrates, by row: the path since t_c, and its derivatives by t_c, drag and decel; by the final
# velocity of the ball's own slide and the logarithm of its duration; by its first velocity, of which each component
# moves the ball along itself by the first of two numbers; by the velocity of ball 1 before the hit, and so by that of
# ball 2 relative to it; by the acceleration of ball 2 before the hit, where it slides.
_PATH, _CONTACT, _DRAG, _DECEL, _FINAL_X, _FINAL_Y, _TAU, _START, _TARGET_X, _TARGET_Y, _PULL = range(11)
_ENDS = np.array([[at + 2, at + 3] for at in AFTER.values()])  # of velocities and logarithms in FREE
_STARTS, _TAUS = _ENDS - 2, _ENDS[:, 1] + 1


def _integrate(free: Array, second: Ints, since: Array) -> Array:
    """Integrals over time, from t_c, of the displacement since t_c and of its derivatives: (10 or 12, n, 2).

    second (n,): 1 for ball 2, else 0.
    """
    came, slides = since < 0, bool(free[_SLIDING] or free[_SLIDING + 1])
    rows = np.flatnonzero(came if free[-2] or free[-1] else came & (second > 0))
    own, before = second[rows], since[rows]
    velocities, starts = np.empty((4, 2)), free[_STARTS]  # ball 1 and 2 before the contact, and after their slides
    velocities[0] = velocities[1] = free[-2:]
    velocities[1, 0] += free[5] * np.cos(free[3])
    velocities[1, 1] += free[5] * np.sin(free[3])
    velocities[2:] = free[_ENDS]
    after = np.maximum(since, 0.0)  # before the contact, nothing follows from the motion after it
    tau = np.exp(free[_TAUS])[second]
    slide = np.minimum(after, tau)
    rest = after - slide
    # at once: most of the time is that of numpy's calls
    kinds = np.concatenate([own, second + 2])
    speeds, directions = _polar(velocities)
    speed, along = speeds[kinds], directions[kinds]
    roll = roll_freely(speed, free[6], free[7], np.concatenate([before, rest]))
    m = len(rows)
    rolled = np.empty((4, len(kinds), 2))
    rolled[0], rolled[1] = roll.area[:, None] * along, roll.distance[:, None] * along
    rolled[2], rolled[3] = roll.area_drag[:, None] * along, roll.area_decel[:, None] * along
    by_velocity = _by_velocity(roll, speed, along)
    out = np.zeros((12 if slides else 10, len(since), 2))
    v, change = starts[second], (velocities[2:] - starts)[second]
    square = slide * slide
    both = square / 2 + slide * rest  # weight of the velocity a ball keeps throughout
    gain = square * (slide / 6 + rest / 2) / tau  # weight of the change from v to its final one
    late = np.where(rest > 0, tau * (rest / 2 - tau / 6), -square * slide / (6 * tau))
    area, distance = rolled[:2, m:]
    out[_PATH] = both[:, None] * v + gain[:, None] * change + area
    out[_CONTACT] = -slide[:, None] * v - (square / (2 * tau))[:, None] * change - distance
    out[_DRAG : _DECEL + 1] = rolled[2:, m:]
    out[_FINAL_X : _FINAL_Y + 1] = by_velocity[:, m:]
    out[_FINAL_X, :, 0] += gain
    out[_FINAL_Y, :, 1] += gain
    out[_TAU] = (tau * rest)[:, None] * v + late[:, None] * change - tau[:, None] * distance
    out[_START, :, 0] = both - gain
    if m:
        out[:, rows] = 0.0
        out[_PATH, rows], out[_CONTACT, rows] = rolled[0, :m], -rolled[1, :m]
        out[_DRAG : _DECEL + 1, rows] = rolled[2:, :m]
        out[_TARGET_X : _TARGET_Y + 1, rows] = by_velocity[:, :m]
    if slides:
        late_rows = rows[own > 0]
        out[:, late_rows] = _slide_up_to_contact(free, velocities[1], since[late_rows])
    return out


def _slide_up_to_contact(free: Array, v: Array, s: Array) -> Array:
    """The integrals (12, n, 2) of ball 2 sliding up to the contact: friction keeps its direction, because slip does."""
    pull = free[_SLIDING : _SLIDING + 2]
    square, cube = (s * s / 2)[:, None], (s**3 / 6)[:, None]
    out = np.zeros((12, len(s), 2))
    out[_PATH] = square * v + cube * pull
    out[_CONTACT] = -(s[:, None] * v + square * pull)
    for axis in (0, 1):
        out[_PULL + axis, :, axis], out[_TARGET_X + axis, :, axis] = cube[:, 0], square[:, 0]
    return out


def _polar(velocities: Array) -> tuple[Array, Array]:
    """Speeds (k,) and directions (k, 2); of a ball at rest the direction is 0."""
    speed = np.hypot(velocities[:, 0], velocities[:, 1])
    return speed, velocities / np.maximum(speed, 1e-300)[:, None]


def _by_velocity(roll: RollingMotion, speed: Array, along: Array) -> Array:
    """d(area)/d(velocity), by its component (2, n, 2): a velocity that turns takes the rolled distance with it."""
    turn = roll.area / np.maximum(speed, 1e-300)
    x, y = along[:, 0], along[:, 1]
    off = roll.area_speed - turn
    out = np.empty((2, len(turn), 2))
    out[0, :, 0] = turn + off * x * x
    out[0, :, 1] = out[1, :, 0] = off * x * y
    out[1, :, 1] = turn + off * y * y
    return out


# --- the impact ---


def tied_to_free(tied: NDArray[np.inexact], spin: float = 0.0) -> NDArray[np.inexact]:
    """Apply the model's laws of impact and sliding: the free parameters that follow from the tied ones.

    The balls are equal; ball 1 rolls or rests. The laws are, with n, t and z the unit vectors of the contact:

    - The normal impulse is P/m = (1 + r) v_n / 2 along n.
    - The tangential impulse is J/m = -(2/5) C u_t on ball 2, u_t the relative velocity of the touching surfaces. Its
      part in the plane is the relative velocity along t. Its vertical part is -S, where S is the sum of both balls' R w
      x z along n. A rolling ball contributes its velocity.
    - The vertical impulse spins the balls, R dw = -C S t, and lifts nothing.
    - The lowest point of a ball then slips at u = dv + C S n plus its slip before. dv is its change of velocity.
    - Slip ends after tau = |u| / (3.5 mu g) at v_f = v - 2u/7. The reason is that a force there conserves (5v + 2R w x
      z)/7.

    tied (..., 16): in the order of TIED; complex too, for derivatives by complex steps. spin: R times the sum of both
    balls' spins about the vertical, m/s, which an earlier oblique hit leaves. Returns (..., 22) in the order of FREE.
    """
    heading, beta, v0, target = tied[..., 3], tied[..., 4], tied[..., 5], tied[..., -2:]
    r, mu, c = tied[..., 8, None], np.exp(tied[..., 9]), tied[..., 10, None]
    slips, side = tied[..., _SPIN : _SPIN + 2], tied[..., _SPIN + 2, None]
    d, n, t = compute_unit_vectors(heading, beta)
    normal, tangent = (v0 * np.cos(beta))[..., None] * n, (v0 * np.sin(beta))[..., None] * t
    surfaces = 2 * _scalar_product(target, n) - _scalar_product(slips, n)
    twist = c * (normal + surfaces[..., None] * n)  # C S n
    kick = (1 + r) / 2 * normal + 0.4 * c * (tangent + (spin + side) * t)  # ball 1's change of velocity
    parts = [tied[..., :8]]
    for v, change, before in ((target, kick, 0.0), (target + v0[..., None] * d, -kick, slips)):
        u = change + twist + before
        slip = np.sqrt(_scalar_product(u, u) + 1e-30)  # keeps the logarithm when there is no slip at all
        parts += [v + change, v + change - 2 * u / 7, np.log(slip / (SLIP_RATE * mu * GRAVITY))[..., None]]
    pull = -(mu * GRAVITY)[..., None] * slips / np.sqrt(_scalar_product(slips, slips) + 1e-30)[..., None]
    return np.concatenate([*parts, pull, target], -1)


def tied_to_free_jacobian(tied: Array, spin: float = 0.0) -> Array:
    """Differentiate the collision model: its free parameters by the tied ones, (22, 16), exact to rounding."""
    steps = tied + 1e-30j * np.eye(len(TIED))
    return np.asarray(tied_to_free(steps, spin).imag.T / 1e-30, dtype=np.float64)
