"""A sliding friction of each clip."""

from __future__ import annotations

from discrepancy.free_laws.free_law import ClipNumber


class FrictionClip(ClipNumber):
    """A sliding friction of each clip."""

    symbol = "mu"
    owners = (("sliding_friction", 0),)
