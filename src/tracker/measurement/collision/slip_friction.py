"""Tests the law that sliding friction does not depend on the speed of slip.

By mu(u) = mu (1 + k u) a ball slides more strongly at first, and rolls earlier. Such a k is hardly seen in one
collision, but the tracks cannot give mu, the friction at slow slip, without it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tracker.measurement.collision.collision_model import AFTER, SLIP_RATE, tied_to_free
from tracker.measurement.collision.departures import LawDeparture, find_departure
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.measurement.collision.least_squares import CollisionFit, WhitenedResiduals

Floats = NDArray[np.float64]


def find_slope_of_friction(
    fit: CollisionFit,
    tied: bool,
    known: Floats | None = None,
    by_tied: LawDeparture | None = None,
    *,
    expected: float = 0.03,
) -> LawDeparture | None:
    """Find k of mu(u) = mu (1 + k u), s/m, u the speed of slip. For a free fit, find only its effect on the quantities.

    It typically changes the friction at the fastest slip by `friction_change` of the settings. None if the striker
    slides up to the contact.

    known, by_tied: as for `find_departure`. expected: probability before that friction changes. One collision hardly
    distinguishes mu from k. With constant friction the median error of mu_k is 3 % larger with 0.03, 8 % with 0.08, and
    69 % with 0.5.
    """
    if fit.pair.striker_slides:
        return None
    free = np.asarray(tied_to_free(fit.parameters, fit.pair.spin), dtype=np.float64) if tied else fit.parameters
    slides = {ball: float(np.exp(free[at + 4])) for ball, at in AFTER.items()}
    changes = {ball: free[at + 2 : at + 4] - free[at : at + 2] for ball, at in AFTER.items()}
    slips = {ball: SLIP_RATE * float(np.hypot(*changes[ball])) for ball in AFTER}  # at the contact, m/s

    def displace(problem: WhitenedResiduals, rows: Floats) -> Floats:
        """A ball is ahead, along the change of its velocity, by what it gained in its slide."""
        since = problem.start + fit.pair.struck.exposure / 2 - free[0]
        out = np.zeros((len(since), 2))
        for ball, tau in slides.items():
            slide = np.clip(since, 0.0, tau)
            gain = slips[ball] / tau * (slide**2 / 2 - slide**3 / (6 * tau))
            out += np.outer((problem.ball == ball) * gain, changes[ball])
        return np.append(problem.whiten(out[None])[0], np.zeros(len(rows) - 2 * len(fit.pair)))

    found = find_departure(fit, tied, displace, known, by_tied)
    if found is None:
        return None
    effect = found.effect.copy()
    for ball, tau in slides.items():  # a slide by mu (1 + k u) ends at log(1 + k u) / (k u) of the time
        effect[QUANTITY_NAMES.index(f"tau{ball}")] -= tau * slips[ball] / 2
    typical = fit.pair.settings.friction_change / max(*slips.values(), 1e-30)
    return replace(found, effect=effect, typical=typical, expected=expected, is_shown=tied)
