"""What the direction of motion adds to the rolling loss."""

from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.law_kinds import PacedLaw
from discrepancy.free_laws.ranges import CoveredRanges, over_heading


class RollingHeading(PacedLaw):
    bends = ("rolling", "velocity")

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        return over_heading() if len(covered.roll_speeds) else ()
