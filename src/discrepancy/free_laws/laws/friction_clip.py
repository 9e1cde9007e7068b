"""A sliding friction of each clip."""

from discrepancy.free_laws.free_law import ClipNumber


class FrictionClip(ClipNumber):
    symbol = "mu"
    owners = (("sliding_friction", 0),)
