"""Restitution that depends on the normal speed."""

from discrepancy.arrays import Array
from discrepancy.data.launch import normal_speed
from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.law_kinds import ImpactLaw
from discrepancy.free_laws.ranges import CoveredRanges, over_speed


class RestitutionSpeed(ImpactLaw):
    symbol = "r"
    owners = (("restitution", 0),)
    bends = ("restitution", "normal_speed")

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        return over_speed("normal speed", "v_n", normal_speed(covered.launches))

    def at_impact(self, launches: Array) -> Array:
        return normal_speed(launches)
