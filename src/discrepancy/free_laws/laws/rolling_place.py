"""What the place adds to the rolling loss."""

from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.law_kinds import PacedLaw
from discrepancy.free_laws.ranges import FIELD, CoveredRanges, over_place


class RollingPlace(PacedLaw):
    bends = ("rolling", "position")

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        return over_place(covered.roll_places, FIELD)
