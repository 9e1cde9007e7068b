"""The result of a search for users: its sentence, `discrepancy.json`, the plot of the gap, the report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.axes import Axes

from discrepancy.outcome import SearchOutcome
from discrepancy.report.document import to_document
from discrepancy.report.figures import plot_gap
from discrepancy.report.search_page import write_report
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.wording import describe_search


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class SearchResult(SearchOutcome):
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
        Effects that these collisions would show only above ten times a realistic size (`max_detection_limit` of the
        policy), or not at all.
    experiment : str
        The collisions that would distinguish the effects of an alias class.
    uniform, processed : tuple of SearchNote
        Notes on conditions that are the same in all clips, and on the processing of the tracks.
    left_out : tuple of SearchNote
        A note for each collision, or part of one, that the search did not use.
    interrupted : InterruptedSearch or None
        Set if the search was cut short; it then claims nothing.
    contacts : tuple of ContactClaim
        With stretches: the laws of restitution, friction and recoil that the contacts support.
    measured, base_model : str
        The paths of the tracks and of the model, for the report; empty if they were given as objects.

    Examples
    --------
    >>> import discrepancy
    >>> found = discrepancy.find("out/results", "painter_behringer")  # doctest: +SKIP
    >>> found.verdict, found.gap.closure  # doctest: +SKIP
    """

    @property
    def named(self) -> tuple[EffectClaim, ...]:
        """The claims, under their earlier name."""
        return self.claims

    @property
    def ranking(self) -> pd.DataFrame:
        """The score test of each candidate beside the base model: effect, sigma."""
        return pd.DataFrame([(c.effect, c.sigma) for c in self.scores], columns=["effect", "sigma"])

    @property
    def where(self) -> pd.DataFrame:
        """Disagreements of the base model: phase, ball, observable, sigma, against, size (um, rms)."""
        names = ["phase", "ball", "observable", "sigma", "against", "size"]
        return pd.DataFrame([[getattr(p, n) for n in names] for p in self.base_disagreements], columns=names)

    def sentence(self) -> str:
        """The outcome in a few sentences, the most important first.

        Returns
        -------
        str
        """
        return describe_search(self)

    def document(self) -> dict[str, Any]:
        """The contents of ``discrepancy.json``: plain values, None for numbers that are not finite.

        Returns
        -------
        dict
            docs/format.md describes the keys.
        """
        return to_document(self)

    def __repr__(self) -> str:
        used = len(self.data.clips) + len(self.data.held_out)
        return f"{self.verdict}, from {used} {self.data.unit}. {self.sentence()}"

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
        return plot_gap(self.gap, ax)

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
        return write_report(self, Path(folder))
