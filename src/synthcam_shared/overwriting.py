"""Refuse to overwrite a file that a command reads or has not made."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from synthcam_shared.errors import InputError
from synthcam_shared.outputs import as_input_error


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
