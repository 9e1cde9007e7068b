"""Results in the formats of other programs: each is a file of the folder `tables/formats`."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from synthcam_shared.errors import InputError
from synthcam_shared.outputs import as_input_error, check_writable, write_atomically
from tracker.camera.camera_keys import did_you_mean
from tracker.results import read_clip
from tracker.tables.read import formats


def export(results: Path, kind: str, output: Path) -> int:
    """Write the tracks of RESULTS in another program's format.

    Parameters
    ----------
    results : Path
        RESULTS.
    kind : str
        Name of the format.
    output : Path
        A new file, where there is one clip; else a new folder, with a file for each.

    Returns
    -------
    int
        How many clips.

    Raises
    ------
    InputError
    """
    writers: dict[str, Any] = {name: one for name, one in formats().items() if hasattr(one, "write")}
    if kind not in writers:
        hint = did_you_mean(kind, {name: name for name in writers})
        raise InputError(f"--format {kind}: no such format; there are {', '.join(writers)}{hint}")
    folders = sorted((results / "clips").glob("[0-9]*/tracks.parquet"))
    if not folders:
        raise InputError(f"{results}: no clips/ with tracks in it, expected RESULTS, as tracker track makes them")
    if output.exists():
        raise InputError(f"{output}: exists, expected a new {'file' if len(folders) == 1 else 'folder'}")
    check_writable(output)
    written, one = [], writers[kind]
    with as_input_error(output):
        aside = output.with_name(f"{output.name}.tmp")
        shutil.rmtree(aside, ignore_errors=True)
        try:
            aside.mkdir(parents=True)
            for file in folders:
                write_atomically(
                    aside / f"{file.parent.name}{one.SUFFIX}", one.write(*read_clip(results, int(file.parent.name)))
                )
                written.append(file.parent.name)
            (aside / f"{written[0]}{one.SUFFIX}" if len(written) == 1 else aside).replace(output)
        finally:
            shutil.rmtree(aside, ignore_errors=True)
    return len(written)
