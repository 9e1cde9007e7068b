"""Read a dataset: its clips one at a time, each with film, camera and truth, from its files when they are asked for."""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, overload

import numpy as np
import tifffile
from numpy.typing import NDArray

from synthcam_shared.arguments import check_arguments
from synthcam_shared.errors import InputError, first_line
from synthcam_shared.track_formats import split_by_particle

if TYPE_CHECKING:
    import pandas as pd

Item = TypeVar("Item")


@dataclass(frozen=True, eq=False, repr=False)
class RecordedClip:
    """One clip of a dataset. Its files are read when they are asked for; the names are those of `Clip`.

    Attributes
    ----------
    number : int
        Its number in the dataset.
    folder : Path
        Holds its film and ``camera.json``.
    truth : dict
        The scalars of the collision, a row of ``truth/clips.parquet``; empty if the truth is withheld.
    secret : Path, optional
        The folder with its truth; None if the truth is withheld.
    of : int
        Number of clips of its scene.

    Examples
    --------
    >>> import synthcam
    >>> clip = synthcam.open_dataset("out/benchmark")[0]  # doctest: +SKIP
    >>> tracker.track(clip.film(), clip.camera_json)  # doctest: +SKIP
    """

    number: int
    folder: Path
    truth: dict[str, Any]
    secret: Path | None = None
    of: int = 1

    def __repr__(self) -> str:
        film = f"{self.frames} frames" if self.video else "without film"
        return f"Clip {self.number} of {self.folder.parent.parent}: {film}{'' if self.secret else ', truth withheld'}"

    def check(self) -> None:
        """Raise InputError if something is missing or damaged that every format of export needs."""
        self._read(self.folder / "camera.json", lambda path: self._check_numbers())
        _ = self.drawn, self.events

    def _check_numbers(self) -> None:
        numbers = [*self.camera_json["size"], self.camera_json["fps"], self.bits, self.diameter_px, self.frames]
        largest = 1e9  # of any number that describes a camera or a stack
        if not all(0 < float(x) < largest for x in numbers):
            raise ValueError("camera.json or tracks.parquet without size, rate, bits, ball or frames")

    @cached_property
    def camera_json(self) -> dict[str, Any]:
        """The experimenter's knowledge of the camera: the keys of ``camera.json``; `tracker.track` takes them."""
        found: dict[str, Any] = self._read(self.folder / "camera.json", _read_json)
        return found

    @cached_property
    def drawn(self) -> dict[str, Any]:
        """The settings of the clip, without distributions."""
        found: dict[str, Any] = self._read(self._secret / "scene.json", lambda path: _read_json(path)["drawn"])
        return found

    @cached_property
    def tracks(self) -> pd.DataFrame:
        """The true tracks, a row for each ball and frame, with the columns of ``truth/tracks.parquet``."""
        return self._read_table("tracks")

    @cached_property
    def events(self) -> pd.DataFrame:
        """Contacts and ends of slides, with the columns of ``truth/events.parquet``."""
        return self._read_table("events")

    @cached_property
    def energy(self) -> pd.DataFrame:
        """Energies of many bodies, a row for each frame, with the columns of ``truth/energy.parquet``."""
        return self._read_table("energy")

    @property
    def scene(self) -> str:
        """Name of its scene."""
        return str(self.truth["scene"])

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.film()) if self.secret is None else int(self.tracks["frame"].max()) + 1

    @property
    def bits(self) -> int:
        """Bits of a count."""
        return int(self.camera_json["sensor"]["bits"])

    @property
    def stack(self) -> Path:
        """The file of its film."""
        return self.folder / "frames.tif"

    @property
    def video(self) -> bool:
        """Whether it has a film."""
        return self.stack.is_file()

    @property
    def diameter_px(self) -> float:
        """Diameter of a ball, px."""
        return float(self.camera_json["ball_diameter"] / self.camera_json["scale"])

    def film(self) -> RecordedFilm:
        """Open the film, of which each frame is read when it is indexed.

        Returns
        -------
        RecordedFilm
            A sequence of (height, width) arrays, in colour (height, width, 3); ``numpy.asarray`` reads all.

        Raises
        ------
        InputError
            If the dataset has no films.
        """
        return RecordedFilm(self.stack)

    def pictures(self) -> Iterator[NDArray[Any]]:
        """Read the frames one after the other.

        Yields
        ------
        ndarray
            (height, width), of a colour camera (height, width, 3): uint8 or uint16 counts.
        """
        return iter(self.film())

    def visible_tracks(self) -> list[list[tuple[Any, Any, Any]]]:
        """Cut the true tracks to the picture.

        Returns
        -------
        list of list of tuple
            Of each ball (frame, x, y), px, where its centre lies in the picture.
        """
        width, height = self.camera_json["size"]
        x, y = self.tracks["x_mean_px"], self.tracks["y_mean_px"]
        rows = self.tracks[(x > -0.5) & (x < width - 0.5) & (y > -0.5) & (y < height - 0.5)]
        return split_by_particle(*(rows[name] for name in ("particle", "frame", "x_mean_px", "y_mean_px")))

    @property
    def _secret(self) -> Path:
        """The folder with the truth. Raises InputError if it is withheld."""
        if self.secret is None:
            raise InputError(f"{self.folder}: its truth is withheld; open_dataset takes the folder with it as `truth`")
        return self.secret

    def _read_table(self, name: str) -> pd.DataFrame:
        import pandas as pd  # here alone: slow to load

        table: pd.DataFrame = self._read(self._secret / f"{name}.parquet", pd.read_parquet)
        return table

    def _read(self, path: Path, reader: Callable[[Path], Any]) -> Any:
        """The content of a file. Raises InputError where it is missing or damaged."""
        try:
            return reader(path)
        except InputError:
            raise
        except FileNotFoundError as error:
            raise InputError(f"{error.filename or path}: missing; `synthcam verify` lists what else is") from None
        except (KeyError, ValueError, TypeError, OSError, RecursionError) as error:  # pyarrow's are of all kinds
            raise InputError(f"{self.folder}: damaged ({first_line(error)}); `synthcam verify` lists more") from None


