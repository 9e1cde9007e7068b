"""A dataset while it is made: a folder NAME.partial beside its place, renamed when it is complete."""

from __future__ import annotations

import json
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from synthcam.dataset.files import SUMS, clip_folders
from synthcam_shared.errors import InputError
from synthcam_shared.outputs import as_input_error, write_atomically

PLAN = "plan.json"
ABOUT = ("truth/dataset.json", "truth/shard.json")
OPTIONAL = ("compression", "shard", "effect_files")  # keys of a document that are not there when they say nothing


@dataclass
class PartialDataset:
    """Where a dataset is made: `folder` for what all may see, `truth` for the truth (the same, unless withheld)."""

    folder: Path
    truth: Path
    output: Path
    withheld: Path | None
    lock: int

    def clip(self, number: int) -> tuple[Path, Path]:
        """Folders of one clip: what all may see, and the truth."""
        name = f"{number:06d}"
        return self.folder / "clips" / name, self.truth / "clips" / name / "truth"

    def list_done(self) -> set[int]:
        return {int(c.name) for c in clip_folders(self.folder)}

    def tidy(self) -> None:
        """Remove what killed workers left."""
        leftovers = [*self.folder.glob("clips/*.tmp"), *(self.truth.glob("clips/*/*.tmp") if self.withheld else ())]
        for leftover in leftovers:
            shutil.rmtree(leftover)

    def discard(self) -> None:
        for folder in {self.folder, self.truth}:
            shutil.rmtree(folder, ignore_errors=True)
        self.close()

    def publish(self) -> None:
        """Move the complete dataset to its place, the truth first."""
        (self.folder / PLAN).unlink(missing_ok=True)
        if self.withheld:
            self.truth.rename(self.withheld)
        self.folder.rename(self.output)
        self.close()

    def close(self) -> None:
        """Release the lock."""
        if self.lock >= 0:
            os.close(self.lock)
            self.lock = -1


def open_partial(output: Path, document: dict[str, Any], withheld: Path | None = None) -> PartialDataset | None:
    """The folder in which the dataset of `document` is made, or None when it is complete.

    Raises InputError when a folder holds something else, when another process is at work there, or when the truth to
    be withheld would come to lie in the dataset.
    """
    output, withheld = output.resolve(), withheld.resolve() if withheld else None
    if withheld:
        check_apart(output, withheld)
    partial = _beside(output)
    truth = _beside(withheld) if withheld else partial
    final = withheld or output
    if output.exists() and not _empty(output):
        _same_or_refuse(document, output, _about(final))
        return None
    if withheld and withheld.exists() and not _empty(withheld):
        _same_or_refuse(document, withheld, _about(withheld))
        if (partial / PLAN).exists() or not (partial / SUMS).exists():
            raise InputError(f"{withheld}: holds the truth of a dataset that is not at {output}")
        partial.rename(output)  # killed between the last two moves
        return None
    # a run killed at its very end has left no plan any more, but a dataset.json
    plan = partial / PLAN
    for folder in {partial, truth}:
        _same_or_refuse(document, folder, plan if plan.exists() or not _about(truth).is_file() else _about(truth))
    new = not partial.exists()
    with as_input_error(partial):
        partial.mkdir(parents=True, exist_ok=True)
        made = PartialDataset(partial, truth, output, withheld, _lock(partial))
        try:
            beside = partial.with_name(partial.name + ".plan")
            write_atomically(beside, json.dumps(document, indent=1).encode())
            beside.replace(plan)  # first of all: a folder without a plan is taken for another program's
            for folder in {partial, truth}:
                (folder / "clips").mkdir(parents=True, exist_ok=True)
            made.tidy()
        except OSError:
            made.discard() if new else made.close()
            raise
    return made


def check_apart(output: Path, withheld: Path) -> None:
    """Raises InputError where one of two folders lies in the other, or where either is made, links followed."""
    for one in (output.resolve(), _beside(output.resolve())):
        for other in (withheld.resolve(), _beside(withheld.resolve())):
            if one == other or one in other.parents or other in one.parents:
                raise InputError(f"--withhold-truth {withheld}: expected a folder apart from {output}")


def move_into_place(aside: Path, final: Path) -> None:
    """Move a folder made aside into its place; one that another worker has made meanwhile stays."""
    try:
        aside.rename(final)
    except OSError:
        if not final.is_dir():
            raise
        shutil.rmtree(aside)


@contextmanager
def open_exclusively(final: Path) -> Iterator[Path]:
    """An empty folder beside `final`, for one process at a time; gone at the end, unless it has become `final`."""
    beside = final.with_name(f"{final.name}.tmp")
    beside.mkdir(parents=True, exist_ok=True)
    lock = _lock(beside)
    try:
        for left in beside.iterdir():  # by a killed process
            shutil.rmtree(left) if left.is_dir() else left.unlink()
        yield beside
    finally:
        shutil.rmtree(beside, ignore_errors=True)
        if lock >= 0:
            os.close(lock)


def name_temporary(final: Path) -> Path:
    """A name beside `final` that no other worker on any machine uses."""
    return final.with_name(f"{final.name}-{uuid.uuid4().hex[:12]}.tmp")


def _beside(folder: Path) -> Path:
    return folder.with_name(folder.name + ".partial")


def _about(folder: Path) -> Path:
    """The document of a complete dataset or shard."""
    return next((folder / name for name in ABOUT if (folder / name).is_file()), folder / ABOUT[0])


def _lock(folder: Path) -> int:
    """A lock that ends with this process; -1 where there are none."""
    try:
        import fcntl
    except ImportError:
        return -1
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise InputError(f"{folder}: another process is at work there; wait for it, or choose another folder") from None
    except OSError:  # a file system without locks
        os.close(handle)
        return -1
    if not folder.is_dir() or not os.path.samestat(os.fstat(handle), folder.stat()):
        os.close(handle)
        raise InputError(f"{folder}: another process has just made this dataset")
    return handle


def _empty(folder: Path) -> bool:
    return folder.is_dir() and not any(folder.iterdir())


def _same_or_refuse(wanted: dict[str, Any], folder: Path, document: Path) -> None:
    if not folder.exists() or _empty(folder):
        return
    if not document.is_file():
        raise InputError(f"{folder}: holds something else; expected a dataset of this scene, or nothing")
    try:
        found = json.loads(document.read_text())
    except ValueError:
        raise InputError(f"{document}: not JSON; remove the folder to start anew") from None
    wanted = json.loads(json.dumps(wanted))
    for key in {**wanted, **dict.fromkeys(OPTIONAL)}:
        if not isinstance(found, dict) or found.get(key) != wanted.get(key):
            raise InputError(f"{folder}: holds a dataset with another {key}; choose another folder")
