"""Residuals of a search over the film: of the model that was searched, and of the one with what the search found."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from synthcam_shared.errors import InputError
from tracker import results
from tracker.app.opened_results import MAX_POSITIONS, OpenedResults, list_columns
from tracker.detection.link import Tracks

TABLE = "residuals.parquet"
KEYS = ("base", "best")  # in the table's names of columns


@dataclass(frozen=True, eq=False)
class SearchedResiduals:
    """The residuals that `discrepancy find` wrote, for the results that it searched."""

    report: Path
    searched: OpenedResults

    @property
    def is_there(self) -> bool:
        """True if the search has written them."""
        return (self.report / TABLE).is_file()

    def describe(self, number: int) -> dict[str, Any]:
        """Each model with its residuals of a clip: rms, um, and tracks; no model where the search left the clip out.

        The rms is None where the tracks have no frame of the search, as after another run into the same folder.
        held_out: whether the clip is one of those that the search kept for tests. Raises InputError.
        """
        tracks, camera = results.read_clip(self.searched.folder, number)
        table = self._read(number)
        if len(table) > MAX_POSITIONS:
            raise InputError(f"search: {len(table)} positions, the page draws at most {MAX_POSITIONS}")
        out: list[dict[str, Any]] = []
        if len(table):
            rows = _find_rows(tracks, camera.unproject(tracks.xy)[0], table)
            kept, rows = table[rows >= 0], rows[rows >= 0]
            names = results.load_json(self.report / "discrepancy.json").get("models", [])
            for name, key in zip(names, KEYS, strict=False):
                metres = np.full((len(tracks), 2), np.nan)
                metres[rows] = kept[[f"x_{key}", f"y_{key}"]]
                shown = list_columns(tracks, camera, metres)
                out.append({"name": name, "rms_um": _rms_um(metres), "tracks": shown})
        return {"clip": number, "models": out, "held_out": bool(table["held_out"].any())}

    def _read(self, number: int) -> pd.DataFrame:
        file = self.report / TABLE
        try:
            return pd.read_parquet(file, filters=[("clip", "==", number)])
        except (OSError, ValueError) as error:
            raise InputError(f"{file}: expected the residuals of a search ({type(error).__name__})") from None


def _rms_um(metres: NDArray[Any]) -> float | None:
    if np.isnan(metres).all():
        return None
    return float(f"{1e6 * np.sqrt(np.nanmean(metres**2)):.3g}")


def _find_rows(tracks: Tracks, metres: NDArray[Any], table: pd.DataFrame) -> NDArray[np.int64]:
    """For each row of the table the nearest position of its frame in the tracks; -1 where the frame has none."""
    order = np.argsort(tracks.frame, kind="stable")
    frames, out = tracks.frame[order], np.full(len(table), -1)
    wanted = table["frame"].to_numpy()
    first, last = (np.searchsorted(frames, wanted, side=side) for side in ("left", "right"))
    for k, xy in enumerate(table[["x", "y"]].to_numpy()):
        here = order[first[k] : last[k]]
        if len(here):
            out[k] = here[np.argmin(((metres[here] - xy) ** 2).sum(axis=1))]
    return out
