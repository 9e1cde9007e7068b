"""Sliding friction that depends on the direction of slip."""

from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.law_kinds import MotionLaw
from discrepancy.free_laws.ranges import CoveredRanges, over_heading


class FrictionHeading(MotionLaw):
    symbol = "mu"
    owners = (("sliding_friction", 0),)
    bends = ("friction", "slip")

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        return over_heading() if len(covered.slips) else ()
