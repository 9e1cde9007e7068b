"""Sliding friction that depends on the slip speed."""

from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.law_kinds import MotionLaw
from discrepancy.free_laws.ranges import CoveredRanges, over_speed


class FrictionSpeed(MotionLaw):
    symbol = "mu"
    owners = (("sliding_friction", 0),)
    one_ball = True
    bends = ("friction", "slip_speed")

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        return over_speed("slip speed", "u", covered.slips, 0.0)
