"""Sliding friction that depends on the place."""

from discrepancy.free_laws.basis import Axis
from discrepancy.free_laws.free_law import MotionLaw
from discrepancy.free_laws.ranges import MAP, Ranges, over_place


class FrictionPlace(MotionLaw):
    symbol = "mu"
    owners = (("sliding_friction", 0),)
    bends = ("friction", "position")

    @staticmethod
    def over(covered: Ranges) -> tuple[Axis, ...]:
        return over_place(covered.slip_places, MAP)
