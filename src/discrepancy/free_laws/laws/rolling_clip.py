"""A rolling loss at rest of each clip."""

from __future__ import annotations

from discrepancy.free_laws.free_law import ClipNumber


class RollingClip(ClipNumber):
    """A rolling loss at rest of each clip."""

    symbol = "rolling loss at rest"
    unit = "m/s^2"
    owners = (("rolling_decel", 0),)
