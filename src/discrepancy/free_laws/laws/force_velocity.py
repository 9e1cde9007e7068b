"""A force over mass, a vector that depends on the velocity: a wind, or balls that curve."""

from typing import Any

import numpy as np

from discrepancy.arrays import Array
from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.law_kinds import MotionLaw
from discrepancy.free_laws.ranges import FIELD, CoveredRanges, over_place


class ForceVelocity(MotionLaw):
    symbol = "force over mass"
    unit = "m/s^2"
    parts = 2
    part_names = ("x", "y")
    one_ball = True
    bends = ("push", "velocity")

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        return over_place(covered.velocities, FIELD, "m/s")

    def factors(self, what: Any, speed: Any) -> Array:
        return np.broadcast_to(np.eye(2), (*what.shape, 2))
