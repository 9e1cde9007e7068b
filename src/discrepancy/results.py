"""The result of a search: `SearchResult` holds the data, writes `discrepancy.json` and calls for the report."""

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
from discrepancy.data.notes import SearchNote
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
        The collisions to fit, and those to test on.
    noise : Noise
    left_out : tuple of SearchNote
        A note for each collision, or part of one, that is not used.
    is_smoothed : bool
        True if the tracks were smoothed by a filter before the search.
    """

    clips: tuple[MeasuredCollision, ...]
    held_out: tuple[MeasuredCollision, ...]
    noise: Noise
    left_out: tuple[SearchNote, ...]
    is_smoothed: bool = False

    def without(self, outliers: Mapping[int, SearchNote]) -> SearchData:
        """Remove clips to fit, given by index, each with a note that says why."""
        clips = tuple(c for k, c in enumerate(self.clips) if k not in outliers)
        return dataclasses.replace(self, clips=clips, left_out=(*self.left_out, *outliers.values()))


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class SearchResult:
    """The result of a search for what a model lacks.

    Attributes
    ----------
    verdict : Verdict
        none, named, ambiguous, outside_library or inadequate.
    data : SearchData
        The collisions, and the estimate of their noise.
    base_fit, best_fit : ModelFit
        The fit of the given model, and the fit with all claims added.
    model : Model
        The model with the claimed effects, everything else fitted again; ``model.write(path)`` saves it. It holds the
        free law as a table if the law can be one.
    gap_fits : GapFits
        The gap on held-out collisions, with their fits.
    base_disagreements, disagreements : tuple of Disagreement
        Disagreements of the base model, and those that remain with all claims.
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
        The curve and the formula of the free law.
    model_holds_law : bool
        True if `model` holds the free law.
    accepted, rejected : tuple of ClaimTest
        The tests of accepted and of rejected claims.
    undetectable : tuple of str
        Effects that these collisions cannot show at a realistic size.
    experiment : str
        The collisions that would distinguish the effects of an alias class.
    uniform, processed : tuple of SearchNote
        Notes on conditions that are the same in all clips, and on the processing of the tracks.
    left_out : tuple of SearchNote
        A note for each collision, or part of one, that the search did not use.
    interrupted : InterruptedSearch or None
        Set if the search was cut short; it then claims nothing.

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
        """The gap on held-out collisions: before, after and floor (noise alone), as chi^2 per point and in um."""
        return self.gap_fits.gap

    @property
    def ranking(self) -> pd.DataFrame:
        """The score test of each candidate beside the base model: effect, sigma."""
        return pd.DataFrame([(c.effect, c.sigma) for c in self.scores], columns=["effect", "sigma"])

    @property
    def where(self) -> pd.DataFrame:
        """Disagreements of the base model: phase, ball, observable, sigma, against, size (um, rms)."""
        names = ["phase", "ball", "observable", "sigma", "against", "size"]
        return pd.DataFrame([[getattr(p, n) for n in names] for p in self.base_disagreements], columns=names)

    @property
    def is_empty(self) -> bool:
        """True if the search added nothing to the base model."""
        return not (self.best_fit.added_names(self.base_fit) or self.free_law)

    @property
    def is_complete(self) -> bool:
        """True if nothing more is missing; only then are the errors of the strengths valid."""
        with applied_policy(self.policy):
            return not more_is_missing(self.disagreements, self.rejected)

    def sentence(self) -> str:
        """The outcome in a few sentences, the most important first.

        Returns
        -------
        str
        """
        sentences: str = discrepancy.describe_search(self)  # lazily: `wording` imports this class
        return sentences

    def document(self) -> dict[str, Any]:
        """The contents of ``discrepancy.json``: plain values, None for numbers that are not finite.

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
                    {"claim": t.name, "own_sigma": t.sigma, "why": discrepancy.describe_rejection(t)} | t.document()
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
        """Plot the gap on held-out collisions by phase: with the base model, with all claims, and from noise alone.

        Parameters
        ----------
        ax : Axes, optional
            Axes to draw into; default: a new figure.

        Returns
        -------
        Axes
            They show the rms residual of each axis, um.
        """
        axes: Axes = discrepancy.plot_gap(self.gap, ax)
        return axes

    def report(self, folder: str | Path) -> Path:
        """Write the report: ``discrepancy.json``, ``model.yaml`` and a self-contained ``index.html``.

        Parameters
        ----------
        folder : str or Path
            The folder to write; an earlier report in it is replaced.

        Returns
        -------
        Path
            The path of ``index.html``.

        Raises
        ------
        InputError
            The folder holds something else, or cannot be written.
        """
        page: Path = discrepancy.write_report(self, Path(folder))  # lazily: the report package knows this class
        return page


def more_is_missing(left: Sequence[Disagreement], rejected: Sequence[ClaimTest]) -> bool:
    """Tell if more is missing than the claims explain; a rejected significant free law is evidence of that."""
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
    """Convert to values that JSON knows: no numpy, and None for NaN and infinity."""
    if isinstance(value, dict):
        return {k: to_json_values(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_values(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value
