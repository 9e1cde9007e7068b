"""Clips through the whole chain, in parallel, resumable: read, detect, link, measure, write."""

from __future__ import annotations

import functools
import hashlib
import json
import shutil
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import pandas as pd

from synthcam_shared.errors import InputError
from synthcam_shared.outputs import as_input_error, check_writable, lock_folder
from tracker import results
from tracker.camera.frames import GREY
from tracker.camera.recordings import RecordingSource, open_source
from tracker.detection.channel import select_channel
from tracker.detection.choose import choose_detector
from tracker.detection.detect import load_detector, load_linker
from tracker.parallel import Progress, alone, in_parallel
from tracker.recording import describe_camera_gaps, measure_tracks, track_and_measure
from tracker.tables.read import read_tracks

if TYPE_CHECKING:
    from tracker.report.pages import ResultPages

ENDS = 1 << 16  # bytes at either end of a file that distinguish recordings
Done = tuple[int, tuple[str, ...]]  # frames of a clip, and notes on it


@dataclass(frozen=True)
class ClipOutcome:
    """What a run did: the estimates, how many clips, how many of them now, frames tracked now.

    notes: what was converted or assumed, each with the number of clips. source: the films, as they were read.
    """

    estimates: pd.DataFrame
    clips: int
    fresh: int
    frames: int
    notes: dict[str, int] = field(default_factory=dict)
    source: RecordingSource | None = None


def run(
    path: Path,
    output: Path,
    camera: Path | None,
    name: str | None,
    workers: int,
    progress: Progress = lambda done, of: None,
    channel: str | None = None,
    only: Collection[int] | None = None,
    scheduler: str = "",
) -> ClipOutcome:
    """Track every clip of a source into RESULTS; go on from what an interrupted run left in RESULTS.partial.

    Parameters
    ----------
    path : Path
        A dataset, clip, stack, video or folder of pictures.
    output : Path
        RESULTS.
    camera : Path or None
        A camera file in place of the source's own.
    name : str or None
        Of the detector; None: what the first clip asks for.
    workers : int
        Processes; 0: one a core, where so many are quicker.
    progress : callable
        Takes clips done and clips in all.
    channel : str or None
        Of films in colour; None: what the first clip asks for.
    only : collection of int, optional
        The clips wanted, by number; default: all.
    scheduler : str
        Address of a Dask scheduler, whose workers see the same folders.

    Returns
    -------
    Outcome

    Raises
    ------
    InputError
    """
    if name is not None:
        load_detector(name)
    source = open_source(path, camera)
    if only is not None:
        source = replace(source, clips=tuple(clip for clip in source.clips if clip[0] in only))
    output = output.resolve()
    if source.path.resolve() in output.parents:
        raise InputError(f"{output}: lies in {source.path}, expected a folder outside it")
    if not output.exists():
        check_writable(output)
    first, why = select_channel(source.open_clip(0), channel)
    if name is not None:
        load_linker(name, first.camera)
    source, said = replace(source, channel=first.channel), [why] if why else []
    if name is None:
        name, why = choose_detector(first.frames, first.camera)
        said += [why] if why else []
    plan = _plan(source, name)
    numbers = [number for number, _ in source.clips]
    if output.exists():
        _same_or_refuse(output, plan)
        return ClipOutcome(results.gather(output, numbers), len(source), 0, 0, source=source)
    frames, notes = 0, Counter[str]({note: len(source) for note in said})
    with _partial(output, plan) as partial:
        todo = [i for i, number in enumerate(numbers) if not results.is_done(partial, number)]
        progress(len(source) - len(todo), len(source))
        each = _on_cluster(scheduler) if scheduler else functools.partial(_each, workers=workers)
        for done, (count, noted) in enumerate(each(source, todo, partial, name), 1):
            frames += count
            notes.update(noted)
            progress(len(source) - len(todo) + done, len(source))
        table = results.finish(partial, output, numbers)
    return ClipOutcome(table, len(source), len(todo), frames, dict(notes), source)


def measure_tables(
    path: Path, output: Path, camera: Path, point: str = "centre", columns: str = "", unit: str = ""
) -> ClipOutcome:
    """Measure tracks that any program made, as `run` does its own.

    Parameters
    ----------
    path : Path
        CSV or Parquet: clip, frame, particle, x, y; or a file of another program.
    output : Path
        RESULTS.
    camera : Path
        The camera file of the tracks.
    point : {"centre", "glint"}
        What x and y are.
    columns, unit : str
        As `read_tracks` takes them.

    Returns
    -------
    Outcome

    Raises
    ------
    InputError
    """
    given = read_tracks(path, camera, columns, unit)
    base, tables = given.camera, given.clips
    digest = hashlib.sha256(path.read_bytes() + camera.read_bytes() + f"{point}{columns}{unit}".encode()).hexdigest()
    plan = {"made_by": "tracker measure", "input": digest}
    numbers = sorted(tables)
    output = output.resolve()
    if output.exists():
        _same_or_refuse(output, plan)
        return ClipOutcome(results.gather(output, numbers), len(numbers), 0, 0)
    with _partial(output, plan) as partial:
        todo = [n for n in numbers if not results.is_done(partial, n)]
        for number in todo:
            tracks, striker = tables[number]
            own = replace(base, striker=striker) if striker is not None else base
            result = measure_tracks(tracks, own, number, point)
            results.write_clip(partial, number, result.found, result.motion, result.rows, own)
        table = results.finish(partial, output, numbers)
    said = (*given.notes, *describe_camera_gaps(base))
    notes = {note: len(numbers) for note in said if not note.startswith("assumed")}
    return ClipOutcome(table, len(numbers), len(todo), 0, notes)


