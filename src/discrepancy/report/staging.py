"""A report is written aside and moved into its place."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from synthcam_shared.errors import InputError
from synthcam_shared.outputs import as_input_error, check_writable, lock_folder

REPORT = ("discrepancy.json", "index.html", "model.yaml")
PLAN = ("plan.json", "index.html")


@contextmanager
def aside(output: Path, files: Sequence[str] = REPORT) -> Iterator[Path]:
    """A folder to write into that becomes `output` when all went well. Refuses a folder that holds other files."""
    output = output.resolve()
    if output.exists() and (not output.is_dir() or any(p.name not in files for p in output.iterdir())):
        earlier = "an earlier plan" if files == PLAN else "a report of an earlier search"
        raise InputError(f"{output}: holds something else; expected {earlier}, or nothing")
    check_writable(output)
    folder = output.with_name(f"{output.name}.tmp")
    with as_input_error(output), lock_folder(folder):
        try:
            for left in folder.iterdir():  # by a killed process
                shutil.rmtree(left) if left.is_dir() else left.unlink()
            yield folder
            shutil.rmtree(output, ignore_errors=True)
            folder.rename(output)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
