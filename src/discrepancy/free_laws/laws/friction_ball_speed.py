"""Sliding friction that depends on how fast the ball itself goes."""

from typing import Any

import numpy as np

from discrepancy.arrays import Array
from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.law_kinds import MotionLaw
from discrepancy.free_laws.ranges import CoveredRanges, over_speed


class FrictionBallSpeed(MotionLaw):
    symbol = "mu"
    owners = (("sliding_friction", 0),)
    bends = ("friction", "velocity")

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        return over_speed("speed of the ball", "v", covered.speeds, 0.0)

    def places(self, what: Any) -> tuple[Array, ...]:
        return (np.asarray(np.hypot(what[..., 0], what[..., 1])),)
