"""REPORT/residuals.parquet: the residuals of all positions, of the base model and with what the search found."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.noise.whitening import ClipWhitener
from discrepancy.outcome import SearchOutcome


def tabulate_residuals(found: SearchOutcome) -> pd.DataFrame:
    """Make a row for each position that the search used; docs/format.md describes the columns."""
    fitted = _tabulate(found, found.data.clips, found.base_fit, found.best_fit)
    held_out = _tabulate(found, found.data.held_out, found.gap_fits.before, found.gap_fits.after)
    tables = [(False, table) for table in fitted] + [(True, table) for table in held_out]
    return pd.concat([table.assign(held_out=is_held_out) for is_held_out, table in tables], ignore_index=True)


def _tabulate(
    found: SearchOutcome, clips: Sequence[MeasuredCollision], base: ModelFit, best: ModelFit
) -> Iterator[pd.DataFrame]:
    for clip, before, after in zip(clips, base.residuals, best.residuals, strict=True):
        white = ClipWhitener.of(clip, found.data.noise)
        columns = {"": clip.xy, "_base": white.undo_noise(before)}
        columns["_best"] = np.full_like(clip.xy, np.nan) if found.is_empty else white.undo_noise(after)
        metres = {f"{axis}{name}": xy[:, k] for name, xy in columns.items() for k, axis in enumerate("xy")}
        yield pd.DataFrame({"clip": clip.clip, "ball": clip.ball + 1, "frame": clip.frame, **metres})
