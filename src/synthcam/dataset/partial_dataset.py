"""The folder NAME.partial of an unfinished dataset: begun, continued after an interruption, renamed when complete."""

import glob
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from synthcam.dataset.files import SUMS
from synthcam.dataset.recorded_dataset import list_clip_folders
from synthcam_shared.errors import InputError
from synthcam_shared.outputs import RESUMES, as_input_error, move_into_place, name_temporary, resume_folder

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
        return {int(c.name) for c in list_clip_folders(self.folder)}

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
            _replace(self.truth, self.withheld)
        _replace(self.folder, self.output)

    def take_clips(self, output: Path, withheld: Path | None) -> None:
        """Take the clips of a smaller dataset, by links where the file system has them."""
        done = self.list_done()
        for made in list_clip_folders(output):
            if int(made.name) in done:
                continue
            folder, truth = self.clip(int(made.name))
            secret = withheld / "clips" / made.name / "truth" if withheld else None
            with place_clip(folder, truth if secret else None) as (aside, truth_aside):
                shutil.copytree(made, aside, copy_function=_link)
                if secret:
                    shutil.copytree(secret, truth_aside, copy_function=_link)


@contextmanager
def open_partial(
    output: Path, document: dict[str, Any], withheld: Path | None = None
) -> Iterator[PartialDataset | None]:
    """Open the folder in which the dataset of `document` is made; None if the dataset is complete.

    A complete dataset with fewer clips of the same single scene gives its clips to the new one, which replaces it.

    Raises InputError if a folder holds something else, if another process is at work there, or if the disk is full. The
    same holds if the withheld truth would lie in the dataset.
    """
    output, withheld = output.resolve(), withheld.resolve() if withheld else None
    if withheld:
        check_apart(output, withheld)
    partial = _beside(output)
    truth = _beside(withheld) if withheld else partial
    for final in (each for each in (output, withheld) if each and not each.exists()):
        for old in _list_replaced(final)[:1]:
            old.rename(final)  # a run was killed between the two moves of `_replace`
    ended = (partial / SUMS).exists() and not (partial / PLAN).exists()
    if withheld and ended and _check_same(document, withheld, _document_file(withheld)):
        _replace(partial, output)  # a run was killed between its last moves
        yield None
        return
    smaller = _is_filled(output)
    if smaller and _check_same(document, output, _document_file(withheld or output)):
        yield None
        return
    if withheld and _is_filled(withheld) and not smaller:
        _check_same(document, withheld, _document_file(withheld))
        raise InputError(f"{withheld}: holds the truth of a dataset that is not at {output}")
    # A run that was killed at its very end has removed its plan, but has written a dataset.json.
    plan, complete = partial / PLAN, _document_file(truth)
    for folder in {partial, truth}:
        _check_same(document, folder, plan if plan.exists() or not complete.is_file() else complete)
    made = PartialDataset(partial, truth, output, withheld)
    with resume_folder(partial, PLAN, json.dumps(document, indent=1)), as_input_error(truth, RESUMES):
        try:
            (truth / "clips").mkdir(parents=True, exist_ok=True)
            made.tidy()
            if smaller:
                made.take_clips(output, withheld)
            yield made
        except BaseException:
            if not made.list_done():
                made.discard()
            raise


def check_apart(output: Path, withheld: Path) -> None:
    """Raise InputError if the folders of a dataset and its truth, or those in which they are made, are not apart."""
    for one in (output.resolve(), _beside(output.resolve())):
        for other in (withheld.resolve(), _beside(withheld.resolve())):
            if one == other or one in other.parents or other in one.parents:
                raise InputError(f"--withhold-truth {withheld}: expected a folder apart from {output}")


@contextmanager
def place_clip(final: Path, truth: Path | None) -> Iterator[tuple[Path, Path]]:
    """Make temporary folders for a clip of a partial dataset and its truth, moved into place if the work succeeds.

    truth: folder of the truth if it is withheld; None: it is in the clip's folder.
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


def _is_filled(folder: Path) -> bool:
    return folder.exists() and not (folder.is_dir() and not any(folder.iterdir()))


def _replace(aside: Path, final: Path) -> None:
    """Move a complete folder to its place. A smaller dataset that is there is moved aside first, then removed."""
    if _is_filled(final):
        final.rename(name_temporary(final))
    aside.rename(final)
    for old in _list_replaced(final):
        shutil.rmtree(old, ignore_errors=True)


def _list_replaced(final: Path) -> list[Path]:
    """The folders that `_replace` has moved aside, by their names of `name_temporary`."""
    return sorted(final.parent.glob(f"{glob.escape(final.name)}-{'[0-9a-f]' * 12}.tmp"))


def _link(source: str, target: str) -> None:
    """Link a file, which no command changes once its clip is complete; copy it on a file system without links."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def _check_same(wanted: dict[str, Any], folder: Path, document: Path) -> bool:
    """Raise InputError if the folder holds anything but the dataset of the wanted document, or the first clips of it.

    Returns whether it holds all clips.
    """
    if not _is_filled(folder):
        return False
    if not document.is_file():
        raise InputError(f"{folder}: holds something else; expected a dataset of this scene, or nothing")
    try:
        found = json.loads(document.read_text())
    except ValueError:
        raise InputError(f"{document}: not JSON; remove the folder to start again") from None
    wanted = json.loads(json.dumps(wanted))
    clips = found.get("clips_per_scene") if isinstance(found, dict) else None
    fewer = isinstance(clips, int) and clips < wanted["clips_per_scene"] and len(wanted["scenes"]) == 1
    if fewer:  # clips of one scene keep their numbers
        found["clips_per_scene"] = wanted["clips_per_scene"]
    for key in [*wanted, "compression", "shard", "effect_files"]:  # the last three are missing at their defaults
        if not isinstance(found, dict) or found.get(key) != wanted.get(key):
            what = {
                "scenes": "scene",
                "clips_per_scene": f"number of clips ({clips}); only more clips of a single scene can be added",
                "seed": "seed (--seed)",
                "video": "--no-video",
                "version": "version of synthcam",
                "compression": "--compression",
                "shard": "shard (--shard)",
                "effect_files": "effect file",
            }[key]
            raise InputError(f"{folder}: holds a dataset made with another {what}; choose another folder")
    return not fewer
