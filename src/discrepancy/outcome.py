"""The outcome of a search, as data, from which sentences, pages and `discrepancy.json` are made; and its verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from discrepancy.data.notes import SearchNote
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.law_summary import LawSummary
from discrepancy.policy import SearchPolicy
from discrepancy.preparation import SearchData
from discrepancy.select.contact_effects import ContactClaim
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.select.library_search import InterruptedSearch
from discrepancy.select.score_test import CandidateScore
from discrepancy.validate.claim_tests import ClaimTest
from discrepancy.validate.gap import Gap, GapFits
from discrepancy.validate.residual_map import Disagreement, is_unexplained
from synthcam.model import Model


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
    *,
    is_within_noise: bool = False,
) -> Verdict:
    """Decide the verdict.

    claims, has_law: the effects, and whether a free law, that passed; left: the disagreements that remain with them. A
    rejected test below `unexplained_sigma` may be chance or a bad clip. It does not show that something is missing.
    is_within_noise: the base model leaves no more than noise on held-out data. Then no rejected test shows it either:
    the candidate only fits what its own data happen to have.
    """
    if has_law or (claims and more_is_missing(left, rejected, policy)):
        return Verdict.OUTSIDE_LIBRARY
    if not claims:
        strong = any(t.sigma > policy.unexplained_sigma for t in rejected) and not is_within_noise
        return Verdict.INADEQUATE if strong or is_unexplained(left, policy) else Verdict.NONE
    return Verdict.AMBIGUOUS if any(len(c.aliases) > 1 for c in claims) else Verdict.NAMED


def more_is_missing(left: Sequence[Disagreement], rejected: Sequence[ClaimTest], policy: SearchPolicy) -> bool:
    """Tell, for the verdict, if more is missing than the claims explain, as a rejected significant free law shows."""
    law_rejected = any(t.is_free_law and t.sigma > policy.unexplained_sigma for t in rejected)
    return law_rejected or is_unexplained(left, policy)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class SearchOutcome:
    """The data of a `SearchResult`, which documents each field."""

    verdict: Verdict
    data: SearchData
    base_fit: ModelFit
    best_fit: ModelFit
    model: Model
    gap_fits: GapFits
    base_disagreements: tuple[Disagreement, ...]
    disagreements: tuple[Disagreement, ...]
    scores: tuple[CandidateScore, ...]
    required_sigma: float
    policy: SearchPolicy
    claims: tuple[EffectClaim, ...] = ()
    free_law: FittedLaw | None = None
    law_summary: LawSummary | None = None
    model_holds_law: bool = False
    accepted: tuple[ClaimTest, ...] = ()
    rejected: tuple[ClaimTest, ...] = ()
    undetectable: tuple[str, ...] = ()
    experiment: str = ""
    uniform: tuple[SearchNote, ...] = ()
    processed: tuple[SearchNote, ...] = ()
    left_out: tuple[SearchNote, ...] = ()
    interrupted: InterruptedSearch | None = None
    contacts: tuple[ContactClaim, ...] = ()
    measured: str = ""
    base_model: str = ""

    @property
    def gap(self) -> Gap:
        """The gap on held-out collisions: before, after and floor (noise alone), as chi^2 per point and in um."""
        return self.gap_fits.gap

    @property
    def is_empty(self) -> bool:
        """True if the search added nothing to the base model."""
        return not (self.best_fit.added_names(self.base_fit) or self.free_law)

    @property
    def is_complete(self) -> bool:
        """True if nothing more is missing; only then are the errors of the strengths valid."""
        return not more_is_missing(self.disagreements, self.rejected, self.policy)
