"""Export a dataset to the formats of other programs: each file of the folder `exports` is one format."""

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from synthcam.dataset import exports
from synthcam.dataset.recorded_dataset import Dataset, RecordedClip, open_dataset
from synthcam_shared.errors import InputError
from synthcam_shared.jobs import Progress
from synthcam_shared.outputs import as_input_error, check_writable, open_scratch_folder, publish_folder


def list_export_formats() -> dict[str, str]:
    """Describe each format to which a dataset can be exported in one line, by its name."""
    names = sorted(info.name for info in pkgutil.iter_modules(exports.__path__))
    return {name: (_module(name).__doc__ or "").splitlines()[0] for name in names}


def _module(name: str) -> Any:
    return importlib.import_module(f"{exports.__name__}.{name}")


def export(dataset: Path, kind: str, output: Path, progress: Progress, truth: Path | None = None) -> int:
    """Write a dataset in another program's format, in a temporary folder that then becomes `output`.

    kind: name of the format, a file of the folder `exports`. Settings follow a colon, as in h264:crf=28.
    output: a new or empty folder.
    progress: takes the clips done and the clips in all.
    truth: the folder with the truth if it was withheld.

    Returns the number of clips. Raises InputError.
    """
    kind, _, wishes = kind.partition(":")
    if kind not in list_export_formats():
        raise InputError(f"--format {kind}: no such format; there are {', '.join(list_export_formats())}")
    write = _module(kind).write
    if wishes:
        if "wishes" not in inspect.signature(write).parameters:
            raise InputError(f"--format {kind}:{wishes}: {kind} takes no settings")
        write = partial(write, wishes=wishes)
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise InputError(f"{output}: exists; expected a new or empty folder")
    table = (truth or dataset) / "truth" / "clips.parquet"
    if not table.is_file() or not (dataset / "clips").is_dir():
        raise InputError(f"{table}: no such file; expected a dataset with its truth (withheld: --truth TRUTH)")
    output = output.resolve()
    check_writable(output)
    clips = open_dataset(dataset, truth)
    with as_input_error(output), open_scratch_folder(output) as beside:
        write(_iterate_clips(clips, progress), beside)
        publish_folder(beside, output)
    return len(clips)


def _iterate_clips(clips: Dataset, progress: Progress) -> Iterator[RecordedClip]:
    for k, clip in enumerate(clips):
        clip.check()
        yield clip
        progress(k + 1, len(clips))
