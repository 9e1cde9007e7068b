"""Wraps arrays as `Frames`: a film in memory, or one that numpy.save has written, read from the disk frame by frame."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.errors import InputError, first_line
from tracker.camera.frame_times import drop_equal_pictures
from tracker.camera.frames import Frames, check_two_frames, make_grey_frames

ARRAYS = (".npy",)
FILM = "film"  # what messages call it


def wrap_frames(film: NDArray[Any] | Iterable[NDArray[Any]]) -> Frames:
    """Wrap an array (n, height, width), in colour (n, height, width, 3), or single pictures as the frames of a film.

    An object with a length and an index is read frame by frame, when needed. The pictures of an iterator are kept.
    Raises InputError, naming the frame, for what is no film.
    """
    if hasattr(film, "columns"):  # a table of pandas, polars or pyarrow
        raise InputError(f"{FILM}: a table, expected a film; tracker.measure(tracks, camera) measures tracks")
    indexed = hasattr(film, "__len__") and hasattr(film, "__getitem__")
    is_number = getattr(film, "shape", None) == ()  # an array without an axis has a length that raises TypeError
    if is_number or not (indexed or isinstance(film, Iterable)):
        raise InputError(
            f"{FILM}: of type {type(film).__name__}, expected an array (frames, height, width), frames or a path"
        )
    pictures: Any = film if indexed else list(film)
    if not len(pictures):
        raise InputError(f"{FILM}: no frames, expected at least two to follow a ball")
    first = _picture(pictures, 0)
    if first.ndim not in (2, 3) or 0 in first.shape:
        raise InputError(f"{FILM}: pictures of shape {first.shape}, expected (height, width) of each frame")

    def fetch(k: int) -> Any:
        picture = _picture(pictures, k)
        if picture.shape != first.shape or picture.dtype != first.dtype:
            has, wants = (f"{'x'.join(map(str, a.shape[1::-1]))} {a.dtype}" for a in (picture, first))
            raise InputError(f"{FILM}: frame {k} is {has}, expected {wants} as frame 0")
        return picture

    frames = make_grey_frames(FILM, len(pictures), first.shape, first.dtype, fetch)
    check_two_frames(FILM, frames)
    if not isinstance(pictures, np.ndarray | list):
        return frames  # pictures that may be slow to read
    return drop_equal_pictures(frames, fetch)


def read_array_file(path: Path) -> Frames:
    """Read the frames of a numpy array file, (frames, height, width) or (..., 3) in colour. Raises InputError."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise InputError(f"{path}: cannot be read as an array of numpy.save ({first_line(error)})") from None
    if not isinstance(array, np.ndarray) or array.ndim not in (3, 4) or 0 in array.shape:
        shape = getattr(array, "shape", "of several arrays")
        raise InputError(f"{path}: an array {shape}, expected (frames, height, width), in colour (..., 3)")
    kind = array.dtype.newbyteorder("=")

    def fetch(k: int) -> Any:
        return np.ascontiguousarray(array[k], dtype=kind)

    return drop_equal_pictures(make_grey_frames(path, len(array), array.shape[1:], kind, fetch), fetch)


def _picture(pictures: Any, k: int) -> NDArray[Any]:
    try:
        return np.ascontiguousarray(pictures[k])
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(f"{FILM}: frame {k} cannot be read as an array ({error})") from None
