"""Spin transfer that depends on the obliqueness, the size of the impact parameter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from discrepancy.data.launch import B
from discrepancy.free_laws.basis import Axis
from discrepancy.free_laws.free_law import ImpactLaw
from discrepancy.free_laws.ranges import Ranges, over_obliqueness

Array = NDArray[np.float64]


class SpinTransferObliqueness(ImpactLaw):
    """Spin transfer that depends on the obliqueness, the size of the impact parameter."""

    symbol = "C"
    owners = (("spin_transfer", 0),)
    bends = ("spin_transfer", "obliqueness")

    @staticmethod
    def over(covered: Ranges) -> tuple[Axis, ...]:
        return over_obliqueness(covered.launches)

    def at_impact(self, launches: Array) -> Array:
        return np.abs(launches[:, B])
