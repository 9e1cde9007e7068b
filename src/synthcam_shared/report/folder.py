"""A report folder that is written aside and moved into place, so that it is never half written."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from synthcam_shared.errors import InputError
from synthcam_shared.outputs import as_input_error, check_writable, lock_folder


@contextmanager
def replace_folder(output: Path, files: Sequence[str], what: str) -> Iterator[Path]:
    """Give a folder to write into, which becomes `output` when everything succeeded.

    An earlier report, which has none but these `files` and is called `what` in a message, is replaced. Raises
    InputError where `output` holds other files, or cannot be written.
    """
    output = output.resolve()
    if output.exists() and (not output.is_dir() or any(path.name not in files for path in output.iterdir())):
        raise InputError(f"{output}: holds something else; expected {what}, or nothing")
    check_writable(output)
    folder = output.with_name(f"{output.name}.tmp")
    with as_input_error(output), lock_folder(folder):
        try:
            for rest in folder.iterdir():  # of a process that was killed
                shutil.rmtree(rest) if rest.is_dir() else rest.unlink()
            yield folder
            shutil.rmtree(output, ignore_errors=True)
            folder.rename(output)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
