"""When two balls on their legs first touch."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from synthcam.dynamics.trajectory import Leg

TOUCHING = 1e-12  # of a radius
LINGERING = 1e-9  # m/s: an impact softer than this is one of an endless row, as restitution under 0.4 may bring
DEEP = 1e-6  # of the distance of touching: an overlap
PATIENCE = 10_000  # steps at touch: balls that an impact leaves with one velocity may go on side by side
STAYING = "stay in contact from {:.6g} s on: only separate impacts are modelled"


def first_contact(
    legs: Sequence[Leg], radius: Sequence[float], t: float, horizon: float
) -> tuple[float, int, int] | None:
    """The first contact between any two balls.

    Parameters
    ----------
    legs : sequence of Leg
        How each ball moves.
    radius : sequence of float
        Of each, m.
    t, horizon : float
        From when to when, s.

    Returns
    -------
    (time, i, j) or None
        s, and the two balls' places in `legs`.

    Raises
    ------
    ValueError
        When balls overlap, and when they touch and do not part.
    """
    found = None
    for i, j in itertools.combinations(range(len(legs)), 2):
        if legs[i].motion == legs[j].motion == "rest":
            continue
        when = _contact(legs[i], legs[j], t, horizon, radius[i] + radius[j])
        if when is not None:
            found, horizon = (when, i, j), when
    return found


def _contact(a: Leg, b: Leg, t: float, horizon: float, reach: float) -> float | None:
    """First time in [t, horizon] at which two balls touch and approach; reach: the sum of their radii.

    Steps that cannot pass a contact: the gap h(t) stays above h + h' s - A s^2/2 where A bounds both accelerations,
    for the distance of two points in free motion is convex. On a contact they converge like Newton's method.
    """
    steepest = a.bound(t) + b.bound(t)
    touching, begun, touched = TOUCHING * reach / 2, t, 0
    while True:
        one, two = a.now(t), b.now(t)
        x, y, z = one[0] - two[0], one[1] - two[1], one[2] - two[2]
        vx, vy, vz = one[3] - two[3], one[4] - two[4], one[5] - two[5]
        distance = math.sqrt(x * x + y * y + z * z)
        gap = distance - reach
        if math.isnan(gap):  # it compares with nothing, and would be stepped over for ever
            raise ValueError(f"the motion of a ball cannot be followed beyond {begun:.6g} s")
        rate = (x * vx + y * vy + z * vz) / distance
        if gap <= touching:
            parting = (vx * vx + vy * vy + vz * vz - rate * rate) / distance - steepest  # as they pass each other
            if rate < 0 and not (rate > -LINGERING and rate * rate < 2 * parting * touching):
                return t
            if gap < -DEEP * reach:
                raise ValueError(f"balls overlap by {-gap:.3g} m at {t:.6g} s")
            gap, rate = (touching, 0.0) if rate <= 0 else (max(gap, 0.0), rate)
            touched += 1
            if touched > PATIENCE:
                raise ValueError("two balls " + STAYING.format(begun))
        step = _safe_step(gap, rate, steepest)
        if t + step > horizon:
            return None
        if t + step == t and rate < 0:  # nearer than the last bit of the time can tell
            return t
        t = max(t + step, math.nextafter(t, math.inf))


def _safe_step(gap: float, rate: float, steepest: float) -> float:
    """The positive root s of gap + rate s - steepest s^2/2 = 0."""
    if steepest == 0:
        return gap / -rate if rate < 0 else math.inf
    root = math.sqrt(rate * rate + 2 * steepest * gap)
    return (rate + root) / steepest if rate > 0 else 2 * gap / (root - rate)
