"""A force over mass along the motion that depends on the speed."""

from typing import Any

import numpy as np

from discrepancy.arrays import Array
from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.law_kinds import MotionLaw
from discrepancy.free_laws.ranges import CoveredRanges, over_speed


class ForceSpeed(MotionLaw):
    symbol = "force over mass"
    unit = "m/s^2"
    one_ball = True
    bends = ("push", "velocity")

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        return over_speed("speed", "v", covered.speeds, 0.0)

    @property
    def title(self) -> str:
        return f"{self.symbol}{self.ball_suffix} along the motion"

    def places(self, what: Any) -> tuple[Array, ...]:
        return (np.asarray(np.hypot(what[..., 0], what[..., 1])),)

    def factors(self, what: Any, speed: Any) -> Array:
        size = np.maximum(np.hypot(what[..., 0], what[..., 1]), 1e-9)
        return np.asarray((what / size[..., None])[..., None])
