"""Results in the formats of other programs: each is a file of the folder `tables/formats`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from synthcam_shared.errors import InputError
from synthcam_shared.outputs import (
    as_input_error,
    check_writable,
    open_scratch_folder,
    publish_folder,
    write_atomically,
)
from synthcam_shared.settings import did_you_mean
from tracker.results import list_clips, read_clip
from tracker.tables.read import list_table_formats


def export(results: Path, kind: str, output: Path) -> int:
    """Write the tracks of RESULTS in the format `kind` of another program: how many clips. Raises InputError.

    output: a new file, where there is one clip; else a new folder, with a file for each.
    """
    writers: dict[str, Any] = {name: one for name, one in list_table_formats().items() if hasattr(one, "write")}
    if kind not in writers:
        hint = did_you_mean(kind, writers)
        raise InputError(f"--format {kind}: no such format; there are {', '.join(writers)}{hint}")
    numbers = list_clips(results)
    if output.exists():
        raise InputError(f"{output}: exists, expected a new {'file' if len(numbers) == 1 else 'folder'}")
    check_writable(output)
    one = writers[kind]
    with as_input_error(output), open_scratch_folder(output) as aside:
        for number in numbers:
            write_atomically(aside / f"{number:06d}{one.SUFFIX}", one.write(*read_clip(results, number)))
        if len(numbers) == 1:
            (aside / f"{numbers[0]:06d}{one.SUFFIX}").replace(output)
        else:
            publish_folder(aside, output)
    return len(numbers)
