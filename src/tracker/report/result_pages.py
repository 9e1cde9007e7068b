"""The pages of RESULTS: of one recording its page, of several a page each and a table of them all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from synthcam_shared.outputs import as_input_error, write_atomically
from tracker import results
from tracker.camera.recordings import RecordingSource
from tracker.measurement.collision.adequacy import warnings
from tracker.report.estimates_text import QUANTITIES, format_value, rows_as_dicts
from tracker.report.html import HERE, describe_creation, render
from tracker.report.recording_page import PAGE, RecordingPage, write_page

LISTED = ("v0", "b", "r", "mu_k", "C", "tau1", "tau2", "energy_fraction")


@dataclass(frozen=True)
class ResultPages:
    """What the pages of one RESULTS are made of. Cheap to send to another process.

    source: where the films are, in the order of `numbers`; None of tracks made elsewhere. name: of what was tracked;
    notes: what was assumed or converted; command: what the pages say that made them.
    """

    output: Path
    numbers: Sequence[int]
    source: RecordingSource | None
    name: str
    notes: Sequence[str]
    command: str

    @property
    def alone(self) -> bool:
        """Whether there is one recording, whose page is RESULTS/index.html."""
        return len(self.numbers) == 1

    def missing(self) -> list[int]:
        """Indices of the recordings that have no page yet."""
        return [i for i in range(len(self.numbers)) if not (self._folder(i) / PAGE).is_file()]

    def write(self, index: int) -> None:
        """The page of one recording."""
        number = self.numbers[index]
        tracks, camera = results.read_clip(self.output, number)
        folder = results.clip_folder(self.output, number)
        rows = rows_as_dicts(results.estimates_table(results.load_json(folder / "estimates.json")))
        motion = pd.read_parquet(folder / "motion.parquet")
        frames = None if self.source is None else self.source.open_clip(index).frames
        name = self.name if self.alone else f"{self.name}, clip {number}"
        with as_input_error(self.output):
            write_page(
                RecordingPage(name, camera, tracks, rows, motion, frames, self.notes), self._folder(index), self.command
            )

    def write_overview(self, estimates: pd.DataFrame) -> None:
        """Of several recordings, the table that leads to their pages."""
        if self.alone:
            return
        rows = [(row, [format_value(row, name) for name in LISTED]) for row in rows_as_dicts(estimates)]
        html = render(
            HERE / "overview.html",
            name=self.name,
            statuses=estimates["status"].value_counts().to_dict(),
            warnings=[*warnings(estimates), *self.notes],
            heads=[QUANTITIES[name][:2] for name in LISTED],
            rows=rows,
            made=describe_creation(self.command),
        )
        with as_input_error(self.output):
            write_atomically(self.output / PAGE, html)

    def _folder(self, index: int) -> Path:
        return self.output if self.alone else results.clip_folder(self.output, self.numbers[index])
