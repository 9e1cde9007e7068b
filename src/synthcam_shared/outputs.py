"""Writing files: the disk is tried first, one process at a time in a folder, nothing half-written left behind."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from synthcam_shared.errors import InputError

ROOM = 1 << 16  # bytes that must fit before anything is begun


def check_writable(output: Path) -> None:
    """Raises InputError at once where nothing can be written to ``output``: a read-only or a full disk."""
    folder = output.absolute().parent
    while not folder.exists():
        folder = folder.parent
    probe = folder / f".{output.name}.{os.getpid()}.room"
    try:
        write_atomically(probe, bytes(ROOM))
        probe.unlink()
    except OSError as error:
        raise InputError(f"{output}: {error.strerror or error}; nothing can be written there") from None


@contextmanager
def as_input_error(output: Path, more: str = "") -> Iterator[None]:
    """An OSError of ``output`` as one line that names it; ``more`` follows the reason."""
    try:
        yield
    except OSError as error:
        if error.filename is not None and not _of(output, Path(str(error.filename))):
            raise
        raise InputError(f"{output}: {' '.join(str(error.strerror or error).split())}{more}") from None


def _of(output: Path, file: Path) -> bool:
    """Whether a file is in ``output`` or in what stands beside it until it is complete."""
    if output.parent not in file.parents:
        return False
    beside = file.relative_to(output.parent).parts[0].removeprefix(".")
    return beside == output.name or beside.startswith((f"{output.name}.", f"{output.name}-"))


def write_atomically(path: Path, data: str | bytes) -> None:
    """Writes a file aside and moves it into place, in a new folder if need be. Where it fails, what was there stays."""
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        aside.write_bytes(data.encode() if isinstance(data, str) else data)
        aside.replace(path)
    except BaseException:
        with suppress(OSError):
            aside.unlink()
        raise


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Makes a folder, if need be, and keeps other processes out of it; the lock ends with this process at the latest.

    Raises InputError where another process is at work there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        import fcntl
    except ImportError:  # no locks on this system
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            gone = not folder.is_dir() or not os.path.samestat(os.fstat(handle), folder.stat())
        except BlockingIOError:
            gone = True
        except OSError:  # a file system without locks
            gone = False
        if gone:  # or moved into its place between the two lines above
            raise InputError(f"{folder}: another process is at work there; wait for it, or choose another folder")
        yield
    finally:
        os.close(handle)
