"""Spin transfer that depends on the obliqueness, the size of the impact parameter."""

import numpy as np

from discrepancy.arrays import Array
from discrepancy.data.launch import B
from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.law_kinds import ImpactLaw
from discrepancy.free_laws.ranges import CoveredRanges, over_obliqueness


class SpinTransferObliqueness(ImpactLaw):
    symbol = "C"
    owners = (("spin_transfer", 0),)
    bends = ("spin_transfer", "obliqueness")

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        return over_obliqueness(covered.launches)

    def at_impact(self, launches: Array) -> Array:
        return np.abs(launches[:, B])
