"""The search for people: from results, a folder or a table to a verdict, with tables, a plot and a report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
from threadpoolctl import threadpool_limits

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.reading import read_collisions
from discrepancy.fitting.base_fit import Progress
from discrepancy.found import SearchResult
from discrepancy.policy import SearchPolicy, applied_policy
from discrepancy.report import search_page
from discrepancy.report.figures import draw_gap_bars
from discrepancy.search import find as search
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.validate.gap import Gap
from synthcam.model import Model, as_model
from synthcam_shared.report.folder import replace_folder

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from tracker.recording import Result


@dataclass(frozen=True, eq=False, repr=False)
class Finding:
    """What a search found missing in a model.

    Attributes
    ----------
    outcome : SearchResult
        All of it: fits, noise, candidates, claims.
    left_out : tuple of str
        A line for each collision, or part of one, that had no part in the search.
    """

    outcome: SearchResult
    left_out: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """none, named, ambiguous, outside_library or inadequate; docs/discrepancy.md says what each means."""
        return self.outcome.verdict

    @property
    def named(self) -> tuple[EffectClaim, ...]:
        """The effects named, each with its values, their errors (`std`), `sigma`, and `aliases` that fit as well."""
        return self.outcome.named

    @property
    def model(self) -> Model:
        """The model with the named effects added and all else fitted again; ``model.write(path)`` keeps it."""
        return self.outcome.model

    @property
    def gap(self) -> Gap:
        """On collisions kept out of every fit: before, after and floor (noise alone), chi^2 a point; the same in um."""
        return self.outcome.shown.gap

    @property
    def ranking(self) -> pd.DataFrame:
        """Score of each candidate against the base model alone: effect, sigma."""
        rows = [(c.effect, c.sigma) for c in self.outcome.selected.ranking]
        return pd.DataFrame(rows, columns=["effect", "sigma"])

    @property
    def where(self) -> pd.DataFrame:
        """Where measurement and base model disagree: phase, ball, observable, sigma, against, size (um, rms)."""
        names = ["phase", "ball", "observable", "sigma", "against", "size"]
        return pd.DataFrame([[getattr(p, n) for n in names] for p in self.outcome.where], columns=names)

    def sentence(self) -> str:
        """The outcome in one sentence.

        Returns
        -------
        str
        """
        return self.outcome.sentence()

    def document(self) -> dict[str, Any]:
        """The contents of ``discrepancy.json``.

        Returns
        -------
        dict
            docs/discrepancy.md describes the keys.
        """
        return search_page.document(self.outcome, self.left_out)

    def __repr__(self) -> str:
        used = len(self.outcome.data.clips) + len(self.outcome.data.kept_out)
        return f"{self.verdict}, from {used} collisions. {self.sentence()}"

    def _repr_html_(self) -> str:
        rows = [
            (name, n.values.get(name, n.shapes.get(name)), {**n.std, **n.shape_std}[name], n.sigma)
            for n in self.named
            for name in (*n.values, *n.shapes)
        ]
        table = pd.DataFrame(rows, columns=["parameter", "value", "std", "sigma of the effect"])
        return f"<p>{self!r}</p>" + (table.to_html(index=False, float_format="{:.3g}".format) if rows else "")

    def plot_gap(self, ax: Axes | None = None) -> Axes:
        """Plot the gap on the collisions kept out, by phase: without what was found, with it, and from noise alone.

        Parameters
        ----------
        ax : Axes, optional
            Where to draw; default: a new figure.

        Returns
        -------
        Axes
            Residuals, rms, each axis, um.
        """
        if ax is None:
            import matplotlib.pyplot as plt

            ax = plt.subplots(layout="constrained")[1]
        draw_gap_bars(ax, self.gap, "_um", "with what was found")
        ax.set(xlabel="phase of the collision")
        ax.legend(frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
        return ax

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
        with replace_folder(Path(folder), search_page.FILES, "a report of an earlier search") as place:
            search_page.write(self.outcome, place, self.left_out)
        return Path(folder) / "index.html"


def find(
    results: Sequence[Result] | str | Path,
    model: Model | Mapping[str, Any] | str | Path,
    camera: str | Path | None = None,
    progress: Progress = lambda stage: None,
    minutes: float = math.inf,
    policy: SearchPolicy | None = None,
) -> Finding:
    """Search for what a model lacks, from measured collisions.

    Parameters
    ----------
    results : sequence of tracker.Result, str or Path
        What `tracker.track` or `tracker.measure` gave, of several clips of one camera; or a tracker's RESULTS; or, with
        `camera`, a table of tracks.
    model : Model, dict, str or Path
        What the measurement is held against: a model, its settings, a model or scene file, or the name of a scene that
        comes with synthcam. Its base parameters that are not zero, and those in its ``free``, are fitted.
    camera : str or Path, optional
        camera.json of a table.
    progress : callable
        Told the stage, many times.
    minutes : float
        After which the search is cut short; it then names nothing, and says how far it came.
    policy : SearchPolicy, optional
        The thresholds that decide; default: ``SearchPolicy()``.

    Returns
    -------
    Finding

    Raises
    ------
    InputError
        One line: what is no model, clips that cannot be used, or too few of them.

    Examples
    --------
    >>> import discrepancy
    >>> found = discrepancy.find("out/results", "painter_behringer")  # doctest: +SKIP
    >>> found.report("out/search")  # doctest: +SKIP
    >>> discrepancy.find([], "painter_behringer")
    Traceback (most recent call last):
    ...
    synthcam_shared.errors.InputError: results: no clip with a measured collision
    """
    given = as_model(model)
    source = Path(results) if isinstance(results, str) else results
    with applied_policy(policy or SearchPolicy()):
        clips, left_out = read_collisions(source, None if camera is None else Path(camera))
        return searched(clips, given, [str(n) for n in left_out], progress, 60 * minutes)


def searched(
    clips: Sequence[MeasuredCollision],
    model: Model,
    left_out: Sequence[str],
    progress: Progress,
    seconds: float = math.inf,
) -> Finding:
    """Search collisions that `read_collisions` has read, with its lines about what was left out."""
    with threadpool_limits(1, "blas"):  # matrices here are small: threads wait for one another longer than they work
        outcome = search(clips, model, progress, seconds)
    return Finding(outcome, (*left_out, *outcome.data.left_out))
