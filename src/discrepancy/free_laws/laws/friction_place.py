"""Sliding friction that depends on the place."""

from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.law_kinds import MotionLaw
from discrepancy.free_laws.ranges import MAP, CoveredRanges, over_place


class FrictionPlace(MotionLaw):
    symbol = "mu"
    owners = (("sliding_friction", 0),)
    bends = ("friction", "position")

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        return over_place(covered.slip_places, MAP)
