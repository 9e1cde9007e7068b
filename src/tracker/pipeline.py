"""Clips through the whole chain, in parallel, resumable: read, detect, link, measure, write."""

from __future__ import annotations

import functools
import hashlib
import json
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import pandas as pd

from synthcam_shared.errors import InputError
from synthcam_shared.jobs import Progress, run_all_jobs, use_one_thread
from synthcam_shared.outputs import check_utf8, check_writable, resume_folder
from synthcam_shared.steps import showing_steps
from tracker import results
from tracker.camera.camera_notes import describe_camera_gaps
from tracker.camera.frames import GREY, Frames
from tracker.camera.readers.labelled_array import is_zarr
from tracker.camera.recordings import HelperProcesses, Recording, RecordingSource, digest_films, open_source
from tracker.detection.choose import SelectedDetector, select_channel, select_detector
from tracker.detection.detect import DEFAULT, detector_name, load_detector, load_linker
from tracker.detection.own_detector import digest_detector, is_outside_detector
from tracker.edits import EditsSource, TrackEdits
from tracker.notes import Note, NoteKind, make_notes
from tracker.recording import Result, check_edits, measure_tracks, track_and_measure
from tracker.report.refusals import (
    MISFITS,
    REFUSALS,
    NotedPicture,
    draw_misfit,
    draw_refusals,
    is_misfit_clip,
    is_refused_clip,
)
from tracker.settings import SettingsSource, TrackerSettings
from tracker.tables.read import read_tracks
from tracker.tables.table_options import DEFAULT_TABLE_OPTIONS, TableOptions


@dataclass(frozen=True)
class ClipOutcome:
    """The result of a run over many clips."""

    estimates: pd.DataFrame
    clips: int
    fresh: int  # clips done in this run
    frames: int  # tracked in this run
    notes: dict[Note, int] = field(default_factory=dict)  # number of clips by note
    source: RecordingSource | None = None  # the films


def run(
    source: Path | RecordingSource,
    output: Path,
    detector: str | None,
    workers: int,
    progress: Progress = lambda done, of: None,
    scheduler: str = "",
    settings: SettingsSource | None = None,
    edits: EditsSource | None = None,
) -> ClipOutcome:
    """Run the whole chain on every clip of a source into RESULTS; continue what an interrupted run left.

    source: a dataset, clip, stack, video or folder of pictures.
    output: RESULTS.
    detector: if None, the first clip decides, as it does on the channel of a source that has none; if the first clip is
    in grey, each clip in colour decides on its own channel. A clip in which its detector fails may take another.
    workers: processes, or 0 for one a core, if so many are quicker.
    progress: takes clips done and clips in all, or frames of a single clip.
    scheduler: address of a Dask scheduler, whose workers see the same folders.
    edits: corrections of tracks by hand.

    Raises InputError.
    """
    check_utf8(output)
    chosen, edited = TrackerSettings.of(settings), TrackEdits.of(edits)
    if detector is not None:
        load_detector(detector)
    films = open_source(source) if isinstance(source, Path) else source
    edited.check_clips([number for number, _ in films.clips])
    output = output.resolve()
    if films.path.resolve() in output.parents:
        raise InputError(f"{output}: lies in {films.path}, expected a folder outside it")
    if not output.exists():
        check_writable(output)
    films, first, said = _open_first_clip(films)
    if detector is not None:
        load_linker(detector, first.camera)
    edited.check_frames(first.number, first.frames.numbers)
    clips, frames, notes = len(films), 0, Counter[Note]()
    with showing_steps("frames", progress) if clips == 1 else nullcontext():
        selected = select_detector(first) if detector is None else None
    # A film that is open is not decoded again; of one clip, progress counts the frames.
    helpers = HelperProcesses(films, 0, workers, first.frames.contents)
    opened = replace(first, progress=progress, helpers=helpers) if clips == 1 and not scheduler else None

    def track(partial: Path, todo: list[int]) -> None:
        nonlocal frames
        notes.update(dict.fromkeys(said, clips))
        if opened is None:
            progress(clips - len(todo), clips)
        # An edit that fits no track ends the run before the clips without edits are tracked.
        todo = sorted(todo, key=lambda i: not edited.of_clip(films.clips[i][0]))
        sent = _resolve_paths(films) if scheduler else films  # whose workers run in another folder
        job = functools.partial(_track_clip, sent, partial=partial, name=detector, selected=selected)
        work = functools.partial(job, settings=chosen, edits=edited, opened=opened)
        for done, (more, new) in enumerate(run_all_jobs(work, todo, workers, films.path, scheduler), 1):
            frames += more
            notes.update(new)
            if opened is None:
                progress(clips - len(todo) + done, clips)

    plan = _plan(films, detector, selected) | (edited.to_keys() if edited.edits else {})
    table, fresh = _fill_results(output, plan, chosen, [number for number, _ in films.clips], track)
    return ClipOutcome(table, clips, fresh, frames, dict(notes), films)


