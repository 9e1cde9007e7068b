"""Results of a tracker for the films of a suite, in files or in memory."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import pandas as pd

from tracker import results
from tracker.benchmark.suite.definition import SuitePart
from tracker.recording import Result
from tracker.scoring.score import NO_TRACKS

Rows = list[Mapping[str, Any]]


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


ALL = ClipSample()


class TrackerResults(Protocol):
    """Tracks and estimates of the clips of each film."""

    @property
    def sample(self) -> ClipSample:
        """The clips that it was run on."""

    @property
    def own(self) -> str:
        """ "centre" where the tracker itself gives centres; "glint" where the camera file corrects its positions."""

    def of(self, film: str, clip: int) -> tuple[pd.DataFrame, Rows]:
        """Return tracks as in tracks.parquet and a row of estimates for each collision; empty for a missing clip."""


@dataclass(frozen=True)
class ResultsInFolder:
    """RESULTS for each film, in FOLDER/FILM."""

    folder: Path
    sample: ClipSample = ALL
    own: str = "centre"

    def of(self, film: str, clip: int) -> tuple[pd.DataFrame, Rows]:
        """Return tracks and estimates of a clip."""
        home = results.clip_folder(self.folder / film, clip)
        if not home.is_dir():
            return NO_TRACKS, []
        return pd.read_parquet(home / "tracks.parquet"), results.load_json(home / "estimates.json")


@dataclass
class ResultsInMemory:
    """Results by film and clip."""

    found: dict[tuple[str, int], Result] = field(default_factory=dict)
    sample: ClipSample = ALL
    own: str = "centre"

    def of(self, film: str, clip: int) -> tuple[pd.DataFrame, Rows]:
        """Return tracks and estimates of a clip."""
        if (film, clip) not in self.found:
            return NO_TRACKS, []
        result = self.found[film, clip]
        return result.tracks, [results.finite(row) for row in result.rows]
