"""Cramér-Rao bounds of all true positions of a film, and of the quantities of its collisions.

A bound needs the light of the glint. The maximum-likelihood detector measures it once, when the suite is made, as the
median over the clip for each ball. All trackers are compared with the same bounds.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from synthcam_shared.jobs import run_all_jobs, use_one_thread
from synthcam_shared.outputs import write_atomically
from tracker.benchmark.suite.folder import BOUNDS, QUANTITY_BOUNDS
from tracker.camera.recordings import RecordingSource, open_source
from tracker.detection.detect import detect, make_view
from tracker.scoring.error_bars import compute_true_parameters, quantity_bounds
from tracker.scoring.localisation import MatchedDetections, match, position_bounds
from tracker.scoring.tracking_metrics import GATE_PX

Rows = tuple[pd.DataFrame, dict[str, float]]


def write_bounds(film: Path, truth: Path, workers: int = 0, scheduler: str = "") -> None:
    """Write the bounds of a film beside its truth, unless they exist; by processes here, or by workers of Dask."""
    if (truth / BOUNDS).is_file() and (truth / QUANTITY_BOUNDS).is_file():
        return
    source = open_source(film)
    found = run_all_jobs(partial(_of_clip, source, truth), range(len(source)), workers, film, scheduler)
    rows, quantities = zip(*sorted(found, key=lambda one: one[1]["clip"]), strict=True)
    for name, table in ((QUANTITY_BOUNDS, pd.DataFrame(quantities)), (BOUNDS, pd.concat(rows, ignore_index=True))):
        write_atomically(truth / name, table.to_parquet(index=False))


def _of_clip(source: RecordingSource, truth: Path, index: int) -> Rows:
    """Bound xx, xy, yy (px^2) of each true position, with frame and particle; bounds of the quantities of the clip."""
    use_one_thread()
    clip = source.open_clip(index)
    folder = truth / "clips" / f"{clip.number:06d}" / "truth"
    true = pd.read_parquet(folder / "tracks.parquet")
    table = true[["frame", "particle"]].assign(clip=clip.number, xx=np.nan, xy=np.nan, yy=np.nan)
    quantities: dict[str, Any] = {"clip": clip.number}
    if clip.camera.matte:
        return table, quantities  # whole balls in room light have no bound here
    seen = detect(clip, make_view(clip)).glints
    place, _ = clip.camera.centre_of_glint(seen.xy)
    found = pd.DataFrame({"frame": seen.frame, "x": place[:, 0], "y": place[:, 1], "flux": seen.flux})
    near = match(true, found, GATE_PX, clip.camera.diameter_px)
    flux = true.iloc[near.pairs[:, 0]].assign(flux=found["flux"].to_numpy()[near.pairs[:, 1]])
    bright = true["particle"].map(flux.groupby("particle")["flux"].median())
    perfect = _perfect(true, bright)
    cov = position_bounds(perfect, clip.camera)
    for name, (i, j) in {"xx": (0, 0), "xy": (0, 1), "yy": (1, 1)}.items():
        values = np.full(len(table), np.nan)
        values[perfect.pairs[:, 0]] = cov[:, i, j]
        table[name] = values
    scalars = pd.read_parquet(truth / "truth" / "clips.parquet")
    tied = compute_true_parameters(true, scalars[scalars["clip"] == clip.number].iloc[0])
    return table, quantities | quantity_bounds(perfect, cov, tied, clip.camera)


def _perfect(true: pd.DataFrame, flux: pd.Series[float]) -> MatchedDetections:
    """The result of a tracker without errors: all balls that are wholly in view."""
    whole = np.flatnonzero(true["visible"].to_numpy(bool) & np.isfinite(flux.to_numpy(float)))
    found = true.iloc[whole].assign(x=true["x_mean_px"], y=true["y_mean_px"], flux=flux)
    pairs = np.stack([whole, np.arange(len(whole))], axis=1)
    return MatchedDetections(true, found.reset_index(drop=True), pairs, np.ones(len(whole), bool), 0, 0)
