"""Write files and folders whole, overwrite nothing foreign, lock a folder, and let a killed run be continued."""

import os
import shutil
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from synthcam_shared.errors import InputError

RESUMES = "; the same command continues where it stopped"


def check_writable(output: Path, probe_bytes: int = 1 << 16) -> None:
    """Raise InputError if nothing can be written to ``output``, as on a read-only or full disk."""
    check_utf8(output)
    folder = output.absolute().parent
    while not folder.exists():
        folder = folder.parent
    probe = folder / f".{output.name}.{os.getpid()}.room"
    try:
        write_atomically(probe, bytes(probe_bytes))
        probe.unlink()
    except OSError as error:
        raise InputError(f"{output}: {error.strerror or error}; nothing can be written there") from None


def check_utf8(path: Path) -> None:
    """Raise InputError if a name is not UTF-8: readers and writers in C fail there, some without a word."""
    try:
        f"{path}".encode()
    except UnicodeEncodeError:
        raise InputError(f"{f'{path}'!a}: its name is not UTF-8; rename it, or choose another") from None


@contextmanager
def as_input_error(output: Path, more: str = "") -> Iterator[None]:
    """Raise an OSError of a file in ``output`` as an InputError of one line that names ``output``.

    ``more`` follows the reason.
    """
    try:
        yield
    except OSError as error:
        if error.filename is not None and not _is_inside(Path(str(error.filename)), output):
            raise
        raise InputError(f"{output}: {' '.join(str(error.strerror or error).split())}{more}") from None


def _is_inside(file: Path, output: Path) -> bool:
    """Tell whether a file is in ``output``, or in the folder beside it that becomes ``output`` when complete."""
    if output.parent not in file.parents:
        return False
    beside = file.relative_to(output.parent).parts[0].removeprefix(".")
    return beside == output.name or beside.startswith((f"{output.name}.", f"{output.name}-"))


