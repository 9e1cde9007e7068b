"""Restitution that depends on the heading."""

from discrepancy.arrays import Array
from discrepancy.data.launch import HEADING
from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.law_kinds import ImpactLaw
from discrepancy.free_laws.ranges import CoveredRanges, over_heading


class RestitutionHeading(ImpactLaw):
    symbol = "r"
    owners = (("restitution", 0),)
    bends = ("restitution", "heading")

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        return over_heading()

    def at_impact(self, launches: Array) -> Array:
        return launches[:, HEADING]
