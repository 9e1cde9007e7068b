"""Reads TIFF stacks, a frame at a time."""

from __future__ import annotations

import logging
import math
import struct
import sys
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from logging.handlers import BufferingHandler
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from synthcam_shared.errors import InputError
from tracker.camera.camera_keys import first_line
from tracker.camera.frames import Frames, check_frame_size, check_pixel_type, make_grey_frames


def read_tiff_stack(path: Path) -> Frames:
    """Frames of a TIFF stack. Raises InputError if it is damaged."""
    try:
        with _raise_logged_errors(path), tifffile.TiffFile(path) as tif:
            shape, dtype, colour, offset = _layout(path, tif)
            order = tif.byteorder
    except (tifffile.TiffFileError, OSError, IndexError, KeyError, struct.error) as error:
        raise InputError(f"{path}: cannot be read as TIFF, truncated or damaged ({first_line(error)})") from None
    plane = shape[-3:] if colour else shape[-2:]
    if len(shape) < len(plane) or 0 in shape:
        raise InputError(f"{path}: expected a stack of pictures, not an array of {shape}")
    check_frame_size(path, plane)
    count = int(np.prod(shape[: len(shape) - len(plane)], dtype=np.int64))
    check_pixel_type(path, dtype)
    if offset is not None:
        fetch = _read_by_offset(path, offset, count, plane, dtype.newbyteorder(order))
    else:
        fetch = _read_pages(path, plane)
        try:
            fetch(count - 1)
        except InputError:
            raise InputError(f"{path}: truncated, frame {count - 1} of {count} cannot be read") from None
    return make_grey_frames(path, count, plane, dtype, fetch)


@contextmanager
def _raise_logged_errors(path: Path) -> Iterator[None]:
    """Raise an error where tifffile only logs a broken chain of pages and goes on with the pages it has."""
    heard, logger = BufferingHandler(sys.maxsize), logging.getLogger("tifffile")
    heard.setLevel(logging.ERROR)
    passed_on = logger.propagate
    logger.addHandler(heard)
    logger.propagate = False
    try:
        yield
    finally:
        logger.propagate = passed_on
        logger.removeHandler(heard)
    if heard.buffer:
        message = heard.buffer[0].getMessage()
        raise InputError(f"{path}: truncated or damaged ({message.splitlines()[0][:120]})")


def _layout(path: Path, tif: tifffile.TiffFile) -> tuple[tuple[int, ...], Any, bool, int | None]:
    """Shape, type, whether in colour, and where the pixels start if they lie in one piece."""
    series = tif.series[0]
    shape, dtype, offset = tuple(series.shape), np.dtype(series.dtype), series.dataoffset
    colour = series.axes[-1:] == "S" and shape[-1] in (2, 3, 4)
    if len(tif.series) > 1:  # pages that no program declared to be one stack
        if any(s.shape != shape or s.dtype != dtype for s in tif.series):
            raise InputError(f"{path}: pages of unequal size or type, expected all the same")
        plane = shape[-3:] if colour else shape[-2:]
        return (len(tif.pages), *plane), dtype, colour, None
    return shape, dtype, colour, None if offset is None else int(offset)


def _read_by_offset(path: Path, offset: int, count: int, plane: tuple[int, ...], dtype: Any) -> Callable[[int], Any]:
    """A reader of frames that lie one after the other, by their offset in the file; no more than one is held."""
    pixels = math.prod(plane)
    missing = offset + count * pixels * dtype.itemsize - path.stat().st_size
    if missing > 0:
        raise InputError(f"{path}: truncated, {missing} bytes short of {count} frames")
    file = path.open("rb", buffering=0)

    def fetch(k: int) -> Any:
        flat = np.empty(pixels, dtype=dtype)
        file.seek(offset + k * flat.nbytes)
        if file.readinto(flat.view(np.uint8).data) < flat.nbytes:
            raise InputError(f"{path}: truncated, frame {k} of {count} cannot be read")
        return flat.reshape(plane).astype(dtype.newbyteorder("="), copy=False)

    weakref.finalize(fetch, file.close)
    return fetch


def _read_pages(path: Path, plane: tuple[int, ...]) -> Callable[[int], Any]:
    """A reader of frames that are compressed or apart, one page of the file each; the file stays open between them."""
    file = tifffile.TiffFile(path)

    def fetch(k: int) -> Any:
        try:
            return np.asarray(file.pages[k].asarray()).reshape(plane)
        except Exception as error:  # decoders raise their own kinds
            raise InputError(f"{path}: frame {k} cannot be read ({first_line(error)})") from None

    weakref.finalize(fetch, file.close)
    return fetch
