"""Read a dataset: its clips one at a time, with film, camera and truth."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, overload

import pandas as pd

from synthcam.dataset.files import clip_folders
from synthcam.dataset.recorded_clip import RecordedClip
from synthcam_shared.arguments import check_arguments
from synthcam_shared.errors import InputError, first_line


@dataclass(frozen=True, eq=False, repr=False)
class Dataset(Sequence[RecordedClip]):
    """The clips of a dataset, in order. `open_dataset` makes it.

    Attributes
    ----------
    folder : Path
        The dataset.
    secret : Path, optional
        The folder with the truth: the dataset itself unless the truth is withheld. None: it is not known.

    Examples
    --------
    >>> import synthcam
    >>> dataset = synthcam.open_dataset("out/benchmark")  # doctest: +SKIP
    >>> for clip in dataset:  # doctest: +SKIP
    ...     print(clip.number, clip.truth["r"], clip.film()[0].mean())
    """

    folder: Path
    secret: Path | None = None

    def __repr__(self) -> str:
        return f"Dataset {self.folder}: {len(self)} clips{'' if self.secret else ', truth withheld'}"

    @cached_property
    def truth(self) -> pd.DataFrame:
        """The scalars of all collisions, a row for each clip, with the columns of ``truth/clips.parquet``."""
        if self.secret is None:
            raise InputError(f"{self.folder}: its truth is withheld; open_dataset takes the folder with it as `truth`")
        path = self.secret / "truth" / "clips.parquet"
        try:
            rows = pd.read_parquet(path)
            return rows.astype({"clip": int, "scene": str})
        except (KeyError, ValueError, TypeError, OSError) as error:  # pyarrow's are of all kinds
            raise InputError(f"{path}: damaged ({first_line(error)})") from None

    @cached_property
    def about(self) -> dict[str, Any]:
        """How it was made: scenes, seed, version, machine, as in ``truth/dataset.json``; empty if that is withheld."""
        path = (self.secret or self.folder) / "truth" / "dataset.json"
        about: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        return about

    @cached_property
    def _folders(self) -> list[Path]:
        """The folder of each clip, in order."""
        folders = clip_folders(self.folder)
        if self.secret is not None and [int(f.name) for f in folders] != self.truth["clip"].tolist():
            raise InputError(f"{self.folder}: {len(folders)} clips for {len(self.truth)} rows of its truth")
        return folders

    @cached_property
    def _clips_of_scene(self) -> dict[str, int]:
        """Number of clips by the name of their scene."""
        return {str(name): int(count) for name, count in self.truth["scene"].value_counts().items()}

    def __len__(self) -> int:
        return len(self._folders)

    @overload
    def __getitem__(self, index: int) -> RecordedClip: ...
    @overload
    def __getitem__(self, index: slice) -> list[RecordedClip]: ...
    def __getitem__(self, index: int | slice) -> RecordedClip | list[RecordedClip]:
        if isinstance(index, slice):
            return [self._clip(k) for k in range(len(self))[index]]
        return self._clip(range(len(self))[index])

    def _clip(self, k: int) -> RecordedClip:
        folder = self._folders[k]
        if self.secret is None:
            return RecordedClip(int(folder.name), folder, {})
        truth = {str(column): value for column, value in self.truth.iloc[k].items()}
        secret = self.secret / "clips" / folder.name / "truth"
        return RecordedClip(int(folder.name), folder, truth, secret, self._clips_of_scene[truth["scene"]])


@check_arguments
def open_dataset(folder: str | Path, truth: str | Path | None = None) -> Dataset:
    """Open a dataset that `synthcam generate` has made. Its clips are read when they are asked for.

    Parameters
    ----------
    folder : str or Path
        The dataset.
    truth : str or Path, optional
        The folder with the truth, if that was withheld. Without it, clips have film and camera only.

    Returns
    -------
    Dataset
        A sequence of clips, each with ``film()``, ``camera_json``, ``truth``, ``tracks`` and ``events``.

    Raises
    ------
    InputError
        If the folder is not a complete dataset.

    Examples
    --------
    >>> import synthcam
    >>> dataset = synthcam.open_dataset("out/benchmark")  # doctest: +SKIP
    >>> dataset.truth["r"].mean(), dataset[3].film()[0].shape  # doctest: +SKIP
    >>> synthcam.open_dataset("nowhere")
    Traceback (most recent call last):
    ...
    synthcam_shared.errors.InputError: nowhere: no such folder; expected a dataset of `synthcam generate`
    """
    folder, secret = Path(folder), Path(truth) if truth is not None else Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected a dataset of `synthcam generate`")
    if not (folder / "clips").is_dir():
        raise InputError(f"{folder}: expected a dataset of `synthcam generate`, with a folder `clips`")
    if (folder / "truth" / "shard.json").is_file():
        raise InputError(f"{folder}: one shard, expected a dataset; `synthcam merge` makes it of all shards")
    known = (secret / "truth" / "clips.parquet").is_file()
    if truth is not None and not known:
        raise InputError(f"{secret}: no truth/clips.parquet in it; expected the withheld truth of {folder}")
    return Dataset(folder, secret if known else None)
