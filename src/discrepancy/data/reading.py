"""Reads measured collisions: a tracker's results, a table of tracks, or results in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.first_guess import build_collision
from discrepancy.data.launch import V0, equalise_launches
from discrepancy.data.notes import SearchNote, SearchNoteKind, sort_notes
from discrepancy.data.stretches import cut_crowd
from discrepancy.data.track_checks import detect_wrong_units, find_exchange, note_uneven_times, remove_strays
from discrepancy.policy import SearchPolicy, applied_policy, current_policy
from synthcam_shared.errors import InputError as InputError
from synthcam_shared.jobs import run_all_jobs, yield_in_order
from tracker.camera.camera import Camera, CameraSource
from tracker.detection.link import Tracks
from tracker.measurement.collision.adequacy import MISFIT
from tracker.measurement.estimate import measure
from tracker.measurement.track_repair import repair_tracks
from tracker.notes import Note, NoteKind
from tracker.recording import Result, check_particles
from tracker.results import read_clip
from tracker.settings import FitSettings
from tracker.tables.read import ClipTracks, read_frame, read_tracks
from tracker.tables.rows import split_tracks


def read_collisions(
    measured: Path | pd.DataFrame | Sequence[Result],
    camera: CameraSource | None = None,
    stretches: bool = False,
    workers: int = 1,
) -> tuple[list[MeasuredCollision], list[SearchNote]]:
    """Read the collisions of a tracker's RESULTS, of a table of tracks, or of results in memory.

    With `stretches`, clips of more than two balls are cut into their free stretches; without, they are left out.
    A table needs its camera.json, `camera`; RESULTS contain their own. A note is returned for each clip, or positions
    of a clip, that cannot be used. `workers` processes measure the clips of a table; 0: as many as are quickest.

    Raises
    ------
    InputError
        A file is missing or malformed, no clip has a measured collision, or speeds and units are implausible.
    """
    sources, notes, name = _list_sources(measured, camera)
    kept, rejected, durations = [], [], []
    clips = list(sources)
    cut = [
        stretches and len(np.unique(source.tracks.particle)) > 2 and source.camera.knows_diameter for source in clips
    ]
    whole = {source.number: source for source, is_cut in zip(clips, cut, strict=True) if not is_cut}
    jobs = run_all_jobs(partial(_build_one, whole, current_policy()), list(whole), workers, name)
    built = yield_in_order(jobs, list(whole))
    for source, is_cut in zip(clips, cut, strict=True):
        notes += [
            SearchNote(SearchNoteKind.REPAIRED, source.number, note.frames, {"text": note.text})
            for note in source.repairs
        ]
        if is_cut:
            kept += (crowd := cut_crowd(source.tracks, source.camera, source.number))
            rejected += [False] * len(crowd)
            continue
        outcome, misfit, duration = next(built)
        if isinstance(outcome, SearchNote):
            notes.append(outcome)
            continue
        kept.append(outcome)
        rejected.append(misfit)
        durations.append(duration)
        if source.strays:
            notes.append(SearchNote(SearchNoteKind.STRAYS, source.number, tuple(source.strays)))
    if not kept:
        raise InputError(
            f"{name}: no clip with a measured collision" + "".join(f"; {x}" for x in sort_notes(notes).left_out[:1])
        )
    if (doubtful := np.array([t for t in durations if np.isfinite(t)])).size:
        values = {"count": len(doubtful), "duration_ms": 1e3 * float(np.median(doubtful))}
        notes.append(SearchNote(SearchNoteKind.CONTACTS_MAY_LAST, values=values))
    typical = float(np.median([c.launch[V0] for c in kept]))
    if typical > current_policy().max_launch_speed_m_s:
        raise InputError(f"{name}: the balls move at {typical:.3g} m/s (median); check scale and fps of the camera")
    launches = equalise_launches([c.launch for c in kept], rejected)
    return [replace(c, launch=one) for c, one in zip(kept, launches, strict=True)], notes


def _list_sources(
    measured: Path | pd.DataFrame | Sequence[Result], camera: CameraSource | None
) -> tuple[Iterable[_Source], list[SearchNote], Path]:
    """The clips of what was measured, notes on all of it, and what messages call it. Raises InputError."""
    if isinstance(measured, pd.DataFrame):
        if camera is None:
            raise InputError("camera: expected a camera, its keys or a path, beside a table of tracks")
        given, name = read_frame(measured, camera), Path("tracks")
        return _read_table(name, given), _note_strikers(given), name
    if not isinstance(measured, Path):
        return _read_memory(measured), [], Path("results")
    if measured.is_dir():
        if camera is not None:
            raise InputError(f"--camera: {measured} contains its own; --camera is for a table of tracks")
        return _read_results(measured), [], measured
    if camera is None:
        if not measured.exists():
            raise InputError(f"{measured}: no such file or folder, expected RESULTS of a tracker or a table of tracks")
        raise InputError(f"{measured}: a table of tracks, expected --camera with its camera file")
    given = read_tracks(measured, camera)
    return _read_table(measured, given), _note_strikers(given), measured


@dataclass(frozen=True)
class _Source:
    """A clip before it is measured."""

    number: int
    tracks: Tracks
    camera: Camera
    estimates: Callable[[], list[dict[Any, Any]]]  # gives the tracker's rows
    strays: list[int] = field(default_factory=list)  # frames of removed positions
    repairs: tuple[Note, ...] = ()


def _build_one(
    sources: Mapping[int, _Source], policy: SearchPolicy, number: int
) -> tuple[int, tuple[MeasuredCollision | SearchNote, bool, float]]:
    """One of them with its number, by a policy that another process does not know."""
    with applied_policy(policy):
        return number, _build(sources[number])


def _build(source: _Source) -> tuple[MeasuredCollision | SearchNote, bool, float]:
    """A clip's collision or why there is none; whether the tracker's model is rejected; the contact's duration, s."""
    number, tracks, camera = source.number, source.tracks, source.camera
    if (frame := find_exchange(tracks, camera)) is not None:
        return SearchNote(SearchNoteKind.BALLS_EXCHANGED, number, (frame,)), False, np.nan
    if uneven := note_uneven_times(tracks, camera, number):
        return uneven, False, np.nan
    rows = source.estimates()
    if len(rows) > 1:
        return SearchNote(SearchNoteKind.SEVERAL_COLLISIONS, number, values={"count": len(rows)}), False, np.nan
    outcome = build_collision(tracks, {"clip": number} | rows[0], camera)
    return outcome, rows[0]["status"] == MISFIT, float(rows[0].get("contact_duration_s", np.nan))


