"""Writing files: the disk is tried first, and nothing half-written is left behind."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from synthcam.settings import InputError

ROOM = 1 << 16  # bytes that must fit before anything is begun


def check_room(output: Path) -> None:
    """Raises InputError at once where nothing can be written to `output`: a read-only or a full disk."""
    folder = output.absolute().parent
    while not folder.exists():
        folder = folder.parent
    probe = folder / f".{output.name}.{os.getpid()}.room"
    try:
        put(probe, bytes(ROOM))
        probe.unlink()
    except OSError as error:
        raise InputError(f"{output}: {error.strerror or error}; nothing can be written there") from None


@contextmanager
def as_input_error(output: Path, more: str = "") -> Iterator[None]:
    """An OSError of `output` as one line that names it; `more` follows the reason."""
    try:
        yield
    except OSError as error:
        if error.filename is not None and not _of(output, Path(str(error.filename))):
            raise
        raise InputError(f"{output}: {' '.join(str(error.strerror or error).split())}{more}") from None


def _of(output: Path, file: Path) -> bool:
    """Whether a file is in `output` or in what stands beside it until it is complete."""
    if output.parent not in file.parents:
        return False
    beside = file.relative_to(output.parent).parts[0].removeprefix(".")
    return beside == output.name or beside.startswith((f"{output.name}.", f"{output.name}-"))


def put(path: Path, data: bytes) -> None:
    """Write a file aside and move it into place. Where that fails, what was there before stays."""
    aside = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        aside.write_bytes(data)
        aside.replace(path)
    except BaseException:
        with suppress(OSError):
            aside.unlink()
        raise


def check_film(path: Path, frames: int) -> None:
    """Raises OSError where a film is cut short: OpenCV does not say when a disk is full."""
    import cv2  # here alone: it takes long to load

    film, count = cv2.VideoCapture(os.fspath(path), cv2.CAP_FFMPEG), 0
    while film.grab():
        count += 1
    film.release()
    if count != frames:
        raise OSError(f"a film of {count} frames, expected {frames}; is there room for it?")
