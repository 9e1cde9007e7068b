"""Laws that the tied fit assumes and that few positions do not test: the errors of its quantities if one is broken.

Positions far from the contact, or with small errors, show a broken law: chi^2 of the fit, or one linear step from it
(`departures`), rejects it. A few positions with large errors do not. The tied fit is then still as precise as its laws
allow, and nothing shows that they hold.

So the errors contain what a broken law would change. The setting `broken_law` is the probability, before the tracks,
that one of the laws of `list_broken_laws` is broken, and all are equally likely. A break has a normal prior about zero,
whose standard deviation is its typical size. The tracks then give the posterior of each break (Bayesian model
averaging, as in `departures`), and with it the mean square of what it adds to each quantity. No value is shifted,
because such data cannot tell which law is broken.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from synthcam_shared.arrays import Array
from tracker.measurement.collision.collision_model import (
    AFTER,
    FREE,
    GRAVITY,
    SLIP_RATE,
    TIED,
    mean_positions,
    tied_to_free,
    tied_to_free_jacobian,
)
from tracker.measurement.collision.departures import LawDeparture, find_departure
from tracker.measurement.collision.derived import DerivedValues
from tracker.measurement.collision.least_squares import CollisionFit, WhitenedResiduals

FRICTION_DIFFERENCE = 0.2  # typical, of the sliding friction of two balls, relative
MASS_DIFFERENCE = 0.05  # typical, of two balls, relative
HOP_SHARE = 1.0  # typical, of the vertical impulse that the plate does not hold back
SIDE_SPIN = 0.3  # typical, R times the spin of the striker about the vertical over its speed
MAX_CONFIRMED = 0.9  # probability that no law is broken, from which on the laws count as true


def add_errors_of_untested_laws(fit: CollisionFit, values: DerivedValues, known: Array | None = None) -> DerivedValues:
    """Add to the errors of a tied fit what a broken law would change, unless the tracks confirm the laws.

    known: as for `find_departure`.
    """
    broken = find_broken_laws(fit, known)
    holds, squares = weigh_broken_laws(broken, fit.pair.settings.broken_law)
    if holds >= MAX_CONFIRMED:
        return values
    effects = np.column_stack([one.effect for one in broken.values()])
    return replace(values, cov=values.cov + (effects * squares) @ effects.T)


def weigh_broken_laws(broken: dict[str, LawDeparture], expected: float) -> tuple[float, Array]:
    """Find the probability that no law is broken, and the mean square (k,) of each break.

    At most one is broken, before the tracks with the probability `expected`. A break counts with the probability of its
    law to be broken.
    """
    if not broken or not expected:
        return 1.0, np.zeros(len(broken))
    value, std, typical = (
        np.array([getattr(one, name) for one in broken.values()]) for name in ("value", "std", "typical")
    )
    wide = std**2 + typical**2
    log_evidence = (np.log(std**2 / wide) + value**2 * (1 / std**2 - 1 / wide)) / 2
    logs = np.append(0.0, log_evidence)
    weights = np.append(1 - expected, np.full(len(broken), expected / len(broken))) * np.exp(logs - logs.max())
    weights /= weights.sum()
    mean, variance = value * typical**2 / wide, typical**2 * std**2 / wide
    return float(weights[0]), weights[1:] * (mean**2 + variance)


def find_broken_laws(fit: CollisionFit, known: Array | None = None) -> dict[str, LawDeparture]:
    """Find the break of each law of a tied fit by one linear step, without those that its parameters absorb."""
    pair = fit.pair
    free = np.asarray(tied_to_free(fit.parameters, pair.spin), dtype=np.float64)
    out = dict[str, LawDeparture]()
    for name, (change, typical) in list_broken_laws(fit).items():

        def displace(problem: WhitenedResiduals, rows: Array, change: Array = change) -> Array:
            _, slope = mean_positions(free, problem.ball, problem.start, pair.struck.exposure, pair.diameter)
            return np.append(problem.whiten((slope @ change)[None])[0], np.zeros(len(rows) - 2 * len(pair)))

        found = find_departure(fit, displace, known)
        if found is not None:
            out[name] = replace(found, typical=typical)
    return out


def list_broken_laws(fit: CollisionFit) -> dict[str, tuple[Array, float]]:
    """List laws that may be broken: the change (22,) of the free parameters per unit of the break, its typical size.

    - friction: that of the struck ball is larger by the relative break. Its slide ends earlier.
    - masses: the struck ball is heavier by the relative break. The impulse is the same if both change by half of it.
    - hop: the plate does not hold back this share of the vertical impulse between the balls. It presses the struck
      ball down and lifts the striker. Over all bounces, the friction of the plate so acts on the struck ball for a time
      P/(m g) more, at once, and on the striker for this time less.
    - side spin: that of the striker, as a share of its speed. It is no break where the fit has it as a parameter.
    """
    tied, spin = fit.parameters, fit.pair.spin
    free = np.asarray(tied_to_free(tied, spin), dtype=np.float64)
    v = {ball: free[at : at + 2] for ball, at in AFTER.items()}
    slip = {ball: SLIP_RATE * (v[ball] - free[at + 2 : at + 4]) for ball, at in AFTER.items()}
    kick = v[1] - free[-2:]  # the change of the struck ball's velocity
    twist = slip[1] - kick  # the slip that its change of spin makes
    slows = {ball: -(slip[ball] / SLIP_RATE) / np.exp(free[at + 4]) for ball, at in AFTER.items()}  # by friction, m/s^2
    more_s = 0.4 * float(np.hypot(*twist)) / GRAVITY  # P/(m g) of a share of 1
    gain = {1: more_s * slows[1], 2: -more_s * slows[2]}
    friction = np.zeros(len(FREE))
    friction[AFTER[1] + 4] = -1.0
    masses = _change_velocities(slip, {1: -kick / 2, 2: -kick / 2}, {1: -slip[1] / 2, 2: (twist - kick) / 2})
    hop = _change_velocities(slip, gain, {ball: SLIP_RATE * by for ball, by in gain.items()})
    out = {"friction": (friction, FRICTION_DIFFERENCE), "masses": (masses, MASS_DIFFERENCE), "hop": (hop, HOP_SHARE)}
    if "side" not in fit.pair.fitted_spin:
        by_side = tied_to_free_jacobian(tied, spin)[:, TIED.index("side")]
        out["side spin"] = (by_side * tied[TIED.index("v0")], SIDE_SPIN)
    return out


def _change_velocities(slip: dict[int, Array], velocity: dict[int, Array], of_slip: dict[int, Array]) -> Array:
    """The change (22,) of the free parameters by changes of the velocity and the slip of each ball after the hit."""
    out = np.zeros(len(FREE))
    for ball, at in AFTER.items():
        out[at : at + 2] = velocity[ball]
        out[at + 2 : at + 4] = velocity[ball] - of_slip[ball] / SLIP_RATE
        out[at + 4] = slip[ball] @ of_slip[ball] / max(float(slip[ball] @ slip[ball]), 1e-30)
    return out
