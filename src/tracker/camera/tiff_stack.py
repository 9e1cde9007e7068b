"""Reads TIFF stacks, a frame at a time."""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
        fetch: Callable[[int], Any] = _ContiguousFrames(path, offset, count, plane, dtype.newbyteorder(order))
    else:
        fetch = _TiffPages(path, plane)
        try:
            fetch(count - 1)
        except InputError:
            raise InputError(f"{path}: truncated, frame {count - 1} of {count} cannot be read") from None
    return make_grey_frames(path, count, plane, dtype, fetch)


@contextmanager
def _raise_logged_errors(path: Path) -> Iterator[None]:
    """Raise an error where tifffile only logs a broken chain of pages and goes on with the pages it has."""
    heard, logger = _LogCollector(logging.ERROR), logging.getLogger("tifffile")
    passed_on = logger.propagate
    logger.addHandler(heard)
    logger.propagate = False
    try:
        yield
    finally:
        logger.propagate = passed_on
        logger.removeHandler(heard)
    if heard.messages:
        raise InputError(f"{path}: truncated or damaged ({heard.messages[0].splitlines()[0][:120]})")


class _LogCollector(logging.Handler):
    """Keeps what is logged."""

    def __init__(self, level: int) -> None:
        super().__init__(level)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(record.getMessage())


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


class _ContiguousFrames:
    """Frames that lie one after the other: read by their offset in the file, so that no more than one is held."""

    def __init__(self, path: Path, offset: int, count: int, plane: tuple[int, ...], dtype: Any) -> None:
        self.path, self.offset, self.count, self.plane, self.dtype = path, offset, count, plane, dtype
        self.pixels = int(np.prod(plane))
        missing = offset + count * self.pixels * dtype.itemsize - path.stat().st_size
        if missing > 0:
            raise InputError(f"{path}: truncated, {missing} bytes short of {count} frames")
        self.file = path.open("rb", buffering=0)

    def __call__(self, k: int) -> Any:
        flat = np.empty(self.pixels, dtype=self.dtype)
        self.file.seek(self.offset + k * flat.nbytes)
        if self.file.readinto(flat.view(np.uint8).data) < flat.nbytes:
            raise InputError(f"{self.path}: truncated, frame {k} of {self.count} cannot be read")
        return flat.reshape(self.plane).astype(self.dtype.newbyteorder("="), copy=False)

    def __del__(self) -> None:
        if hasattr(self, "file"):
            self.file.close()


class _TiffPages:
    """Compressed frames or frames apart: one page of the file each; the file stays open between them."""

    def __init__(self, path: Path, plane: tuple[int, ...]) -> None:
        self.path, self.plane = path, plane
        self.file = tifffile.TiffFile(path)

    def __call__(self, k: int) -> Any:
        try:
            return np.asarray(self.file.pages[k].asarray()).reshape(self.plane)
        except Exception as error:  # decoders raise their own kinds
            raise InputError(f"{self.path}: frame {k} cannot be read ({first_line(error)})") from None

    def __del__(self) -> None:
        if hasattr(self, "file"):
            self.file.close()