def _open_first_clip(films: RecordingSource) -> tuple[RecordingSource, Recording, list[Note]]:
    """Open the first clip: the source with the channel that it chooses, if it is in colour, the clip, and notes."""
    first, why, channel = films.open_clip(0), "", films.channel
    if channel is None:
        in_colour = first.frames.colours is not None
        first, why = select_channel(first, None)
        channel = first.channel if in_colour else None  # of a first clip in grey: each clip in colour chooses
    notes = make_notes(NoteKind.CHANNEL, [why])
    if films.camera is None and (films.path.is_file() or is_zarr(films.path)):
        texts = [f"camera: {file}; --camera takes another" for file in films.camera_files()]
        notes += make_notes(NoteKind.ASSUMED, texts)
    return replace(films, channel=channel), first, notes


def _resolve_paths(films: RecordingSource) -> RecordingSource:
    clips = tuple((number, path.resolve()) for number, path in films.clips)
    camera = films.camera.resolve() if films.camera is not None else None
    return replace(films, path=films.path.resolve(), clips=clips, camera=camera)


def measure_tables(
    path: Path,
    output: Path,
    camera: Path,
    options: TableOptions = DEFAULT_TABLE_OPTIONS,
    settings: SettingsSource | None = None,
    edits: EditsSource | None = None,
    progress: Progress = lambda done, of: None,
) -> ClipOutcome:
    """Measure tracks that any program made into RESULTS, as `run` does its own. Raises InputError.

    path: CSV or Parquet with clip, frame, particle, x, y, or a file of another program.
    output: RESULTS.
    camera: the camera file of the tracks.
    edits: corrections by hand of the tracks as they are written without edits.
    progress: takes clips done and clips in all, or contacts of a single clip of a crowd.
    """
    check_utf8(output)
    chosen, edited = TrackerSettings.of(settings), TrackEdits.of(edits)
    given = read_tracks(path, camera, options)
    asked = f"{options.point}{options.columns}{options.unit}{options.decimal}".encode()
    digest = hashlib.sha256(path.read_bytes() + camera.read_bytes() + asked).hexdigest()
    numbers, notes = sorted(given.clips), dict[Note, int]()
    edited.check_clips(numbers)

    def measure(partial: Path, todo: list[int]) -> None:
        check_edits(given, options.point, edited)
        said = (*given.notes, *describe_camera_gaps(given.camera))
        notes.update({note: len(numbers) for note in said if note.kind is not NoteKind.ASSUMED})
        for done, number in enumerate(numbers[i] for i in todo):
            progress(len(numbers) - len(todo) + done, len(numbers))
            tracks, striker = given.clips[number]
            own = replace(given.camera, striker=striker or given.camera.striker)
            with showing_steps("contacts", progress) if len(numbers) == 1 else nullcontext():
                result = measure_tracks(tracks, own, number, options.point, chosen.fit, edited)
            of_clip = [note for note in result.notes if note.kind in (NoteKind.REPAIR, NoteKind.EDIT)]
            notes.update({replace(note, text=f"clip {number}: {note}"): 1 for note in of_clip})
            pictures = dict[str, bytes]()
            if drawn := _draw_misfit(result, len(numbers)):
                pictures[MISFITS] = drawn.png
                notes[drawn.note] = notes.get(drawn.note, 0) + 1
            results.write_clip_results(partial, number, result.found, result.motion, result.rows, own, pictures)

    plan = {"made_by": "tracker measure", "input": digest} | (edited.to_keys() if edited.edits else {})
    table, fresh = _fill_results(output.resolve(), plan, chosen, numbers, measure)
    return ClipOutcome(table, len(numbers), fresh, 0, notes)


def _fill_results(
    output: Path,
    plan: dict[str, Any],
    settings: TrackerSettings,
    numbers: list[int],
    make: Callable[[Path, list[int]], None],
) -> tuple[pd.DataFrame, int]:
    """Fill RESULTS, or what the same command left of it, with the clips that it lacks: all estimates, clips made now.

    plan: entries of run.json; make: writes the clips of these indices of `numbers` into a folder.
    """
    if settings.changed():
        plan = plan | {"settings": settings.changed()}
    if output.exists():
        _same_or_refuse(output, plan)
        return results.gather_estimates(output, numbers), 0
    check_writable(output)
    partial = output.with_name(output.name + ".partial")
    if partial.is_dir() and any(partial.iterdir()):
        _same_or_refuse(partial, plan, [number for number in numbers if results.is_clip_done(partial, number)])
    with resume_folder(partial, results.RUN, json.dumps(plan, indent=1) + "\n"):
        todo = [i for i, number in enumerate(numbers) if not results.is_clip_done(partial, number)]
        make(partial, todo)
        return results.finish_results(partial, output, numbers), len(todo)


