"""Results of a tracker for the films of a suite, in files or in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from synthcam_shared.json_values import replace_non_finite
from tracker import results
from tracker.benchmark.suite.definition import SuitePart
from tracker.recording import Result
from tracker.scoring.score import NO_TRACKS

ClipResults = tuple[pd.DataFrame, list[Mapping[str, Any]]]


@dataclass(frozen=True)
class ClipSample:
    """The clips of a suite that a tracker is run on: so many of each part (None: all), without some films."""

    clips: int | None = None
    without: tuple[str, ...] = ()

    def of(self, part: SuitePart) -> tuple[int, ...]:
        """Return the clips of a part that count."""
        return () if part.truth in self.without else part.clips[: self.clips]

    def of_film(self, parts: Iterable[SuitePart], film: str) -> set[int]:
        """Return the clips of a film that count."""
        return {clip for part in parts if part.film == film for clip in self.of(part)}


ALL_CLIPS = ClipSample()


@dataclass(frozen=True)
class TrackerResults:
    """Tracks and estimates of a tracker.

    of: takes film and clip. It returns tracks as in tracks.parquet and a row of estimates for each collision; both are
    empty for a missing clip.
    sample: the clips that the tracker was run on.
    own: "centre" where the tracker gives centres itself; "glint" where the camera file corrects its positions.
    """

    of: Callable[[str, int], ClipResults]
    sample: ClipSample = ALL_CLIPS
    own: str = "centre"


def read_clip_results(folder: Path, film: str, clip: int) -> ClipResults:
    """Read tracks and estimates of a clip from the RESULTS in FOLDER/FILM."""
    home = results.clip_folder(folder / film, clip)
    if not home.is_dir():
        return NO_TRACKS, []
    return pd.read_parquet(home / "tracks.parquet"), results.load_json(home / "estimates.json")


def take_clip(found: Mapping[tuple[str, int], Result], film: str, clip: int) -> ClipResults:
    """Take tracks and estimates of a clip from results in memory."""
    if (film, clip) not in found:
        return NO_TRACKS, []
    result = found[film, clip]
    return result.tracks, [replace_non_finite(row) for row in result.rows]
