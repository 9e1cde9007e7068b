"""Reads a film that numpy.save has written, frame by frame from the disk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from synthcam_shared.errors import InputError, first_line
from tracker.camera.frame_times import drop_equal_pictures
from tracker.camera.frames import Frames, check_frame_size, check_pixel_type, make_grey_frames

ARRAYS = (".npy",)


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
    check_pixel_type(path, kind)
    check_frame_size(path, array.shape[1:])

    def fetch(k: int) -> Any:
        return np.ascontiguousarray(array[k], dtype=kind)

    return drop_equal_pictures(make_grey_frames(path, len(array), array.shape[1:], kind, fetch), fetch)
