"""Spin transfer that depends on the contact speed."""

from discrepancy.arrays import Array
from discrepancy.data.launch import V0
from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.law_kinds import ImpactLaw
from discrepancy.free_laws.ranges import CoveredRanges, over_speed


class SpinTransferSpeed(ImpactLaw):
    symbol = "C"
    owners = (("spin_transfer", 0),)
    bends = ("spin_transfer", "contact_speed")

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        return over_speed("contact speed", "v", covered.launches[:, V0])

    def at_impact(self, launches: Array) -> Array:
        return launches[:, V0]
