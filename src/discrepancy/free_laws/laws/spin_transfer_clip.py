"""A spin transfer of each clip."""

from __future__ import annotations

from discrepancy.free_laws.free_law import ClipNumber


class SpinTransferClip(ClipNumber):
    """A spin transfer of each clip."""

    symbol = "C"
    owners = (("spin_transfer", 0),)
