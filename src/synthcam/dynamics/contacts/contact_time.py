"""Contact detection: when a ball first touches another, or a wall, given how each of them moves.

The steps in time cannot pass a contact. The distance of a point in free motion from another, and from a wall, is convex
in time. So the gap h stays above h + h' s - A s^2/2, where A bounds the sum of the accelerations. Near a contact the
steps converge like Newton's method.
"""

import math

from synthcam.dynamics.contacts.walls import Wall, time_to_close
from synthcam.dynamics.kinematics import TOUCH_TOLERANCE, State
from synthcam.dynamics.trajectory import Leg

MIN_IMPACT_SPEED_M_S = 1e-9  # softer impacts belong to an endless sequence, which a restitution under 0.4 may bring
STAYING = "stay in contact from {:.6g} s on: only separate impacts are modelled"
MAX_TOUCHING_STEPS = 10_000  # an impact may leave two balls with one velocity, side by side for a while
OVERLAP_TOLERANCE = 1e-6  # of the reach


def find_contact_time(
    a: Leg, b: Leg, t: float, horizon: float, reach: float, first: State | None = None
) -> float | None:
    """Find the first time in [t, horizon] at which two balls touch and approach.

    reach: the sum of their radii, m. first: the state of a at t, where it is known.

    Raises ValueError if balls overlap, or touch and do not part.
    """
    steepest = a.bound(t) + b.bound(t)
    touching, begun, touched = TOUCH_TOLERANCE * reach / 2, t, 0
    while True:
        one, two = first or a.now(t), b.now(t)
        first = None
        x, y, z = one[0] - two[0], one[1] - two[1], one[2] - two[2]
        vx, vy, vz = one[3] - two[3], one[4] - two[4], one[5] - two[5]
        distance = math.sqrt(x * x + y * y + z * z)
        gap = distance - reach
        if math.isnan(gap):  # no comparison with it is true: the loop would never end
            raise ValueError(f"the motion of a ball cannot be followed beyond {begun:.6g} s")
        rate = (x * vx + y * vy + z * vz) / distance
        if gap <= touching:
            parting = (vx * vx + vy * vy + vz * vz - rate * rate) / distance - steepest  # as they pass each other
            if rate < 0 and not (rate > -MIN_IMPACT_SPEED_M_S and rate * rate < 2 * parting * touching):
                return t
            if gap < -OVERLAP_TOLERANCE * reach:
                raise ValueError(f"balls overlap by {-gap:.3g} m at {t:.6g} s")
            gap, rate = (touching, 0.0) if rate <= 0 else (max(gap, 0.0), rate)
            touched += 1
            if touched > MAX_TOUCHING_STEPS:
                raise ValueError("two balls " + STAYING.format(begun))
        then = _step_on(t, time_to_close(gap, rate, steepest), rate, horizon)
        if then is None or then == t:
            return then
        t = then


def find_wall_contact(ball: Leg, wall: Wall, t: float, horizon: float, radius: float) -> float | None:
    """Find the first time in [t, horizon] at which a ball touches a wall and approaches it."""
    steepest, reach = ball.bound(t), wall.reach(radius)
    touching, begun, touched = TOUCH_TOLERANCE * radius, t, 0
    while True:
        state = ball.now(t)
        far, nx, ny = wall.distance(state[0], state[1])
        gap, rate = far - reach, state[3] * nx + state[4] * ny
        if math.isnan(gap):
            raise ValueError(f"the motion of a ball cannot be followed beyond {begun:.6g} s")
        if gap <= touching:
            if rate < 0:
                return t
            if gap < -OVERLAP_TOLERANCE * radius:
                raise ValueError(f"a ball is {-gap:.3g} m deep in a wall at {t:.6g} s")
            gap, touched = max(gap, touching if rate == 0 else 0.0), touched + 1
            if touched > MAX_TOUCHING_STEPS:
                raise ValueError(f"a ball and a wall {STAYING.format(begun)}")
        then = _step_on(t, wall.time_to_close(state, gap, rate, steepest), rate, horizon)
        if then is None or then == t:
            return then
        t = then


def _step_on(t: float, step: float, rate: float, horizon: float) -> float | None:
    """Return the time after a step, t itself at a contact closer than its last bit, or None beyond the horizon."""
    then = t + step
    if then > horizon:
        return None
    if then <= t:
        return t if then == t and rate < 0 else math.nextafter(t, math.inf)
    return then
