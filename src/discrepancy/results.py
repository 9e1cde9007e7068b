"""What a search found: `SearchResult` carries data alone, puts itself into words, and writes its report."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

import discrepancy
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.notes import SearchNote, SearchNoteKind
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.law_summary import LawSummary
from discrepancy.noise.model import Noise
from discrepancy.policy import SearchPolicy, applied_policy, current_policy
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.select.library_search import InterruptedSearch
from discrepancy.select.score_test import CandidateScore
from discrepancy.validate.claim_tests import ClaimTest
from discrepancy.validate.gap import Gap, GapFits
from discrepancy.validate.residual_map import Disagreement, is_unexplained
from discrepancy.wording import (
    NO_EFFECT_NAMED_WHEN_SMOOTHED,
    describe_claim,
    describe_disagreement,
    describe_gap,
    describe_rejection,
    describe_rejections,
    describe_slow_noise,
)
from synthcam.model import Model

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Verdict(StrEnum):
    """The outcome of a search; docs/discrepancy.md explains each."""

    NONE = "none"
    NAMED = "named"
    AMBIGUOUS = "ambiguous"
    OUTSIDE_LIBRARY = "outside_library"
    INADEQUATE = "inadequate"


@dataclass(frozen=True)
class SearchData:
    """The collisions of a search and their noise.

    Attributes
    ----------
    clips, held_out : tuple of MeasuredCollision
        To fit, and to test on.
    noise : Noise
    left_out : tuple of SearchNote
        A note for each collision, or part of one, that is not used.
    is_smoothed : bool
        Whether somebody has put the tracks through a filter.
    """

    clips: tuple[MeasuredCollision, ...]
    held_out: tuple[MeasuredCollision, ...]
    noise: Noise
    left_out: tuple[SearchNote, ...]
    is_smoothed: bool = False

    def without(self, outliers: Mapping[int, SearchNote]) -> SearchData:
        """Without some of the clips to fit, by their index, each with a note that says why."""
        clips = tuple(c for k, c in enumerate(self.clips) if k not in outliers)
        return dataclasses.replace(self, clips=clips, left_out=(*self.left_out, *outliers.values()))


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class SearchResult:
    """What a search found missing in a model.

    Attributes
    ----------
    verdict : Verdict
        none, named, ambiguous, outside_library or inadequate.
    data : SearchData
        The collisions, and the estimate of their noise.
    base_fit, best_fit : ModelFit
        The fit of the given model, and the fit with everything that was found.
    model : Model
        The model with the claimed effects, everything else fitted again; ``model.write(path)`` keeps it. It holds a
        free law as a table where a model can.
    gap_fits : GapFits
        The gap on held-out collisions, with their fits.
    base_disagreements, disagreements : tuple of Disagreement
        Where the base model disagrees, and where everything that was found still does.
    scores : tuple of CandidateScore
        The score tests of all candidates against the base model, most significant first.
    required_sigma : float
        The sigma that a claim needs.
    policy : SearchPolicy
        The thresholds that decided.
    claims : tuple of EffectClaim
        The effects that the search names, each with its values, their errors (`std`), `sigma`, and `aliases`.
    free_law : FittedLaw or None
        The law outside the library that explains what no effect does.
    law_summary : LawSummary or None
        Its curve and formula.
    model_holds_law : bool
        Whether `model` has the free law.
    accepted, rejected : tuple of ClaimTest
        The tests of the claims that passed, and of those that failed.
    undetectable : tuple of str
        Effects that these collisions cannot show at any realistic size.
    experiment : str
        The collisions that would distinguish the effects of an alias class.
    uniform, processed : tuple of SearchNote
        What such clips cannot show because they are all the same in it, and what was done to the tracks.
    left_out : tuple of SearchNote
        A note for each collision, or part of one, that the search did not use.
    interrupted : InterruptedSearch or None
        Set if the search was cut short; it then names nothing.

    Examples
    --------
    >>> import discrepancy
    >>> found = discrepancy.find("out/results", "painter_behringer")  # doctest: +SKIP
    >>> found.verdict, found.gap.closure  # doctest: +SKIP
    """

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

    @property
    def named(self) -> tuple[EffectClaim, ...]:
        """The claims, under their earlier name."""
        return self.claims

    @property
    def gap(self) -> Gap:
        """On held-out collisions: before, after and floor (noise alone), chi^2 per point; the same in um."""
        return self.gap_fits.gap

    @property
    def ranking(self) -> pd.DataFrame:
        """Score of each candidate against the base model alone: effect, sigma."""
        return pd.DataFrame([(c.effect, c.sigma) for c in self.scores], columns=["effect", "sigma"])

    @property
    def where(self) -> pd.DataFrame:
        """Where measurement and base model disagree: phase, ball, observable, sigma, against, size (um, rms)."""
        names = ["phase", "ball", "observable", "sigma", "against", "size"]
        return pd.DataFrame([[getattr(p, n) for n in names] for p in self.base_disagreements], columns=names)

    @property
    def is_empty(self) -> bool:
        """Whether nothing was found beside the base model."""
        return not (self.best_fit.added_names(self.base_fit) or self.free_law)

    @property
    def is_complete(self) -> bool:
        """Whether nothing more is missing: only then do errors of the strengths hold."""
        with applied_policy(self.policy):
            return not more_is_missing(self.disagreements, self.rejected)

    def sentence(self) -> str:
        """The outcome in a few sentences, the most important first.

        Returns
        -------
        str
        """
        with applied_policy(self.policy):
            return self._sentence()

    def _sentence(self) -> str:
        slow, rejected = describe_slow_noise(self.data.noise), describe_rejections(self.rejected)
        left = self.disagreements
        worst = f"{describe_disagreement(left[0])} ({left[0].sigma:.0f} sigma)" if is_unexplained(left) else ""
        if self.interrupted:
            return self._describe_interruption(self.interrupted)
        if self.data.is_smoothed:
            largest = "" if self.verdict is Verdict.NONE else f" The largest disagreement: {worst}."
            return f"{NO_EFFECT_NAMED_WHEN_SMOOTHED}: {SearchNote(SearchNoteKind.SMOOTHED)}.{largest}{slow}"
        if self.verdict is Verdict.NONE:
            return f"Nothing is missing: model and measurement agree to within the noise.{rejected}{slow}"
        if self.verdict is Verdict.INADEQUATE:
            largest = f" The largest disagreement: {worst}." if worst else ""
            return f"Something is missing, and no candidate passes the held-out test.{largest}{rejected}{slow}"
        base = self.base_fit.model
        missing = [describe_claim(c, base) for c in self.claims if not c.is_in(base)]
        wrong = [describe_claim(c, base) for c in self.claims if c.is_in(base)]
        parts = []
        if self.free_law and self.law_summary:
            law = self.law_summary
            parts.append(
                f"Missing law: {law.description}, which no effect of the library makes "
                f"({self.free_law.sigma:.0f} sigma)."
            )
        parts += [f"Missing effect: {words}." for words in missing] + [f"Wrong value: {words}." for words in wrong]
        if self.free_law and self.law_summary:
            parts.append(f"Proposed formula: {self.law_summary.formula}. {self._where_law_is(self.free_law)}.")
        elif self.verdict is Verdict.OUTSIDE_LIBRARY:
            where = f": {worst}" if worst else ""
            parts.append(f"Something else is missing that neither the library nor a free law explains{where}.")
        return " ".join([*parts, describe_gap(self.gap)]) + rejected + slow

    def _where_law_is(self, free_law: FittedLaw) -> str:
        if free_law.law.frees:
            return f"model.yaml leaves {free_law.law.frees} free"
        return "model.yaml holds its curve" if self.model_holds_law else "model.yaml cannot hold it"

    def _describe_interruption(self, tried: InterruptedSearch) -> str:
        base = self.base_fit
        start = (
            f"The search was cut short after {tried.seconds / 60:.3g} minutes and names nothing. The base model has "
            f"chi^2 per point {base.chi2 / base.points:.3g}"
        )
        if not tried.effects:
            return f"{start}; no model tried so far has less."
        return f"{start}, with {', '.join(tried.effects)} {tried.chi2:.3g}; that was not tested on held-out collisions."

    def document(self) -> dict[str, Any]:
        """The contents of ``discrepancy.json``: plain values, None for what is not finite.

        Returns
        -------
        dict
            docs/format.md describes the keys.
        """
        noise, law = self.data.noise, self.law_summary
        document: dict[str, Any] = to_json_values(
            {
                "verdict": str(self.verdict),
                "named": [_claim_document(c) for c in self.claims],
                "aliases": [list(c.aliases) for c in self.claims if len(c.aliases) > 1],
                "outside": [law.document() | {"in_model": self.model_holds_law}] if law else [],
                "where": [vars(p) for p in self.base_disagreements],
                "left": [vars(p) for p in self.disagreements],
                "ranking": [{"effect": c.effect, "sigma": c.sigma} for c in self.scores],
                "claim": self.required_sigma,
                "undetectable": list(self.undetectable),
                "untold": list(self.undetectable),  # its former name, kept for one version
                "alike": list(map(str, self.uniform)),
                "processed": list(map(str, self.processed)),
                "withdrawn": [
                    {"claim": t.name, "own_sigma": t.sigma, "why": describe_rejection(t)} | t.document()
                    for t in self.rejected
                ],
                "gap": dataclasses.asdict(self.gap) | {"by_claim": {t.name: t.document() for t in self.accepted}},
                "experiment": self.experiment,
                "cut_short": vars(self.interrupted) if self.interrupted else None,
                "noise": {"scale": noise.scale, "quick": noise.innovation_scale, "correlation": noise.correlation}
                | {"shake": noise.common_mode_rms}
                | ({"over_phases": noise.whole_phase_scale} if noise.whole_phase_scale else {}),
                "clips": {
                    "fitted": len(self.data.clips),
                    "kept_out": len(self.data.held_out),
                    "left_out": list(map(str, self.left_out)),
                },
            }
        )
        changed = self.policy.changed()
        return document | ({"policy": changed} if changed else {})

    def __repr__(self) -> str:
        used = len(self.data.clips) + len(self.data.held_out)
        return f"{self.verdict}, from {used} collisions. {self.sentence()}"

    def _repr_html_(self) -> str:
        rows = [
            (name, c.values.get(name, c.shapes.get(name)), {**c.std, **c.shape_std}[name], c.sigma)
            for c in self.claims
            for name in (*c.values, *c.shapes)
        ]
        table = pd.DataFrame(rows, columns=["parameter", "value", "std", "sigma of the effect"])
        return f"<p>{self!r}</p>" + (table.to_html(index=False, float_format="{:.3g}".format) if rows else "")

    def plot_gap(self, ax: Axes | None = None) -> Axes:
        """Plot the gap on held-out collisions by phase: with the base model, with what was found, from noise alone.

        Parameters
        ----------
        ax : Axes, optional
            Where to draw; default: a new figure.

        Returns
        -------
        Axes
            Residuals, rms, each axis, um.
        """
        axes: Axes = discrepancy.plot_gap(self.gap, ax)
        return axes

    def report(self, folder: str | Path) -> Path:
        """Write the report: ``discrepancy.json``, ``model.yaml`` and a self-contained ``index.html``.

        Parameters
        ----------
        folder : str or Path
            Made, or replaced where it holds an earlier report.

        Returns
        -------
        Path
            Of ``index.html``.

        Raises
        ------
        InputError
            Where the folder holds something else, or cannot be written.
        """
        page: Path = discrepancy.write_report(self, Path(folder))  # lazily: the report package knows this class
        return page


def more_is_missing(left: Sequence[Disagreement], rejected: Sequence[ClaimTest]) -> bool:
    """Whether something is missing beside everything that was found; a rejected free law is a sign of it."""
    limit = current_policy().unexplained_sigma
    return is_unexplained(left) or any(t.is_free_law and t.sigma > limit for t in rejected)


def _claim_document(claim: EffectClaim) -> dict[str, Any]:
    return {
        "effect": claim.effect,
        "parameters": claim.values | claim.shapes,
        "std": {k: np.nan if claim.at_limit(k) else std for k, std in (claim.std | claim.shape_std).items()},
        "at_limit": [k for k in claim.values if claim.at_limit(k)],
        "sigma": claim.sigma,
        "limit": claim.limit,
        "naming_limit": claim.naming,
        "alike": [{"effects": list(names), "cosine": cosine} for names, cosine in claim.alike],
    }


def to_json_values(value: Any) -> Any:
    """For JSON: no numpy, NaN and infinity as null."""
    if isinstance(value, dict):
        return {k: to_json_values(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_values(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value
