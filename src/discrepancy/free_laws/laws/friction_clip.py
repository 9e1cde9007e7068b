"""A sliding friction of each clip."""

from discrepancy.free_laws.law_kinds import ClipNumber


class FrictionClip(ClipNumber):
    symbol = "mu"
    owners = (("sliding_friction", 0),)
