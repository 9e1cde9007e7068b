"""What the direction of motion adds to the rolling loss."""

from discrepancy.free_laws.basis import Axis
from discrepancy.free_laws.free_law import PacedLaw
from discrepancy.free_laws.ranges import Ranges, over_heading


class RollingHeading(PacedLaw):
    bends = ("rolling", "velocity")

    @staticmethod
    def over(covered: Ranges) -> tuple[Axis, ...]:
        return over_heading() if len(covered.roll_speeds) else ()