def write_pages(pages: ResultPages, estimates: pd.DataFrame, workers: int, progress: Progress) -> None:
    """Write the pages of RESULTS that are not there yet.

    Parameters
    ----------
    pages : Pages
    estimates : DataFrame
        Of all its recordings.
    workers : int
        Processes; 0: one a core, where so many are quicker.
    progress : callable
        Takes pages done and pages in all.

    Raises
    ------
    InputError
    """
    todo = pages.missing()
    for done, _ in enumerate(in_parallel(pages.write, todo, workers, pages.output), 1):
        progress(done, len(todo))
    pages.write_overview(estimates)


@contextmanager
def _partial(output: Path, plan: dict[str, Any]) -> Iterator[Path]:
    """The folder in which results are gathered, locked: a new one, or the one that the same command left behind.

    Where the input or the disk is at fault and no clip is done, it is removed again.
    """
    check_writable(output)
    partial = output.with_name(output.name + ".partial")
    with lock_folder(partial):
        if any(partial.iterdir()):
            _same_or_refuse(partial, plan)
        try:
            with as_input_error(partial, "; the same command goes on where it stopped"):
                results.write_json(partial / results.RUN, plan)
                (partial / "clips").mkdir(exist_ok=True)
                for leftover in (partial / "clips").glob("*.tmp"):
                    shutil.rmtree(leftover)
                yield partial
        except InputError:
            if not any((partial / "clips").glob("*")):
                shutil.rmtree(partial, ignore_errors=True)
            raise


def _same_or_refuse(folder: Path, plan: dict[str, Any]) -> None:
    """An output folder may hold the same run, whole or in part, and nothing else."""
    note = folder / results.RUN
    if not folder.is_dir() or not note.is_file():
        raise InputError(f"{folder}: exists and holds something else, expected a new folder for the results")
    known = results.load_json(note)
    if not isinstance(known, dict) or {k: v for k, v in known.items() if k != results.SEEN} != plan:
        raise InputError(f"{folder}: holds the results of another run, expected a new folder for the results")


def _plan(source: RecordingSource, name: str) -> dict[str, Any]:
    """What distinguishes one run from another, without paths or times."""
    mark = hashlib.sha256()
    for number, location in source.clips:
        mark.update(f"{number}".encode())
        files = [location] if location.is_file() else sorted(p for p in location.iterdir() if p.is_file())
        for file in files:
            size = file.stat().st_size
            mark.update(f"|{size}".encode())
            with file.open("rb") as stream:
                mark.update(stream.read(ENDS))
                stream.seek(max(0, size - ENDS))
                mark.update(stream.read(ENDS))
    for file in source.camera_files():
        mark.update(file.read_bytes())
    colour = {} if source.channel == GREY else {"channel": source.channel}
    return {"made_by": "tracker track", "detector": name, "clips": len(source), "input": mark.hexdigest()} | colour


def _each(source: RecordingSource, todo: list[int], partial: Path, name: str, workers: int) -> Iterator[Done]:
    """Each clip done, in whatever order; results do not depend on it."""
    return in_parallel(functools.partial(_one, source, partial=partial, name=name), todo, workers, source.path)


def _on_cluster(address: str) -> Callable[..., Iterator[Done]]:
    """The same by the workers of a Dask scheduler; one that is lost has its clips done by others."""
    from synthcam_shared.dask_workers import Cluster  # here alone: Dask is an extra

    cluster = Cluster(address)

    def each(source: RecordingSource, todo: list[int], partial: Path, name: str) -> Iterator[Done]:
        clips = tuple((number, path.resolve()) for number, path in source.clips)
        camera = source.camera.resolve() if source.camera is not None else None
        everywhere = replace(source, path=source.path.resolve(), clips=clips, camera=camera)
        for index, said in cluster.each(
            todo, functools.partial(_track_as_text, everywhere, partial=partial, name=name)
        ):
            if not said.startswith("["):
                raise InputError(f"{clips[index][1]}: {said}")
            frames, notes = json.loads(said)
            yield frames, tuple(notes)

    return each


def _track_as_text(source: RecordingSource, index: int, partial: Path, name: str) -> str:
    """`_one`, as text; a clip that a lost worker had finished is done."""
    if results.is_done(partial, source.clips[index][0]):
        return json.dumps([0, []])
    return json.dumps(_one(source, index, partial, name))


def _one(source: RecordingSource, index: int, partial: Path, name: str) -> Done:
    alone()
    clip = source.open_clip(index)
    try:
        result = track_and_measure(clip, name)
    except (MemoryError, cv2.error) as error:
        if isinstance(error, cv2.error) and error.code != cv2.Error.StsNoMem:
            raise
        asked = " x ".join(map(str, clip.frames.shape))
        raise InputError(f"{source.clips[index][1]}: not enough memory for its {asked} pixels") from None
    results.write_clip(partial, result.number, result.found, result.motion, result.rows, result.camera)
    return result.frames, result.notes
