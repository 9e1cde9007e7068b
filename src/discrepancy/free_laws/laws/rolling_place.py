"""What the place adds to the rolling loss."""

from discrepancy.free_laws.basis import Axis
from discrepancy.free_laws.free_law import PacedLaw
from discrepancy.free_laws.ranges import FIELD, Ranges, over_place


class RollingPlace(PacedLaw):
    bends = ("rolling", "position")

    @staticmethod
    def over(covered: Ranges) -> tuple[Axis, ...]:
        return over_place(covered.roll_places, FIELD)
