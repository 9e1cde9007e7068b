"""A force over mass and speed, along the motion and across it, that depends on the heading."""

from typing import Any

import numpy as np

from discrepancy.arrays import Array
from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.law_kinds import MotionLaw
from discrepancy.free_laws.ranges import CoveredRanges, over_heading


class ForceHeading(MotionLaw):
    symbol = "force over mass and speed"
    unit = "1/s"
    parts = 2
    part_names = ("along", "across")
    bends = ("push", "velocity")

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        return over_heading()

    def factors(self, what: Any, speed: Any) -> Array:
        # in proportion to the velocity: a ball that stops feels none
        return np.stack([what, np.stack([-what[..., 1], what[..., 0]], axis=-1)], axis=-1)
