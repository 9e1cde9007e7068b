"""A rolling loss that depends on the speed."""

from discrepancy.free_laws.basis import Axis
from discrepancy.free_laws.free_law import MotionLaw
from discrepancy.free_laws.ranges import Ranges, over_speed


class RollingSpeed(MotionLaw):
    symbol = "rolling loss"
    unit = "m/s^2"
    owners = (("rolling_decel", 0), ("rolling_drag", 1))
    one_ball = True
    bends = ("rolling", "speed")

    @staticmethod
    def over(covered: Ranges) -> tuple[Axis, ...]:
        return over_speed("speed", "v", covered.roll_speeds, 0.0)
