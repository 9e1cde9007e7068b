"""A dataset while it is made: a folder NAME.partial beside its place, renamed when it is complete."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from synthcam.dataset.files import SUMS, clip_folders
from synthcam_shared.errors import InputError
from synthcam_shared.outputs import (
    RESUMES,
    as_input_error,
    move_into_place,
    name_temporary,
    resume_folder,
)

PLAN = "plan.json"


@dataclass(frozen=True)
class PartialDataset:
    """The folders in which a dataset is made."""

    folder: Path  # for what everybody may see
    truth: Path  # the same folder unless the truth is withheld
    output: Path  # where `folder` goes when it is complete
    withheld: Path | None  # where `truth` goes then; None if the truth stays in the dataset

    def clip(self, number: int) -> tuple[Path, Path]:
        """Folders of one clip: what everybody may see, and the truth."""
        name = f"{number:06d}"
        return self.folder / "clips" / name, self.truth / "clips" / name / "truth"

    def list_done(self) -> set[int]:
        """List the numbers of the complete clips."""
        return {int(c.name) for c in clip_folders(self.folder)}

    def tidy(self) -> None:
        """Remove what killed workers left."""
        leftovers = [*self.folder.glob("clips/*.tmp"), *(self.truth.glob("clips/*/*.tmp") if self.withheld else ())]
        for leftover in leftovers:
            shutil.rmtree(leftover)

    def discard(self) -> None:
        """Remove both folders."""
        for folder in {self.folder, self.truth}:
            shutil.rmtree(folder, ignore_errors=True)

    def publish(self) -> None:
        """Move the complete dataset to its place, the truth first."""
        (self.folder / PLAN).unlink(missing_ok=True)
        if self.withheld:
            self.truth.rename(self.withheld)
        self.folder.rename(self.output)


@contextmanager
def open_partial(
    output: Path, document: dict[str, Any], withheld: Path | None = None
) -> Iterator[PartialDataset | None]:
    """Open the folder in which the dataset of `document` is made; None if the dataset is complete.

    Raises InputError if a folder holds something else, another process is at work there, the disk is full, or the
    withheld truth would lie in the dataset.
    """
    output, withheld = output.resolve(), withheld.resolve() if withheld else None
    if withheld:
        check_apart(output, withheld)
    partial = _beside(output)
    truth = _beside(withheld) if withheld else partial
    if output.exists() and not _is_empty(output):
        _check_same(document, output, _document_file(withheld or output))
        yield None
        return
    if withheld and withheld.exists() and not _is_empty(withheld):
        _check_same(document, withheld, _document_file(withheld))
        if (partial / PLAN).exists() or not (partial / SUMS).exists():
            raise InputError(f"{withheld}: holds the truth of a dataset that is not at {output}")
        partial.rename(output)  # a run was killed between its last two moves
        yield None
        return
    # A run that was killed at its very end has removed its plan, but has written a dataset.json.
    plan, complete = partial / PLAN, _document_file(truth)
    for folder in {partial, truth}:
        _check_same(document, folder, plan if plan.exists() or not complete.is_file() else complete)
    made = PartialDataset(partial, truth, output, withheld)
    with resume_folder(partial, PLAN, json.dumps(document, indent=1)), as_input_error(truth, RESUMES):
        try:
            (truth / "clips").mkdir(parents=True, exist_ok=True)
            made.tidy()
            yield made
        except BaseException:
            if not made.list_done():
                made.discard()
            raise


def check_apart(output: Path, withheld: Path) -> None:
    """Raise InputError if one of two folders lies in the other, or in where the other is made; links are followed."""
    for one in (output.resolve(), _beside(output.resolve())):
        for other in (withheld.resolve(), _beside(withheld.resolve())):
            if one == other or one in other.parents or other in one.parents:
                raise InputError(f"--withhold-truth {withheld}: expected a folder apart from {output}")


@contextmanager
def place_clip(final: Path, truth: Path | None) -> Iterator[tuple[Path, Path]]:
    """Make temporary folders for a clip and for its truth, moved into place at the end, or removed if the work fails.

    truth: place of the truth if it is withheld; None: it is in the clip's folder.
    """
    aside = name_temporary(final)
    truth_aside = name_temporary(truth) if truth else aside / "truth"
    try:
        yield aside, truth_aside
        if truth:
            move_into_place(truth_aside, truth)
        move_into_place(aside, final)
    except BaseException:
        for leftover in (aside, truth_aside):
            shutil.rmtree(leftover, ignore_errors=True)
        raise


def _beside(folder: Path) -> Path:
    return folder.with_name(folder.name + ".partial")


def _document_file(folder: Path) -> Path:
    """The file with the document of a complete dataset or shard."""
    dataset, shard = folder / "truth" / "dataset.json", folder / "truth" / "shard.json"
    return shard if shard.is_file() and not dataset.is_file() else dataset


def _is_empty(folder: Path) -> bool:
    return folder.is_dir() and not any(folder.iterdir())


def _check_same(wanted: dict[str, Any], folder: Path, document: Path) -> None:
    """Raise InputError if the folder holds anything but the dataset of the wanted document."""
    if not folder.exists() or _is_empty(folder):
        return
    if not document.is_file():
        raise InputError(f"{folder}: holds something else; expected a dataset of this scene, or nothing")
    try:
        found = json.loads(document.read_text())
    except ValueError:
        raise InputError(f"{document}: not JSON; remove the folder to start again") from None
    wanted = json.loads(json.dumps(wanted))
    for key in [*wanted, "compression", "shard", "effect_files"]:  # the last three are missing at their defaults
        if not isinstance(found, dict) or found.get(key) != wanted.get(key):
            what = {
                "scenes": "scene",
                "clips_per_scene": "number of clips (--clips)",
                "seed": "seed (--seed)",
                "video": "--no-video",
                "version": "version of synthcam",
                "compression": "--compression",
                "shard": "shard (--shard)",
                "effect_files": "effect file",
            }[key]
            raise InputError(f"{folder}: holds a dataset made with another {what}; choose another folder")
