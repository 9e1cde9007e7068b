"""A spin transfer of each clip."""

from discrepancy.free_laws.free_law import ClipNumber


class SpinTransferClip(ClipNumber):
    symbol = "C"
    owners = (("spin_transfer", 0),)
