"""Clips through the whole chain, in parallel, resumable: read, detect, link, measure, write."""

from __future__ import annotations

import functools
import hashlib
import json
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import pandas as pd

from synthcam_shared.errors import InputError
from synthcam_shared.jobs import Progress, run_all_jobs, use_one_thread
from synthcam_shared.outputs import check_writable, resume_folder
from tracker import results
from tracker.camera.camera_notes import describe_camera_gaps
from tracker.camera.frames import GREY
from tracker.camera.recordings import RecordingSource, open_source
from tracker.detection.choose import choose_detector, select_channel
from tracker.detection.detect import load_detector, load_linker
from tracker.notes import Note, NoteKind, note_all
from tracker.recording import measure_tracks, track_and_measure
from tracker.settings import SettingsSource, TrackerSettings
from tracker.tables.read import read_tracks

if TYPE_CHECKING:
    from tracker.report.pages import ResultPages


@dataclass(frozen=True)
class ClipDone:
    """The report of a worker on a clip: its number of frames, and notes."""

    frames: int
    notes: tuple[Note, ...]


@dataclass(frozen=True)
class ClipOutcome:
    """The result of a run over many clips.

    Attributes
    ----------
    estimates : DataFrame
    clips, fresh : int
        Number of clips, and of those done in this run.
    frames : int
        Number of frames tracked in this run.
    notes : dict
        Number of clips by note.
    source : RecordingSource or None
        The films.
    """

    estimates: pd.DataFrame
    clips: int
    fresh: int
    frames: int
    notes: dict[Note, int] = field(default_factory=dict)
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
    settings: SettingsSource | None = None,
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
    settings : TrackerSettings, dict, str or Path, optional

    Returns
    -------
    ClipOutcome

    Raises
    ------
    InputError
    """
    chosen = TrackerSettings.of(settings)
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
    source, said = replace(source, channel=first.channel), note_all(NoteKind.CHANNEL, [why])
    if name is None:
        name, why = choose_detector(first.frames, first.camera)
        said += note_all(NoteKind.DETECTOR, [why])
    plan = _plan(source, name, chosen)
    numbers = [number for number, _ in source.clips]
    if output.exists():
        _same_or_refuse(output, plan)
        return ClipOutcome(results.gather(output, numbers), len(source), 0, 0, source=source)
    frames, notes = 0, Counter[Note]({note: len(source) for note in said})
    with _partial(output, plan) as partial:
        todo = [i for i, number in enumerate(numbers) if not results.is_done(partial, number)]
        progress(len(source) - len(todo), len(source))
        work = functools.partial(
            _track_clip, _resolve_paths(source) if scheduler else source, partial=partial, name=name, settings=chosen
        )
        for done, clip in enumerate(run_all_jobs(work, todo, workers, source.path, scheduler), 1):
            frames += clip.frames
            notes.update(clip.notes)
            progress(len(source) - len(todo) + done, len(source))
        table = results.finish(partial, output, numbers)
    return ClipOutcome(table, len(source), len(todo), frames, dict(notes), source)


def measure_tables(
    path: Path,
    output: Path,
    camera: Path,
    point: str = "centre",
    columns: str = "",
    unit: str = "",
    settings: SettingsSource | None = None,
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
    settings : TrackerSettings, dict, str or Path, optional

    Returns
    -------
    ClipOutcome

    Raises
    ------
    InputError
    """
    chosen = TrackerSettings.of(settings)
    given = read_tracks(path, camera, columns, unit)
    base, tables = given.camera, given.clips
    digest = hashlib.sha256(path.read_bytes() + camera.read_bytes() + f"{point}{columns}{unit}".encode()).hexdigest()
    plan = {"made_by": "tracker measure", "input": digest, **_settings_entry(chosen)}
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
            result = measure_tracks(tracks, own, number, point, chosen)
            results.write_clip(partial, number, result.found, result.motion, result.rows, own)
        table = results.finish(partial, output, numbers)
    said = (*given.notes, *describe_camera_gaps(base))
    notes = {note: len(numbers) for note in said if note.kind is not NoteKind.ASSUMED}
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
    for done, _ in enumerate(run_all_jobs(pages.write, todo, workers, pages.output), 1):
        progress(done, len(todo))
    pages.write_overview(estimates)


@contextmanager
def _partial(output: Path, plan: dict[str, Any]) -> Iterator[Path]:
    """Open the folder in which results are gathered: a new one, or the one that the same command left behind."""
    check_writable(output)
    partial = output.with_name(output.name + ".partial")
    if partial.is_dir() and any(partial.iterdir()):
        _same_or_refuse(partial, plan)
    with resume_folder(partial, results.RUN, json.dumps(plan, indent=1) + "\n"):
        yield partial


def _same_or_refuse(folder: Path, plan: dict[str, Any]) -> None:
    """An output folder may hold the same run, whole or in part, and nothing else."""
    note = folder / results.RUN
    if not folder.is_dir() or not note.is_file():
        raise InputError(f"{folder}: exists and holds something else, expected a new folder for the results")
    known = results.load_json(note)
    if not isinstance(known, dict) or {k: v for k, v in known.items() if k != results.SEEN} != plan:
        raise InputError(f"{folder}: holds the results of another run, expected a new folder for the results")


def _settings_entry(settings: TrackerSettings) -> dict[str, Any]:
    """The entry of run.json for settings that differ from the defaults; none where none does."""
    return {"settings": settings.changed()} if settings.changed() else {}


def _plan(source: RecordingSource, name: str, settings: TrackerSettings) -> dict[str, Any]:
    """The entries of run.json that distinguish one run from another, without paths or times."""
    mark = hashlib.sha256()
    for number, location in source.clips:
        mark.update(f"{number}".encode())
        files = [location] if location.is_file() else sorted(p for p in location.iterdir() if p.is_file())
        for file in files:
            size = file.stat().st_size
            mark.update(f"|{size}".encode())
            with file.open("rb") as stream:
                # 64 KiB at either end of a file distinguish recordings
                mark.update(stream.read(1 << 16))
                stream.seek(max(0, size - (1 << 16)))
                mark.update(stream.read(1 << 16))
    for file in source.camera_files():
        mark.update(file.read_bytes())
    colour = {} if source.channel == GREY else {"channel": source.channel}
    run = {"made_by": "tracker track", "detector": name, "clips": len(source), "input": mark.hexdigest()}
    return run | colour | _settings_entry(settings)


def _track_clip(source: RecordingSource, index: int, partial: Path, name: str, settings: TrackerSettings) -> ClipDone:
    """Track one clip in a worker. A clip that a lost worker had finished is done."""
    number, path = source.clips[index]
    if results.is_done(partial, number):
        return ClipDone(frames=0, notes=())
    use_one_thread()
    clip = source.open_clip(index)
    try:
        result = track_and_measure(clip, name, settings)
    except (MemoryError, cv2.error) as error:
        if isinstance(error, cv2.error) and error.code != cv2.Error.StsNoMem:
            raise
        asked = " x ".join(map(str, clip.frames.shape))
        raise InputError(f"{path}: not enough memory for its {asked} pixels") from None
    results.write_clip(partial, result.number, result.found, result.motion, result.rows, result.camera)
    return ClipDone(frames=result.frames, notes=result.notes)


def _resolve_paths(source: RecordingSource) -> RecordingSource:
    """The same source with absolute paths, for workers that run in another folder."""
    clips = tuple((number, path.resolve()) for number, path in source.clips)
    camera = source.camera.resolve() if source.camera is not None else None
    return replace(source, path=source.path.resolve(), clips=clips, camera=camera)
