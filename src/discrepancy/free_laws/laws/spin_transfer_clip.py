"""A spin transfer of each clip."""

from discrepancy.free_laws.law_kinds import ClipNumber


class SpinTransferClip(ClipNumber):
    symbol = "C"
    owners = (("spin_transfer", 0),)
