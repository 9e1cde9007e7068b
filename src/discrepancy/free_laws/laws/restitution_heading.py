"""Restitution that depends on the heading."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from discrepancy.data.launch import HEADING
from discrepancy.free_laws.basis import Axis
from discrepancy.free_laws.free_law import ImpactLaw
from discrepancy.free_laws.ranges import Ranges, over_heading

Array = NDArray[np.float64]


class RestitutionHeading(ImpactLaw):
    """Restitution that depends on the heading."""

    symbol = "r"
    owners = (("restitution", 0),)
    bends = ("restitution", "heading")

    @staticmethod
    def over(covered: Ranges) -> tuple[Axis, ...]:
        return over_heading()

    def at_impact(self, launches: Array) -> Array:
        return launches[:, HEADING]
