"""Restitution that depends on the obliqueness, the size of the impact parameter."""

import numpy as np

from discrepancy.arrays import Array
from discrepancy.data.launch import B
from discrepancy.free_laws.basis import Axis
from discrepancy.free_laws.free_law import ImpactLaw
from discrepancy.free_laws.ranges import Ranges, over_obliqueness


class RestitutionObliqueness(ImpactLaw):
    symbol = "r"
    owners = (("restitution", 0),)
    bends = ("restitution", "obliqueness")

    @staticmethod
    def over(covered: Ranges) -> tuple[Axis, ...]:
        return over_obliqueness(covered.launches)

    def at_impact(self, launches: Array) -> Array:
        return np.abs(launches[:, B])
