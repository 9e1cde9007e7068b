"""Sliding friction that depends on the direction of slip."""

from discrepancy.free_laws.basis import Axis
from discrepancy.free_laws.free_law import MotionLaw
from discrepancy.free_laws.ranges import Ranges, over_heading


class FrictionHeading(MotionLaw):
    symbol = "mu"
    owners = (("sliding_friction", 0),)
    bends = ("friction", "slip")

    @staticmethod
    def over(covered: Ranges) -> tuple[Axis, ...]:
        return over_heading() if len(covered.slips) else ()
