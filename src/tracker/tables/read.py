"""Tracks from a file, whose format its content shows, or from a table in memory."""

import importlib
import math
import pkgutil
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial import KDTree

from synthcam_shared.errors import InputError
from synthcam_shared.settings import did_you_mean
from tracker.camera.camera import Camera, CameraSource
from tracker.camera.camera_json import read_source
from tracker.camera.camera_keys import format_wrong_value
from tracker.detection.link import Tracks
from tracker.notes import Note, NoteKind, make_notes
from tracker.tables import formats as format_files
from tracker.tables.column_names import read_named_columns
from tracker.tables.content import FileContent
from tracker.tables.rows import REQUIRED_COLUMNS, check_columns, split_tracks, to_numbers
from tracker.tables.table import LENGTH_UNITS, TrackTable, frames_from_times, parse_unit
from tracker.tables.table_options import DEFAULT_TABLE_OPTIONS, TableOptions
from tracker.tables.unit_check import check_unit, find_common_frames

NO_STRIKER = (
    "no column striker, so that ball {} counts as the striker of every clip; if the balls change roles, add a column"
    " striker (a or b, the same in all rows of a clip): without it no effect of one ball alone can be found"
)


@dataclass(frozen=True)
class ClipTracks:
    """Tracks of a table by clip, px, with the striker if the table names it; the camera; notes."""

    clips: dict[int, tuple[Tracks, str | None]]
    camera: Camera
    notes: tuple[Note, ...] = ()


def list_table_formats() -> dict[str, Any]:
    """List the formats of tables that can be read, as modules by name."""
    names = sorted(info.name for info in pkgutil.iter_modules(format_files.__path__))
    return {name: importlib.import_module(f"{format_files.__name__}.{name}") for name in names}


def read_tracks(path: Path, camera: CameraSource, options: TableOptions = DEFAULT_TABLE_OPTIONS) -> ClipTracks:
    """Read the tracks of a file in any format. Raises InputError.

    path: CSV or Parquet with frame, particle, x, y, or a file of one of the formats; camera: of the tracks.
    """
    content = FileContent.of(path, options.decimal)
    if content.archive == "zip" and not content.is_excel:
        if path.suffix.lower() in (".xlsx", ".xlsm", ".ods"):
            raise content.wrong("not a workbook that can be read, expected a table of tracks; save it as CSV")
        raise content.wrong("an archive, expected a table of tracks in it; unpack it first")
    if options.columns:
        named = content.is_binary or content.has_header
        rows = content.cells(names=None if named else [f"{k}" for k in range(1, len(content.head[0]) + 1)])
        table = _pick_columns(rows, options.columns, content.where, content.notes)
    else:
        table = recognise_format(content)
    return to_pixels(table, path.name, camera, options.unit, str(path))


def recognise_format(content: FileContent) -> TrackTable:
    """Read a table of tracks in the format that its content shows; an empty file has no rows. Raises InputError."""
    every = list_table_formats().values()
    if not content.is_binary and not content.text.strip():
        note = f"{Path(content.where).name}: an empty file, a result without a detection"
        return TrackTable(pd.DataFrame(columns=list(REQUIRED_COLUMNS), dtype=float), notes=(note,))
    for one in every:
        table: TrackTable | None = one.read(content) if hasattr(one, "read") else None
        if table is not None:
            return replace(table, notes=(*content.notes, *table.notes)).number_names(Path(content.where).name)
    if content.text[:100].lstrip().startswith("{"):
        raise content.wrong("JSON, expected a table of tracks; camera.json belongs behind --camera")
    if content.root is not None:
        known = ", ".join(sorted(one.NAME for one in every if getattr(one, "FROM_XML", False)))
        raise content.wrong(f"XML of <{format_wrong_value(content.root.tag, quoted=False)}>, expected one of {known}")
    more = ", or those of another program (docs/format.md); --columns x=NAME,y=NAME,... names or counts others"
    check_columns(content.cells(), content.where, more)
    raise AssertionError("a table with these columns is trackpy's")


def _pick_columns(rows: pd.DataFrame, columns: str, where: str, notes: Iterable[str] = ()) -> TrackTable:
    """A table whose columns the user names."""
    pairs = dict(part.partition("=")[::2] for part in columns.split(","))
    optional = "t clip striker x_std y_std cov_xy ep".split()
    known = {name: name for name in (*REQUIRED_COLUMNS, "track", *optional)}
    for key, name in pairs.items():
        if key not in known or not name:
            hint = did_you_mean(key, known, written=known)
            raise InputError(f"--columns: {format_wrong_value(key)}: expected NAME=COLUMN of {', '.join(known)}{hint}")
    for key, name in pairs.items():  # the number of a column, from 1, where none has the name
        if name not in rows and name.isdigit() and 0 < int(name) <= rows.shape[1]:
            pairs[key] = str(rows.columns[int(name) - 1])
    if missing := [name for name in pairs.values() if name not in rows]:
        there = format_wrong_value(", ".join(map(str, rows.columns)), quoted=False)
        raise InputError(f"{where}: no column {', '.join(missing)}, as --columns says; found {there}")
    rows = pd.DataFrame({key: rows[name] for key, name in pairs.items()}).rename(columns={"track": "particle"})
    fps = math.nan
    if "t" in rows:
        frame, time, fps = frames_from_times(to_numbers(rows.pop("t"), "t", where), where)
        rows = rows.assign(t_s=time) if "frame" in rows else rows.assign(t_s=time, frame=frame)
    check_columns(rows, f"{where}, by --columns")
    if "ep" in rows and "x_std" not in rows:
        rows = rows.assign(x_std=rows["ep"], y_std=rows["ep"])
    return TrackTable(rows, fps=fps, notes=tuple(notes)).number_names(Path(where).name)


