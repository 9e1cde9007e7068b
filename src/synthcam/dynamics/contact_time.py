"""Contact detection: when two balls first touch, given how each of them moves."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from synthcam.dynamics.kinematics import TOUCH_TOLERANCE
from synthcam.dynamics.trajectory import Leg

MIN_IMPACT_SPEED_M_S = 1e-9  # softer impacts belong to an endless sequence, which a restitution under 0.4 may bring
STAYING = "stay in contact from {:.6g} s on: only separate impacts are modelled"


def first_contact(
    legs: Sequence[Leg], radius: Sequence[float], t: float, horizon: float
) -> tuple[float, int, int] | None:
    """Find the first contact between any two balls, from t to the horizon, s: its time and the two balls, or None.

    radius: of each ball, m. Raises ValueError if balls overlap, or touch and do not part.
    """
    first = None
    for i, j in itertools.combinations(range(len(legs)), 2):
        if legs[i].motion == legs[j].motion == "rest":
            continue
        when = _contact(legs[i], legs[j], t, horizon, radius[i] + radius[j])
        if when is not None:
            first, horizon = (when, i, j), when
    return first


def _contact(a: Leg, b: Leg, t: float, horizon: float, reach: float) -> float | None:
    """Find the first time in [t, horizon] at which two balls touch and approach; reach: the sum of their radii.

    The steps cannot pass a contact. The distance of two points in free motion is convex in time, so the gap h stays
    above h + h' s - A s^2/2, where A bounds the sum of both accelerations. Near a contact the steps converge like
    Newton's method.
    """
    overlap_tolerance = 1e-6 * reach
    max_touching_steps = 10_000  # an impact may leave two balls with one velocity, side by side for a while
    steepest = a.bound(t) + b.bound(t)
    touching, begun, touched = TOUCH_TOLERANCE * reach / 2, t, 0
    while True:
        one, two = a.now(t), b.now(t)
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
            if gap < -overlap_tolerance:
                raise ValueError(f"balls overlap by {-gap:.3g} m at {t:.6g} s")
            gap, rate = (touching, 0.0) if rate <= 0 else (max(gap, 0.0), rate)
            touched += 1
            if touched > max_touching_steps:
                raise ValueError("two balls " + STAYING.format(begun))
        step = _safe_step(gap, rate, steepest)
        if t + step > horizon:
            return None
        if t + step == t and rate < 0:  # closer than the last bit of the time resolves
            return t
        t = max(t + step, math.nextafter(t, math.inf))


def _safe_step(gap: float, rate: float, steepest: float) -> float:
    """Return the positive root s of gap + rate s - steepest s^2/2 = 0."""
    if steepest == 0:
        return gap / -rate if rate < 0 else math.inf
    root = math.sqrt(rate * rate + 2 * steepest * gap)
    return (rate + root) / steepest if rate > 0 else 2 * gap / (root - rate)
