"""A restitution of each clip."""

from discrepancy.free_laws.free_law import ClipNumber


class RestitutionClip(ClipNumber):
    symbol = "r"
    owners = (("restitution", 0),)
