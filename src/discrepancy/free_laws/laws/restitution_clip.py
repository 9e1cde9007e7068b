"""A restitution of each clip."""

from discrepancy.free_laws.law_kinds import ClipNumber


class RestitutionClip(ClipNumber):
    symbol = "r"
    owners = (("restitution", 0),)
