"""A rolling loss at rest of each clip."""

from discrepancy.free_laws.law_kinds import ClipNumber


class RollingClip(ClipNumber):
    symbol = "rolling loss at rest"
    unit = "m/s^2"
    owners = (("rolling_decel", 0),)