def read_frame(tracks: pd.DataFrame, camera: CameraSource, options: TableOptions = DEFAULT_TABLE_OPTIONS) -> ClipTracks:
    """Read a table in memory as `read_tracks` does a file. Raises InputError."""
    where = "tracks"
    levels = [name for name in tracks.index.names if name is not None and name not in tracks]
    rows = tracks.reset_index(levels) if levels else tracks.reset_index(drop=True)
    rows = rows.set_axis([str(name) for name in rows.columns], axis=1)
    table = _pick_columns(rows, options.columns, where) if options.columns else read_named_columns(rows, where)
    if table is None:
        check_columns(rows, where, "; --columns x=NAME,y=NAME,... names others")
        raise AssertionError("a table with these columns is read by their names")
    return to_pixels(table.number_names(where), where, camera, options.unit)


def to_pixels(table: TrackTable, name: str, camera: CameraSource, unit: str = "", where: str = "") -> ClipTracks:
    """Convert a table that was read, in any unit, to tracks in px. where: its name in messages; name: in notes."""
    where = where or name
    table = table.leave_out_unassigned(name, where)
    notes = list(table.notes)
    given = parse_unit(unit, "--unit") if unit else table.find_unit(where)
    used = given or ("m" if table.up else "px")
    if table.format:
        notes.append(f"{name}: read as {table.format}, lengths in {used}{'' if given else '; --unit if not so'}")
    metre = LENGTH_UNITS[used][0]
    metric = math.isfinite(metre)
    up = table.up or (metric and not table.format)
    keys = {} if isinstance(camera, Camera) else read_source(camera)
    if isinstance(camera, Camera):
        known = camera
    else:
        if metric and len(table.rows) and isinstance(keys, Mapping):
            keys = _fit_picture(keys, table.scale_lengths(metre, where).rows, where)
        known = Camera.from_dict(keys, f"{camera}" if isinstance(camera, str | Path) else "camera")
    # 29.97 counts as 30
    if abs(table.fps / known.fps - 1) <= 0.01:
        table = replace(table, rows=table.rows.drop(columns="t_s", errors="ignore"))
    elif table.fps > 0:
        whose = "its times are used" if "t_s" in table.rows else "the camera file's is used"
        notes.append(f"fps: {known.fps:g} in the camera file, {table.fps:.4g} in {name}; {whose}")
    elif not abs((rate := _measure_rate(table.rows)) / known.fps - 1) <= 0.01 and math.isfinite(rate):
        notes.append(f"fps: {known.fps:g} in the camera file, {rate:.4g} by t_s in {name}; its times are used")
    factor = (metre if metric else known.scale) / (1.0 if up else known.scale)
    rows = (table.scale_lengths(factor, where) if up or metric else table).rows
    clips = split_tracks(rows, where, metric or up)
    if up:
        clips = {number: (_project(tracks, known), striker) for number, (tracks, striker) in clips.items()}
    if not given:
        notes += check_unit([tracks for tracks, _ in clips.values()], known, where)
    notes += [text for n, (tracks, _) in clips.items() if (text := _describe_overlaps(tracks, known, f"clip {n}"))]
    said = make_notes(NoteKind.TABLE, notes)
    if len(clips) > 1 and "striker" not in table.rows and "striker" not in keys:
        clips, note = _infer_strikers(clips, table.balls, known.striker)
        said.append(replace(note, text=f"{name}: {note}"))
    return ClipTracks(clips, known, tuple(said))


def _infer_strikers(
    clips: dict[int, tuple[Tracks, str | None]], balls: tuple[str, ...], default: str
) -> tuple[dict[int, tuple[Tracks, str | None]], Note]:
    """The clips with their strikers where two names of balls and their motion say them; and a note.

    Numbers say nothing, since programs number balls again in each clip.
    """
    movers = {number: find_first_mover(tracks) for number, (tracks, _) in clips.items()}
    particles = sorted({int(p) for tracks, _ in clips.values() for p in np.unique(tracks.particle)})
    counts = Counter(movers.values())
    if len(balls) == 2 and None not in counts:
        strikers = {number: "ab"[mover] for number, mover in movers.items() if mover is not None}
        roles = ", ".join(f"{balls[k]} (ball {'ab'[k]}) strikes in {counts[k]} clips" for k in (0, 1))
        text = f"no column striker; by who moves first {roles}"
        return {n: (tracks, strikers[n]) for n, (tracks, _) in clips.items()}, Note(NoteKind.TABLE, text)
    text = NO_STRIKER.format(default)
    roles_change = (
        "particle {} strikes in {} clips and particle {} in {}. If a number is the same ball in all clips, write a and"
        " b in the column particle: it then says who strikes"
    )
    if len(particles) == 2 and all(counts[p] for p in particles):
        one, other = particles
        text += f". {roles_change.format(one, counts[one], other, counts[other])}"
    return clips, Note(NoteKind.STRIKER, text)


