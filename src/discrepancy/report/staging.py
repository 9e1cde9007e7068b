"""A report is written aside and moved into its place."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tracker.camera.camera import InputError
from tracker.outputs import as_input_error, check_room

REPORT = ("discrepancy.json", "index.html", "model.yaml")


@contextmanager
def aside(output: Path) -> Iterator[Path]:
    """A folder to write into that becomes `output` when all went well. Refuses a folder that holds something else."""
    output = output.resolve()
    if output.exists() and (not output.is_dir() or any(p.name not in REPORT for p in output.iterdir())):
        raise InputError(f"{output}: holds something else; expected a report of an earlier search, or nothing")
    check_room(output)
    folder = output.with_name(f"{output.name}.{os.getpid()}.tmp")
    with as_input_error(output):
        folder.mkdir(parents=True)
        try:
            yield folder
            shutil.rmtree(output, ignore_errors=True)
            folder.rename(output)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
