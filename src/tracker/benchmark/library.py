"""The benchmark from Python: score your own detector, a function or a class, in a notebook."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from synthcam_shared.arguments import check_arguments
from synthcam_shared.errors import InputError
from tracker.benchmark.judging.entry import make_entry
from tracker.benchmark.judging.tracker_results import TrackerResults, take_clip
from tracker.benchmark.suite.definition import Suite, check_truth, open_suite, read_definition
from tracker.benchmark.suite.make import make_suite
from tracker.camera.recordings import open_source
from tracker.detection.detect import DetectorChoice, detector_name
from tracker.detection.own_detector import as_detector
from tracker.recording import track_and_measure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Finder = Callable[[NDArray[Any]], ArrayLike]


@dataclass(frozen=True, repr=False)
class TrackerRun:
    """The scores of a detector on a suite.

    Attributes
    ----------
    entry : dict
        All scores, as in entries/NAME.json of a report.
    headline : dict
        The parts that enter the score, with a label for each.
    """

    entry: Mapping[str, Any]
    headline: Mapping[str, str]

    @property
    def score(self) -> float:
        """100: every ball found, nothing else, at the bound."""
        value = self.entry["score"]
        return float("nan") if value is None else float(value)

    @cached_property
    def table(self) -> pd.DataFrame:
        """Scores of positions and tracks, a row for each part of the suite.

        The columns are rmse_px, phase_bias_px, jsc, mota, idf1, hota, clips, and:

        - ratio, bound_px: of rmse_px to the Cramér-Rao bound, and that bound, px, of x and y;
        - found, false: share of the balls in view that were detected, and detections of nothing;
        - z: error over claimed error.
        """
        figures = "ratio rmse_px bound_px found false phase_bias_px z jsc mota idf1 hota clips".split()
        rows = {name: {key: part[key] for key in figures} for name, part in self.entry["parts"].items()}
        table = pd.DataFrame.from_dict(rows, orient="index", columns=figures, dtype=float)
        return table.rename_axis("part")

    @cached_property
    def quantities(self) -> pd.DataFrame:
        """Errors of measured quantities (SI), a row for each part and quantity."""
        quantities = "n bias rmse bound ratio z_mean z_std cover68 cover95 published published_std".split()
        rows = {
            (part, name): {key: figures.get(key) for key in quantities}
            for part, found in self.entry["quantities"].items()
            for name, figures in found.items()
            if isinstance(figures, Mapping)
        }
        index = pd.MultiIndex.from_tuples(list(rows), names=["part", "quantity"])
        return pd.DataFrame(list(rows.values()), index=index, columns=quantities, dtype=float)

    @cached_property
    def crowds(self) -> pd.DataFrame:
        """Scores of films of crowds, a row for each; docs/benchmark.md describes the columns. Empty without crowds."""
        found = {part: scores for part, scores in self.entry.get("crowds", {}).items() if scores}
        return pd.DataFrame.from_dict(found, orient="index", dtype=float).rename_axis("part")

    def __repr__(self) -> str:
        lost = self.table["found"] < 1
        name = self.entry["tracker"]["name"]
        said = f"{name}: score {self.score:.0f} of 100, median {self.table['ratio'].median():.3g} times the bound"
        return f"{said}; balls lost in {int(lost.sum())} of {len(lost)} parts"

    def _repr_html_(self) -> str:
        return f"<p>{self!r}</p>{self.table.to_html(float_format=lambda v: f'{v:.3g}')}"

    def plot(self, ax: Axes | None = None) -> Axes:
        """Plot rmse over bound in the settings that enter the score.

        Parameters
        ----------
        ax : Axes, optional
            Where to draw; default: a new figure.

        Returns
        -------
        Axes
        """
        if ax is None:
            import matplotlib.pyplot as plt

            ax = plt.subplots(layout="constrained")[1]
        parts = [part for part in self.headline if part in self.table.index]
        ratio = self.table.loc[parts, "ratio"].to_numpy(float)
        ax.plot(ratio, np.arange(len(parts)), "o", label=str(self.entry["tracker"]["name"]))
        ax.axvline(1.0, color="0.4", ls=":")
        ax.set_yticks(range(len(parts)), [self.headline[part] for part in parts])
        ax.set(xscale="log", xlabel="rmse / bound", ylim=(len(parts) - 0.5, -0.5))
        return ax


@check_arguments
def run(
    detector: DetectorChoice | Finder,
    suite: Path | str | None = None,
    *,
    name: str | None = None,
    point: str = "either",
) -> TrackerRun:
    """Run a detector on the benchmark and score it.

    Parameters
    ----------
    detector : callable or str
        A function that is given a frame, (height, width) counts, and returns places (n, 2), x and y in px, pixel
        centres at whole numbers; or a class as the files of ``detectors/`` hold, which may give errors; or its name.
    suite : str or Path, optional
        One that `tracker benchmark make` made; default: the small one, made once and kept among the user's caches.
    name : str, optional
        What to call it; default: its own.
    point : {"either", "glint", "centre"}
        What a function finds: the bright spot, which the camera file takes to the centre, or the centre; "either" the
        spot on balls that mirror the lamp, the centre of matte ones.

    Returns
    -------
    TrackerRun
        `table` and `quantities` (DataFrames), `score`, `plot()`.

    Raises
    ------
    InputError
        For what is no suite, and a detector that returns something else.
    """
    if point not in ("either", "glint", "centre"):
        raise InputError(f"point: expected either, glint or centre, not {point!r}")
    made = _suite(suite)
    function = callable(detector) and not inspect.isclass(detector)
    used: Any = as_detector(detector, point) if function else detector
    own = "centre" if function and point == "centre" else "glint"
    found = {}
    for film in dict.fromkeys(part.film for part in made.parts.values()):
        source = open_source(made.film(film))
        for index, (number, _) in enumerate(source.clips):
            found[film, number] = track_and_measure(source.open_clip(index), used)
    given: Any = detector
    about = {"name": name or detector_name(given), "made": "run here", "point": own}
    tracked = TrackerResults(partial(take_clip, found), own=own)
    return TrackerRun(make_entry(made, tracked, about), made.definition.headline)


def _suite(given: Path | str | None) -> Suite:
    """The suite, with its truth; the small one is made where none is given."""
    if given is not None:
        return check_truth(open_suite(Path(given)))
    definition = read_definition(size="small")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return make_suite(
        cache / "synthcam" / f"benchmark-{definition.version}-{definition.digest[:8]}", definition, workers=1
    )
