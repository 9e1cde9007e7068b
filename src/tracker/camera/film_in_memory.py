"""Wraps a film in memory as `Frames`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.errors import InputError
from tracker.camera.frame_times import drop_equal_pictures
from tracker.camera.frames import Frames, check_frame_size, check_pixel_type, make_grey_frames
from tracker.camera.recordings import check_two_frames

FILM = "film"  # what messages call it


def wrap_frames(film: NDArray[Any] | Iterable[NDArray[Any]]) -> Frames:
    """Wrap an array (n, height, width), in colour (n, height, width, 3), or single pictures as the frames of a film.

    An object with a length and an index is read frame by frame, when needed. The pictures of an iterator are kept.
    Raises InputError, naming the frame, for what is no film.
    """
    if hasattr(film, "columns"):  # a table of pandas, polars or pyarrow
        raise InputError(f"{FILM}: a table, expected a film; tracker.measure(tracks, camera) measures tracks")
    indexed = hasattr(film, "__len__") and hasattr(film, "__getitem__")
    if not indexed and not isinstance(film, Iterable):
        raise InputError(
            f"{FILM}: of type {type(film).__name__}, expected an array (frames, height, width), frames or a path"
        )
    pictures: Any = film if indexed else list(film)
    if not len(pictures):
        raise InputError(f"{FILM}: no frames, expected at least two to follow a ball")
    first = _picture(pictures, 0)
    if first.ndim not in (2, 3) or 0 in first.shape:
        raise InputError(f"{FILM}: pictures of shape {first.shape}, expected (height, width) of each frame")
    check_pixel_type(FILM, first.dtype)
    check_frame_size(FILM, first.shape)

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


def _picture(pictures: Any, k: int) -> NDArray[Any]:
    try:
        return np.ascontiguousarray(pictures[k])
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(f"{FILM}: frame {k} cannot be read as an array ({error})") from None
