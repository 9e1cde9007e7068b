"""Laws of the force in a contact that lasts: how well each of five throws balls back against friction.

While two balls touch, plate friction presses them together, and the line of centres turns. The force gives back a part
of what these cost. How large a part depends on the law of the force, which tracks hardly show. So the normal motion is
integrated for five laws from the literature on granular matter. Lengths, times and speeds are in units in which the
balls close at speed 1.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from synthcam_shared.arrays import Array, Flags

# Force F against the depth x and its rate v, loss c:
# 0, 1: a linear spring with a dashpot, x + 2 c v, until the depth is 0, or until the force is 0;
# 2: of Hertz with a dashpot x^.25 v (Tsuji et al. 1992); 3: with a dashpot x^.5 v (Kuwabara and Kono 1987);
# 4: straight loading, and unloading that is steeper by 1/c^2 and leaves a dent (Walton and Braun 1986).
LARGEST_LOSSES = (0.9, 0.9, 4.0, 4.0)  # of the first four; that of dents is the restitution
LEAST_RESTITUTION = 0.1
TIME_STEP = 0.06
MAX_TIME = 12.0


def solve_restitutions(ratio: Array, friction: Array, tangent: Array, way: Array) -> Array:
    """Solve for the restitution (n, 5) by each law, of balls that roll up to the contact and slide in it.

    - ratio (n,): of the radial speeds at which the balls leave and enter one diameter.
    - friction (n,): how much plate friction changes the radial speed within a diameter, over the closing speed.
    - tangent (n,): of the angle between approach and line of centres.
    - way (n,): closing speed times duration, in diameters.
    """
    # of the restitution to which the losses belong; that of the result is at most a fiftieth of the laws' spread
    table, tolerance = _tabulate_losses(), 1e-3
    lasts, delta = np.full((len(ratio), 5), np.nan), np.zeros((len(ratio), 5))
    for _ in range(6):
        guess = np.clip(ratio[:, None] + delta, LEAST_RESTITUTION, 1.0)
        loss = np.stack([np.interp(guess[:, k], *table[k, :2]) for k in range(5)], -1)
        free = np.stack([np.interp(guess[:, k], table[k, 0], table[k, 2]) for k in range(5)], -1)
        lasts = np.where(np.isfinite(lasts), lasts, free)
        push, turn = friction[:, None] / lasts, (tangent**2 * way)[:, None] / lasts
        thrown, lasts = _throw_back(loss, push, turn, way[:, None] / lasts)
        # friction may keep balls of this restitution together, so that it is larger
        before, delta = delta, np.where(np.isfinite(thrown), guess - thrown, delta + 0.15)
        if np.max(np.abs(delta - before)) < tolerance:
            break
    unhindered, _ = _throw_back(loss, *np.zeros((3, *loss.shape)))  # with the same errors of table and steps
    return np.asarray(ratio[:, None] + np.where(np.isfinite(thrown), unhindered - thrown, delta))


@lru_cache(maxsize=1)
def _tabulate_losses() -> Array:
    """(5, 3, m): for each law ascending restitutions, their losses, and how long the balls are within a diameter."""
    share = np.linspace(0, 1, 60)
    dents = LEAST_RESTITUTION + (1 - LEAST_RESTITUTION) * share
    losses = np.stack([*(most * share[::-1] ** 2 for most in LARGEST_LOSSES), dents], -1)
    zero = np.zeros_like(losses)
    thrown, lasts = _throw_back(losses, zero, zero, zero)
    return np.stack([thrown, losses, lasts], 1).transpose(2, 1, 0)


def _throw_back(loss: Array, push: Array, turn: Array, way: Array) -> tuple[Array, Array]:
    """Integrate contacts (n, 5): speeds at which the balls leave one diameter, and how long they are nearer.

    The speed is NaN where the balls do not part.

    - push: acceleration by the friction of both balls.
    - turn: centrifugal acceleration at a diameter.
    - way: the unit of depth, in diameters.
    """
    shape = loss.shape
    x, v, slip, deepest = np.zeros(shape), np.ones(shape), np.zeros(shape), np.zeros(shape)
    ended, may_end = np.zeros(shape, dtype=bool), np.arange(5) > 0
    parting, lasts = np.full(shape, np.nan), np.full(shape, np.nan)

    def accelerate(x: Array, v: Array, slip: Array) -> tuple[Array, Array]:
        """Change of the closing speed and of the slip."""
        force = np.where(ended, 0.0, _press(x, v, loss, deepest))
        slides = ended | (slip > 0) | (force > 3.5 * push)  # balls roll until the force exceeds 7/2 of the friction
        pressed = np.where(slides, push, force / 3.5)
        return pressed - force - turn / (1 - x * way) ** 3, np.where(slides, force - 3.5 * push, 0.0)

    h = TIME_STEP
    for step in range(round(MAX_TIME / TIME_STEP)):
        a1, s1 = accelerate(x, v, slip)
        a2, s2 = accelerate(x + h / 2 * v, v + h / 2 * a1, slip + h / 2 * s1)
        a3, s3 = accelerate(x + h / 2 * (v + h / 2 * a1), v + h / 2 * a2, slip + h / 2 * s2)
        a4, s4 = accelerate(x + h * (v + h / 2 * a2), v + h * a3, slip + h * s3)
        old, fast = x, v
        x = x + h * v + h**2 / 6 * (a1 + a2 + a3)
        v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        slip = np.maximum(slip + h / 6 * (s1 + 2 * s2 + 2 * s3 + s4), 0.0)
        deepest = np.maximum(deepest, x)
        out: Flags = (x <= 0) & np.isnan(lasts)
        share = old / np.where(out, old - x, 1.0)
        parting, lasts = np.where(out, -(fast + share * (v - fast)), parting), np.where(out, h * (step + share), lasts)
        if np.isfinite(lasts).all():
            break
        ended |= (_press(x, v, loss, deepest) <= 0) & (v < 0) & may_end
        x = np.where(np.isnan(lasts), x, 0.0)  # the rest does not count
    return parting, lasts


def _press(x: Array, v: Array, loss: Array, deepest: Array) -> Array:
    """The force of each law (n, 5); the first may pull."""
    spring = x[:, :2] + 2 * loss[:, :2] * v[:, :2]
    deep = np.maximum(x[:, 2:4], 0.0)
    hertz = deep**1.5 + loss[:, 2:4] * deep ** np.array([0.25, 0.5]) * v[:, 2:4]
    dent = np.where(x[:, 4] >= deepest[:, 4], x[:, 4], deepest[:, 4] - (deepest[:, 4] - x[:, 4]) / loss[:, 4] ** 2)
    force = np.concatenate([spring, hertz, dent[:, None]], axis=1)
    force[:, 1:] = np.maximum(force[:, 1:], 0.0)
    return np.asarray(force)
