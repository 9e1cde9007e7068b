"""The verdict of a search, from its claims, its free law, and what remains unexplained."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

from discrepancy.policy import SearchPolicy
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.validate.claim_tests import ClaimTest
from discrepancy.validate.residual_map import Disagreement, is_unexplained


class Verdict(StrEnum):
    """The outcome of a search; docs/discrepancy.md explains each."""

    NONE = "none"
    NAMED = "named"
    AMBIGUOUS = "ambiguous"
    OUTSIDE_LIBRARY = "outside_library"
    INADEQUATE = "inadequate"


def decide_verdict(
    claims: Sequence[EffectClaim],
    has_law: bool,
    left: Sequence[Disagreement],
    rejected: Sequence[ClaimTest],
    policy: SearchPolicy,
) -> Verdict:
    """Decide the verdict.

    claims, has_law: the effects, and whether a free law, that passed; left: the disagreements that remain with them. A
    rejected test below `unexplained_sigma` may be chance or a bad clip. It does not show that something is missing.
    """
    if has_law or (claims and more_is_missing(left, rejected, policy)):
        return Verdict.OUTSIDE_LIBRARY
    if not claims:
        missing = is_unexplained(left, policy) or any(t.sigma > policy.unexplained_sigma for t in rejected)
        return Verdict.INADEQUATE if missing else Verdict.NONE
    return Verdict.AMBIGUOUS if any(len(c.aliases) > 1 for c in claims) else Verdict.NAMED


def more_is_missing(left: Sequence[Disagreement], rejected: Sequence[ClaimTest], policy: SearchPolicy) -> bool:
    """Tell, for the verdict, if more is missing than the claims explain, as a rejected significant free law shows."""
    law_rejected = any(t.is_free_law and t.sigma > policy.unexplained_sigma for t in rejected)
    return law_rejected or is_unexplained(left, policy)
