"""Sliding friction that depends on how fast the ball itself goes."""

from typing import Any

import numpy as np

from discrepancy.arrays import Array
from discrepancy.free_laws.basis import Axis
from discrepancy.free_laws.free_law import MotionLaw
from discrepancy.free_laws.ranges import Ranges, over_speed


class FrictionBallSpeed(MotionLaw):
    symbol = "mu"
    owners = (("sliding_friction", 0),)
    bends = ("friction", "velocity")

    @staticmethod
    def over(covered: Ranges) -> tuple[Axis, ...]:
        return over_speed("speed of the ball", "v", covered.speeds, 0.0)

    def places(self, what: Any) -> tuple[Array, ...]:
        return (np.asarray(np.hypot(what[..., 0], what[..., 1])),)