def write_atomically(path: Path, data: str | bytes) -> None:
    """Write a file under another name and move it into place, in a new folder if need be.

    If this fails, the earlier file stays unchanged.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        aside.write_bytes(data.encode(errors="backslashreplace") if isinstance(data, str) else data)
        aside.replace(path)
    except BaseException:
        with suppress(OSError):
            aside.unlink()
        raise


def name_temporary(final: Path) -> Path:
    """Name a folder beside `final` that no other worker on any machine uses."""
    return final.with_name(f"{final.name}-{uuid.uuid4().hex[:12]}.tmp")


def move_into_place(aside: Path, final: Path) -> None:
    """Move a folder to its final name. If another worker has made `final` meanwhile, that one stays."""
    try:
        aside.rename(final)
    except OSError:
        if not final.is_dir():
            raise
        shutil.rmtree(aside)


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Make a folder, if need be, and keep other processes out of it. The lock ends with this process at the latest.

    Raises InputError if another process is at work there.
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
            taken = not folder.is_dir() or not os.path.samestat(os.fstat(handle), folder.stat())
        except BlockingIOError:
            taken = True
        except OSError:  # a file system without locks
            taken = False
        if taken:  # or moved into its place between the two lines above
            raise InputError(f"{folder}: another process is at work there; wait for it, or choose another folder")
        yield
    finally:
        os.close(handle)


@contextmanager
def open_resumable(folder: Path, maker: str, expected: str) -> Iterator[None]:
    """Work in a locked folder that is new, empty, or begun by an earlier run of `maker`, whose name `.made_by` holds.

    Raises InputError if it holds something else; `expected` ends the message.
    """
    made_by_file = ".made_by"  # which command may go on with the folder or overwrite it
    mark = folder / made_by_file
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        own = mark.is_file() and mark.read_text(errors="replace").strip() == maker
        if not own:
            raise InputError(f"{folder}: exists and holds something else, expected {expected}")
    check_writable(folder)
    with lock_folder(folder), as_input_error(folder, RESUMES):
        write_atomically(mark, f"{maker}\n")
        yield


@contextmanager
def resume_folder(partial: Path, plan_file: str, plan: str) -> Iterator[None]:
    """Work in a folder that a killed run may have left, and that the next run with the same settings continues.

    The caller has checked that `partial` is missing, empty, or of the same plan. The folder is locked, `plan`, which
    distinguishes this run from others, is written into it, and the leftovers of killed workers (``clips/*.tmp``) are
    removed. If the work fails before any clip is complete, the folder is removed again. Raises InputError if another
    process is at work there, or the disk is full.
    """
    check_utf8(partial)
    with as_input_error(partial), lock_folder(partial):
        try:
            with as_input_error(partial):
                beside = partial.with_name(f"{partial.name}.plan")
                write_atomically(beside, plan)
                beside.replace(partial / plan_file)  # first of all: a folder without a plan counts as foreign
                (partial / "clips").mkdir(exist_ok=True)
                for leftover in (partial / "clips").glob("*.tmp"):
                    shutil.rmtree(leftover)
            with as_input_error(partial, RESUMES):
                yield
        except BaseException:
            if not any((partial / "clips").glob("*[0-9]")):
                shutil.rmtree(partial, ignore_errors=True)
            raise


UNFINISHED = ".unfinished"  # in a folder that a command has made and not completed


@contextmanager
def open_scratch_folder(final: Path) -> Iterator[Path]:
    """Make the empty folder `final`.tmp for one process; it is removed at the end unless `publish_folder` has moved it.

    Raises InputError if it exists and is not what a killed process left.
    """
    beside = final.with_name(f"{final.name}.tmp")
    with lock_folder(beside):
        if any(beside.iterdir()) and not (beside / UNFINISHED).exists():
            advice = f"{final.name} is made there: remove it or choose another -o"
            raise InputError(f"{beside}: holds something else; {advice}")
        try:
            (beside / UNFINISHED).touch()
            for leftover in beside.iterdir():
                if leftover.name != UNFINISHED:
                    shutil.rmtree(leftover) if leftover.is_dir() else leftover.unlink()
            yield beside
        finally:
            shutil.rmtree(beside, ignore_errors=True)


def publish_folder(folder: Path, final: Path) -> None:
    """Move a complete scratch folder to its final place. The caller has checked that what is there may go."""
    (folder / UNFINISHED).unlink(missing_ok=True)  # Zarr empties its folder
    shutil.rmtree(final, ignore_errors=True)
    folder.rename(final)


@contextmanager
def replace_folder(output: Path, files: Sequence[str], what: str) -> Iterator[Path]:
    """Give a report folder to write into, which becomes `output` when everything succeeded.

    An earlier report, which is called `what` in a message, is replaced. It has the first of `files`, which no other
    program makes, and nothing but these files. Raises InputError where `output` holds other files, or cannot be
    written.
    """
    output = output.resolve()
    names = {path.name for path in output.iterdir()} if output.is_dir() else set[str]()
    if output.exists() and (not output.is_dir() or names - set(files) or (names and files[0] not in names)):
        raise InputError(f"{output}: holds something else; expected {what}, or nothing")
    check_writable(output)
    with as_input_error(output), open_scratch_folder(output) as folder:
        yield folder
        publish_folder(folder, output)


def check_not_read(output: Path, *inputs: Path | None) -> None:
    """Raise InputError if a command that writes `output` would overwrite one of its own inputs.

    The output may be a file or a folder; links are followed.
    """
    for given in filter(None, inputs):
        with suppress(OSError):  # the reader of a missing file reports it
            same = os.path.samefile(output, given)
            if same or (output.is_dir() and output.resolve() in given.resolve().parents):
                where = "the command reads it" if same else f"the command reads {given} in it"
                raise InputError(f"{output}: {where}, and would overwrite it; expected another -o")


def check_replaceable(output: Path, mark: bytes, maker: str) -> None:
    """Raise InputError if a command may not overwrite `output`: it lacks the `mark` that `maker` leaves in its files.

    The first or last 4 KiB hold the mark.
    """
    if not output.exists() and not output.is_symlink():
        return
    if output.is_dir():
        raise InputError(f"{output}: a folder; expected the name of a file")
    ends = b""
    with as_input_error(output):
        if output.is_file():
            with output.open("rb") as file:
                ends = file.read(4096)
                file.seek(max(output.stat().st_size - 4096, 0))
                ends += b"\n" + file.read()
    if mark not in ends:
        raise InputError(f"{output}: exists and was not made by `{maker}`; expected a new file: choose another -o")
