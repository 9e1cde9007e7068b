"""Spin transfer that depends on the heading."""

from discrepancy.arrays import Array
from discrepancy.data.launch import HEADING
from discrepancy.free_laws.basis import Axis
from discrepancy.free_laws.free_law import ImpactLaw
from discrepancy.free_laws.ranges import Ranges, over_heading


class SpinTransferHeading(ImpactLaw):
    symbol = "C"
    owners = (("spin_transfer", 0),)
    bends = ("spin_transfer", "heading")

    @staticmethod
    def over(covered: Ranges) -> tuple[Axis, ...]:
        return over_heading()

    def at_impact(self, launches: Array) -> Array:
        return launches[:, HEADING]