def find_first_mover(tracks: Tracks) -> int | None:
    """Find the striker in tracks that were read: the particle that moves before both come nearest, or None."""
    pair = find_common_frames(tracks)
    if pair is None:
        return None
    particles, one, two, _ = pair
    nearest = int(np.argmin(np.hypot(*(one - two).T)))
    moved = [float(np.hypot(*np.ptp(xy[:nearest], axis=0))) for xy in (one, two)] if nearest > 1 else [0.0, 0.0]
    # a ball at rest scatters by its errors alone; two balls that both move leave it open
    least_ratio, least_px = 5.0, 2.0
    certain = max(moved) > least_ratio * min(moved) and max(moved) > least_px
    return int(particles[int(np.argmax(moved))]) if certain else None


def _describe_overlaps(tracks: Tracks, camera: Camera, where: str) -> str:
    """A sentence where many balls lie within one another, as they do in a wrong scale or unit; else empty."""
    min_share = 0.2  # of positions with another ball within 0.8 diameters
    min_particles, frames = 6, 20  # so many frames are looked at
    if not camera.metric or not camera.knows_diameter or len(np.unique(tracks.particle)) < min_particles:
        return ""
    numbers = np.unique(tracks.frame)
    seen = [tracks.xy[tracks.frame == n] for n in numbers[:: -(-len(numbers) // frames)]]
    nearest = [np.asarray(KDTree(xy).query(xy, k=2)[0])[:, 1] for xy in seen if len(xy) > 1]
    share = float(np.mean(np.concatenate(nearest) < 0.8 * camera.diameter_px)) if nearest else 0.0
    if share < min_share:
        return ""
    return (
        f"{where}: balls overlap: {100 * share:.0f} % of positions have another within 0.8 ball_diameter; check scale,"
        " ball_diameter and the unit of x and y (--unit)"
    )


def _fit_picture(given: Mapping[str, Any], metres: pd.DataFrame, where: str) -> Mapping[str, Any]:
    """The keys of camera.json; where they say nothing of a picture, with one in which tracks in metres lie."""
    check_columns(metres, where)
    reach = float(np.nanmax(np.abs([to_numbers(metres[axis], axis, where) for axis in ("x", "y")]), initial=0.0))
    if not 0 < reach < 1e3:
        raise InputError(f"{where}: x, y: up to {reach:g} m, expected positions on a plate; --unit says what they are")
    keys = dict(given)
    if "scale" not in keys and not {"K", "t"} <= set(keys):
        ball = keys.get("ball_diameter", 0)
        known = ball / 15 if isinstance(ball, int | float) and 0 < ball < reach else 0.0
        keys["scale"] = max(known, 2 * reach / 16000)
    scale = keys.get("scale", 0)
    if "size" not in keys and isinstance(scale, int | float) and scale > 0:
        keys["size"] = [min(2 * math.ceil(reach / scale) + 2 * 15, 16000)] * 2
    return keys


def _measure_rate(rows: pd.DataFrame) -> float:
    """Frames a second by the column t_s; NaN without it."""
    if "t_s" not in rows or len(rows) < 2:
        return math.nan
    keys = [name for name in ("clip", "particle") if name in rows]
    steps = rows.sort_values([*keys, "frame"])[["frame", "t_s", *keys]].apply(pd.to_numeric, errors="coerce").diff()
    forward = steps[(steps[keys] == 0).all(axis=1) & (steps["frame"] > 0) & (steps["t_s"] > 0)]
    return float((forward["frame"] / forward["t_s"]).median())


def _project(tracks: Tracks, camera: Camera) -> Tracks:
    """Tracks in metres on the plate, as the camera sees them; its warp corrects them when they are read."""
    camera = replace(camera, warp=None)
    height = np.full((len(tracks), 1), camera.centre_height)
    pixels = camera.project(np.concatenate([tracks.xy, height], axis=1))
    slope = np.linalg.inv(camera.unproject(pixels)[1])
    cov, fixed = (slope @ c @ slope.transpose(0, 2, 1) for c in (tracks.cov, tracks.fixed))
    unseen = np.full(len(tracks), np.nan)
    x, y = pixels[:, 0].copy(), pixels[:, 1].copy()
    return replace(tracks, x=x, y=y, cov=cov, fixed=fixed, glint_x=unseen, glint_y=unseen)
