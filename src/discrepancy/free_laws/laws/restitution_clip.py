"""A restitution of each clip."""

from __future__ import annotations

from discrepancy.free_laws.free_law import ClipNumber


class RestitutionClip(ClipNumber):
    """A restitution of each clip."""

    symbol = "r"
    owners = (("restitution", 0),)
