"""The closed forms that the paper fits (v1f, v2f, tau1, tau2, after Kondic), and their fit.

Head-on they are the paper's. In oblique hits the part along the line of centres follows them, and a share .4 C of the
part across passes to the other ball. The base model has the same C at every b (docs/format.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Floats = NDArray[np.float64]
GRAVITY = 9.81
INERTIA = 2.5  # m R^2 / I of a solid sphere


@dataclass(frozen=True)
class Laws:
    """The three numbers of the paper's fit."""

    r: float = 0.903
    C: float = 0.347
    mu: float = 0.232


PUBLISHED = Laws()
PRINTED = Laws(0.008, 0.008, 0.023)  # the paper's errors of them


def head_on(v0: Floats, laws: Laws = PUBLISHED) -> Floats:
    """(n, 4): v1f, v2f, tau1, tau2 of the paper's F, G, H, I for speeds (n,)."""
    r, c, mu = laws.r, laws.C, laws.mu
    double, rate = 2 * (1 + INERTIA), (1 + INERTIA) * mu * GRAVITY
    one = ((1 + r) * INERTIA - 2 * c) / double
    two = (2 + (1 - r) * INERTIA - 2 * c) / double
    return np.column_stack([one * v0, two * v0, ((1 + r) / 2 + c) / rate * v0, ((1 + r) / 2 - c) / rate * v0])


def head_on_errors(v0: Floats, laws: Laws = PUBLISHED, errors: Laws = PRINTED) -> Floats:
    """(n, 4): what the errors of r, C and mu, taken as independent, make of v1f, v2f, tau1, tau2."""
    steps = [
        head_on(v0, Laws(*(getattr(laws, k) + (getattr(errors, k) if k == name else 0.0) for k in ("r", "C", "mu"))))
        for name in ("r", "C", "mu")
    ]
    return np.asarray(np.sqrt(sum((step - head_on(v0, laws)) ** 2 for step in steps)))


def just_after(b: Floats, laws: Laws = PUBLISHED) -> tuple[Floats, Floats]:
    """Velocities, and R times the rolling equivalent of the spins, just after the impact, over v0: (2, n, 2) each.

    Axes: along the line of centres from striker to target, and across it. Ball 0 is the target.
    """
    normal, across = np.sqrt(1 - b**2), b
    push, rub = (1 + laws.r) / 2 * normal, 0.4 * laws.C * across
    velocity = np.stack([np.stack([push, rub], axis=-1), np.stack([normal - push, across - rub], axis=-1)])
    nothing = np.zeros_like(normal)
    spin = np.stack(
        [
            np.stack([-laws.C * normal, nothing], axis=-1),
            np.stack([(1 - laws.C) * normal, across], axis=-1),
        ]
    )
    return velocity, spin


def final(b: Floats, laws: Laws = PUBLISHED) -> Floats:
    """Velocities (2, n, 2) over v0 once both roll: (5 v + 2 R w x z)/7, which no friction at the plate changes."""
    velocity, spin = just_after(b, laws)
    return (5 * velocity + 2 * spin) / 7


def free_space(b: Floats, r: float = PUBLISHED.r) -> Floats:
    """Velocities (2, n, 2) over v0 with no plate and no friction between the balls: the textbook's collision."""
    return just_after(b, Laws(r, 0.0))[0]


def angle(velocity: Floats) -> Floats:
    """Between the two balls' velocities (2, n, 2), rad."""
    (ax, ay), (bx, by) = velocity[0].T, velocity[1].T
    return np.asarray(np.arctan2(np.abs(ax * by - ay * bx), ax * bx + ay * by))


def energy(velocity: Floats) -> Floats:
    """Translational energy of velocities (2, n, 2) over v0, as a share of the striker's."""
    return np.asarray((velocity**2).sum(axis=(0, 2)))


def momentum(velocity: Floats, b: Floats) -> Floats:
    """Momentum along the striker's first direction, as a share of its own."""
    total = velocity.sum(axis=0)
    return np.asarray(total[:, 0] * np.sqrt(1 - b**2) + total[:, 1] * b)


def paper_angle(b: Floats, r: float = PUBLISHED.r) -> Floats:
    """The paper's cos theta_f formula for the angle between the velocities just after the impact, as printed, rad."""
    q, p = np.asarray(b) ** 2, 1 - np.asarray(b) ** 2
    return np.asarray(np.arccos((1 - r) * p / np.sqrt(((1 - r) ** 2 * p + 4 * q) * p)))


@dataclass(frozen=True)
class Fitted:
    """Minimum of the paper's chi^2: laws, errors, chi^2 over the degrees of freedom, scatter about the lines.

    `scatter` is that of r and C read from each collision's final speeds alone.
    """

    laws: Laws
    errors: Laws
    reduced: float
    scatter: tuple[float, float]


# m/s and s: with 28 collisions from 10 to 60 cm/s these errors of the readings make the paper's errors of r, C and mu.
SPEED_ERROR, TIME_ERROR = 0.0066, 0.035


def fit(v0: Floats, seen: Floats, speed: float = SPEED_ERROR, time: float = TIME_ERROR) -> Fitted:
    """r, C, mu from v1f, v2f, tau1, tau2 (n, 4) of head-on collisions of speeds v0 (n,), by the paper's chi^2.

    speed, time: errors of one reading, which only weigh them against each other. The errors given back are those that
    the scatter about the lines makes. Final speeds are linear in r and C; tau in their sums over mu.
    """
    good = np.isfinite(seen).all(axis=1) & np.isfinite(v0)
    v0, seen = v0[good], seen[good]
    sigma = np.array([speed, speed, time, time])

    def off(p: Floats) -> Floats:
        return np.asarray(((head_on(v0, Laws(*p)) - seen) / sigma).ravel())

    found = least_squares(off, [0.9, 0.3, 0.2], x_scale=[0.1, 0.1, 0.1])
    slope = np.asarray(found.jac, dtype=np.float64)
    inverse = np.linalg.inv(slope.T @ slope)
    left = off(found.x).reshape(-1, 4) * sigma
    rms = np.sqrt((left**2).mean(axis=0) * len(v0) / max(len(v0) - 1.5, 1))
    spread = np.repeat([np.hypot(*rms[:2]) / np.sqrt(2), np.hypot(*rms[2:]) / np.sqrt(2)], 2) / sigma
    weighed = slope * np.tile(spread, len(v0))[:, None]
    errors = np.sqrt(np.diag(inverse @ (weighed.T @ weighed) @ inverse))
    share = seen[:, :2] / v0[:, None]
    each_r = 1 + (share[:, 0] - share[:, 1] - 5 / 7) / (5 / 7)
    each_c = (1 - share.sum(axis=1)) * 7 / 4
    return Fitted(
        Laws(*map(float, found.x)),
        Laws(*map(float, errors)),
        float(2 * found.cost / max(left.size - 3, 1)),
        (float(each_r.std(ddof=1)), float(each_c.std(ddof=1))),
    )
