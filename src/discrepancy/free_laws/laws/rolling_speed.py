"""A rolling loss that depends on the speed."""

from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.law_kinds import MotionLaw
from discrepancy.free_laws.ranges import CoveredRanges, over_speed


class RollingSpeed(MotionLaw):
    symbol = "rolling loss"
    unit = "m/s^2"
    owners = (("rolling_decel", 0), ("rolling_drag", 1))
    one_ball = True
    bends = ("rolling", "speed")

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        return over_speed("speed", "v", covered.roll_speeds, 0.0)
