"""Tests the law that both balls have one rolling loss.

The struck ball shows the loss of the fits after its slide, the striker also before the hit. If the two differ, the
common loss shifts v0 and all that follows from it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tracker.measurement.collision.departures import LawDeparture, derive_quantities, find_departure
from tracker.measurement.collision.derived import QUANTITY_NAMES, DerivedValues
from tracker.measurement.collision.least_squares import CollisionFit, WhitenedResiduals

Floats = NDArray[np.float64]


def compare_losses(
    fit: CollisionFit, tied: bool, known: Floats | None = None, by_tied: LawDeparture | None = None
) -> LawDeparture | None:
    """Find by how much the struck ball's deceleration in rolling exceeds that of the striker, m/s^2.

    It is typically a share of the loss, `rolling_loss_difference` of the settings. The loss is the root of its expected
    square: noise may make the fitted loss small, but not the true one.

    known, by_tied: as for `find_departure`.
    """

    def displace(problem: WhitenedResiduals, rows: Floats) -> Floats:
        by = rows[:, problem.names.index("decel")].copy()
        by[2 * len(fit.pair.struck) :] = 0.0  # the striker's positions and the priors
        return by

    found = find_departure(fit, tied, displace, known, by_tied)
    if found is None:
        return None
    loss = float(np.hypot(*_find_loss(derive_quantities(fit, tied))))
    return replace(found, typical=fit.pair.settings.rolling_loss_difference * loss)


def _find_loss(values: DerivedValues) -> tuple[float, float]:
    """The deceleration with which the struck ball begins to roll, m/s^2, and its standard error."""
    index = [QUANTITY_NAMES.index(name) for name in ("drag", "decel", "v1f")]
    drag, decel, speed = np.nan_to_num(values.value[index])
    slope = np.array([speed, 1.0, drag])
    variance = slope @ np.nan_to_num(values.cov[np.ix_(index, index)]) @ slope
    return float(drag * speed + decel), float(np.sqrt(max(variance, 0.0)))