def _read_memory(results: Sequence[Result]) -> Iterator[_Source]:
    """Clips as if written and read again, for the same numbers to the last bit. Equal clip numbers are renumbered."""
    expected = "what tracker.track or tracker.measure gives"
    if isinstance(results, Result):
        results = [results]
    if not isinstance(results, Sequence):
        raise InputError(f"results: of type {type(results).__name__}, expected a list of {expected}")
    for k, result in enumerate(results):
        if not isinstance(result, Result):
            raise InputError(f"results: number {k} is of type {type(result).__name__}, expected {expected}")
    own = len({r.number for r in results}) == len(results)
    for k, result in sorted(enumerate(results), key=lambda pair: pair[1].number if own else pair[0]):
        ((_, (tracks, _)),) = split_tracks(result.tracks, f"results: number {k}").items()
        known = Camera.from_dict(result.camera.to_dict())
        number = result.number if own else k
        yield _Source(number, tracks, known, partial(result.estimates.assign(clip=number).to_dict, "records"))


def _read_results(folder: Path) -> Iterator[_Source]:
    path = folder / "estimates.parquet"
    if not path.is_file():
        raise InputError(f"{folder}: expected RESULTS of a tracker (no estimates.parquet)")
    try:
        table = pd.read_parquet(path)
    except (OSError, ValueError) as e:  # pyarrow's are ValueErrors
        raise InputError(f"{path}: cannot be read as Parquet ({str(e).partition(chr(10))[0][:100]})") from None
    needed = "clip striker status t_c v0 b tau1 tau2 particle1 particle2".split()
    missing = [name for name in needed if name not in table]
    if missing:
        raise InputError(f"{path}: no column {', '.join(missing)}")
    for number, rows in table.groupby("clip"):
        clip = int(str(number))
        yield _Source(clip, *read_clip(folder, clip), partial(rows.to_dict, "records"))


def _note_strikers(given: ClipTracks) -> list[SearchNote]:
    unstated = [note for note in given.notes if note.kind is NoteKind.STRIKER]
    return [SearchNote(SearchNoteKind.NO_STRIKER, values={"text": note.text}) for note in unstated]


def _read_table(path: Path, given: ClipTracks) -> Iterator[_Source]:
    base, tables = given.camera, given.clips
    if why := detect_wrong_units((tracks, base) for tracks, _ in tables.values()):
        raise InputError(f"{path}: {why}")
    settings = FitSettings(local_window_s=0)  # a search of a table needs no local estimate
    for number, (tracks, striker) in sorted(tables.items()):
        own = replace(base, striker=striker) if striker is not None else base
        check_particles(tracks, number, settings, "A search needs the two balls of a collision in each clip")
        repaired = repair_tracks(tracks, own, number)
        tracks, strays = remove_strays(repaired.tracks, own)
        yield _Source(number, tracks, own, partial(measure, tracks, own, settings), strays, repaired.notes)