class LazySequence(Sequence[Item]):
    """A sequence whose items are read when it is indexed; a slice of it is a list."""

    @overload
    def __getitem__(self, index: int) -> Item: ...
    @overload
    def __getitem__(self, index: slice) -> list[Item]: ...
    def __getitem__(self, index: int | slice) -> Item | list[Item]:
        if isinstance(index, slice):
            return list(self._read(range(len(self))[index]))
        return next(self._read([range(len(self))[index]]))

    def __iter__(self) -> Iterator[Item]:
        return self._read(range(len(self)))

    @abstractmethod
    def _read(self, numbers: Sequence[int]) -> Iterator[Item]:
        """Read these items."""


class RecordedFilm(LazySequence[NDArray[Any]]):
    """The frames of a stack on disk, each read when it is indexed; no frame is kept.

    Examples
    --------
    >>> import numpy, synthcam
    >>> film = synthcam.open_dataset("out/benchmark")[0].film()  # doctest: +SKIP
    >>> numpy.asarray(film).shape  # doctest: +SKIP
    (100, 480, 640)
    """

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise InputError(f"{path}: no such file; expected a dataset with video")
        self.path = path

    @cached_property
    def _count(self) -> int:
        with self._open() as stack:
            if not len(stack.pages):
                raise self._damaged(ValueError("no frames"))
            return len(stack.pages)

    def __len__(self) -> int:
        return self._count

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(np.stack(list(self)), dtype=dtype)

    def _read(self, numbers: Sequence[int]) -> Iterator[NDArray[Any]]:
        with self._open() as stack:
            for number in numbers:
                try:
                    yield stack.pages[number].asarray()
                except Exception as error:  # decoders raise their own kinds
                    raise self._damaged(error) from None

    def _open(self) -> Any:
        try:
            return tifffile.TiffFile(self.path)
        except Exception as error:
            raise self._damaged(error) from None

    def _damaged(self, error: Exception) -> InputError:
        return InputError(f"{self.path}: damaged ({first_line(error)}); `synthcam verify` lists more")


def _read_json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


@dataclass(frozen=True, eq=False, repr=False)
class Dataset(LazySequence[RecordedClip]):
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
        import pandas as pd  # here alone: slow to load

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
        folders = list_clip_folders(self.folder)
        if self.secret is not None and [int(f.name) for f in folders] != self.truth["clip"].tolist():
            raise InputError(f"{self.folder}: {len(folders)} clips for {len(self.truth)} rows of its truth")
        return folders

    @cached_property
    def _clips_of_scene(self) -> dict[str, int]:
        """Number of clips by the name of their scene."""
        return {str(name): int(count) for name, count in self.truth["scene"].value_counts().items()}

    def __len__(self) -> int:
        return len(self._folders)

    def _read(self, numbers: Sequence[int]) -> Iterator[RecordedClip]:
        for k in numbers:
            folder = self._folders[k]
            if self.secret is None:
                yield RecordedClip(int(folder.name), folder, {})
                continue
            truth = {str(column): value for column, value in self.truth.iloc[k].items()}
            secret = self.secret / "clips" / folder.name / "truth"
            yield RecordedClip(int(folder.name), folder, truth, secret, self._clips_of_scene[truth["scene"]])


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


def list_clip_folders(folder: Path) -> list[Path]:
    """List the folders of the complete clips of a dataset in order."""
    return sorted(p for p in (folder / "clips").glob("[0-9]*") if p.is_dir() and p.name.isascii() and p.name.isdigit())