def _edits_of(edits: list[Any], number: int) -> list[Any]:
    return [edit for edit in edits if isinstance(edit, dict) and edit.get("clip") in (None, number)]


def _same_or_refuse(folder: Path, plan: dict[str, Any], done: Sequence[int] | None = None) -> None:
    """An output folder may hold the same run, whole or in part, and nothing else.

    done: the clips that are finished; edits of the others may differ. None: all are.
    """
    note = folder / results.RUN
    if not folder.is_dir() or not note.is_file():
        raise InputError(f"{folder}: exists and holds something else, expected a new folder for the results")
    found, later = results.load_json(note), (results.EXPOSURE_SEEN_KEY, results.OTHER_DETECTORS_KEY)
    known = {k: v for k, v in found.items() if k not in later} if isinstance(found, dict) else {}
    if known == plan:
        return
    if done is not None and {**known, "edits": None} == {**plan, "edits": None}:
        was, now = (run["edits"] if isinstance(run.get("edits"), list) else [] for run in (known, plan))
        if all(_edits_of(was, number) == _edits_of(now, number) for number in done):
            return
    names = [name for name in sorted({*known, *plan}) if known.get(name) != plan.get(name)]
    told = {k: f"{k} {known.get(k)} instead of {plan.get(k)}" for k in ("detector", "clips", "made_by")}
    differs = ", ".join(told.get(name, name) for name in names)
    if folder.suffix == ".partial":
        advice = "remove it, or repeat the interrupted command, which then continues"
        raise InputError(f"{folder}: left by an interrupted run of other options or files ({differs}); {advice}")
    raise InputError(f"{folder}: holds the results of another run ({differs}), expected a new folder for the results")


def _plan(source: RecordingSource, detector: str | None, selected: SelectedDetector | None) -> dict[str, Any]:
    """The entries of run.json that distinguish one run from another, without paths or times."""
    name = detector or (selected.name if selected else DEFAULT)
    colour = {} if source.channel in (None, GREY) else {"channel": source.channel}
    film = {"film": source.options.changed()} if source.options.changed() else {}
    own = {"detector_file": digest_detector(name)} if is_outside_detector(name) else {}
    run = {"made_by": "tracker track", "detector": detector_name(name), "clips": len(source)}
    return run | {"input": digest_films(source)} | colour | film | own


def _track_clip(
    source: RecordingSource,
    index: int,
    partial: Path,
    name: str | None,
    selected: SelectedDetector | None,
    settings: TrackerSettings,
    edits: TrackEdits,
    opened: Recording | None = None,
) -> tuple[int, tuple[Note, ...]]:
    """Track one clip in a worker: its number of frames, and notes. A clip that a lost worker had finished is done."""
    number, path = source.clips[index]
    if results.is_clip_done(partial, number):
        return 0, ()
    use_one_thread()
    clip, why = opened or source.open_clip(index), ""
    if source.channel is None:
        clip, why = select_channel(clip, None)
    try:
        with nullcontext() if clip.progress is None else showing_steps("frames", clip.progress):
            result = track_and_measure(clip, name, settings, edits, selected)
    except (MemoryError, cv2.error) as error:
        if isinstance(error, cv2.error) and error.code != cv2.Error.StsNoMem:
            raise
        asked = " x ".join(map(str, clip.frames.shape))
        raise InputError(f"{path}: not enough memory for its {asked} pixels") from None
    files, notes = dict[str, bytes](), (*make_notes(NoteKind.CHANNEL, [why], number), *result.notes)
    if is_refused_clip(result.found, result.rows, in_pieces=result.in_pieces):
        refusals = draw_refusals(clip, result.found, result.detected)
        files, notes = {REFUSALS: refusals.png}, (*notes, refusals.note)
    elif drawn := _draw_misfit(result, len(source), clip.frames):
        files, notes = {MISFITS: drawn.png}, (*notes, drawn.note)
    if selected is not None and result.detector != selected.name:
        files[results.OTHER_DETECTOR] = json.dumps(result.detector).encode() + b"\n"
    results.write_clip_results(partial, number, result.found, result.motion, result.rows, result.camera, files)
    return result.frames, notes


def _draw_misfit(result: Result, clips: int, frames: Frames | None = None) -> NotedPicture | None:
    """The picture of a clip whose collisions are all misfits; of one among several, the note is the same for all."""
    if not is_misfit_clip(result.rows):
        return None
    drawn = draw_misfit(result.found, result.camera, result.rows, result.number, frames)
    if drawn is None or clips == 1:
        return drawn
    text = f"{MISFITS} beside the tracks of a misfit shows them with its residuals"
    return replace(drawn, note=replace(drawn.note, text=text))
