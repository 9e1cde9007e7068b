"""A report folder that is written aside and moved into place, so that it is never half written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from synthcam_shared.errors import InputError
from synthcam_shared.outputs import as_input_error, check_writable, open_scratch_folder, publish_folder


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
