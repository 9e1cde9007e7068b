"""The files of RESULTS, written and read, and tables of tracks made by other programs.

Everything is written aside and moved into place, and holds neither times nor paths: the same input gives the
same bytes.
"""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from commandline.errors import InputError
from commandline.outputs import put
from tracker.camera.camera import Camera
from tracker.camera.camera_keys import read_json, shown
from tracker.detection.link import Tracks

RUN = "run.json"
SEEN = "exposure_seen_s"  # of clips whose motion blur is not as long as the camera file's exposure makes it
MOST = (1 << 31) - 1  # frames, particles, clips
MOST_BYTES = 1 << 30  # of a JSON file
FARTHEST = 1e6  # px, of a position, or of its standard deviation
NEEDED = ("frame", "particle", "x", "y")


def clip_folder(results: Path, number: int) -> Path:
    """Where a clip's results lie."""
    return results / "clips" / f"{number:06d}"


def is_done(results: Path, number: int) -> bool:
    """Whether a clip's results are there, whole."""
    return clip_folder(results, number).is_dir()


def write_clip(
    results: Path,
    number: int,
    tracks: Tracks,
    motion: pd.DataFrame,
    rows: Sequence[Mapping[str, Any]],
    camera: Camera,
) -> None:
    """Writes one clip's folder aside and moves it into place."""
    final = clip_folder(results, number)
    aside = final.with_suffix(".tmp")
    shutil.rmtree(aside, ignore_errors=True)
    aside.mkdir(parents=True)
    table = tracks_table(tracks)
    columns = {name: pa.array(motion[name].to_numpy(), from_pandas=True) for name in motion.columns}
    try:
        _write_parquet(aside / "tracks.parquet", table)
        with BytesIO() as text:
            pyarrow.csv.write_csv(table, text, pyarrow.csv.WriteOptions(quoting_style="needed"))
            put(aside / "tracks.csv", text.getvalue())
        _write_parquet(aside / "motion.parquet", pa.table(columns))
        write_json(aside / "estimates.json", list(rows))
        write_json(aside / "camera.json", camera.to_dict())
        os.replace(aside, final)
    except BaseException:
        shutil.rmtree(aside, ignore_errors=True)
        raise


def finish(partial: Path, final: Path, numbers: Iterable[int]) -> pd.DataFrame:
    """Gathers the clips' estimates, fits them together, and moves the whole into place. Returns the estimates."""
    from tracker.measurement.estimate import fit_all

    order = sorted(numbers)
    table = gather(partial, order)
    _write_parquet(partial / "estimates.parquet", _plain(table))
    write_json(partial / "fit.json", fit_all(table))
    _note_exposures(partial, order)
    put(partial / "camera.json", (clip_folder(partial, order[0]) / "camera.json").read_bytes())
    os.replace(partial, final)
    return table


def _note_exposures(results: Path, numbers: Sequence[int]) -> None:
    """Adds to run.json the clips' exposures that are not the camera file's, s by clip."""
    cameras = {n: load_json(clip_folder(results, n) / "camera.json") for n in numbers}
    seen = {n: camera[SEEN] for n, camera in cameras.items() if SEEN in camera}
    if seen:
        note = results / RUN
        write_json(note, load_json(note) | {SEEN: seen})


def gather(results: Path, numbers: Iterable[int]) -> pd.DataFrame:
    """All clips' estimates, one row a collision, ``clip`` first."""
    rows = []
    for number in numbers:
        path = clip_folder(results, number) / "estimates.json"
        found = load_json(path)
        if not isinstance(found, list) or not all(isinstance(row, dict) and "status" in row for row in found):
            raise InputError(f"{path}: damaged, expected a list of estimates; remove {results} to start anew")
        rows += [{"clip": number, **row} for row in found]
    return estimates_table(rows)


def estimates_table(rows: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Estimates as the columns of estimates.parquet, one row a collision; None of JSON stands for NaN."""
    table = pd.DataFrame([finite(row) for row in rows])
    for name in table.columns:
        if table[name].dtype == object and name not in ("cov", "status", "striker", "noise", "flags"):
            table[name] = table[name].astype(float)
    return table


def load_json(path: Path) -> Any:
    """A file of RESULTS. Raises InputError where it is missing or damaged."""
    try:
        return read_json(path, MOST_BYTES)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; expected a file of results") from None
    except ValueError as error:
        raise InputError(f"{path}: damaged, expected JSON ({error})") from None


def tracks_table(tracks: Tracks) -> pa.Table:
    """The columns of tracks.parquet."""
    times = {"t_s": tracks.time} if np.isfinite(tracks.time).any() else {}
    return pa.table(
        {
            "frame": tracks.frame,
            "particle": tracks.particle,
            "x": tracks.x,
            "y": tracks.y,
            "x_std": np.sqrt(tracks.cov[:, 0, 0]),
            "y_std": np.sqrt(tracks.cov[:, 1, 1]),
            "cov_xy": np.ascontiguousarray(tracks.cov[:, 0, 1]),
            "flux": tracks.flux,
            "flags": pa.array(tracks.flags.tolist(), pa.string()),
            "glint_x": tracks.glint_x,
            "glint_y": tracks.glint_y,
            "x_fixed_std": np.sqrt(tracks.fixed[:, 0, 0]),
            "y_fixed_std": np.sqrt(tracks.fixed[:, 1, 1]),
            "cov_xy_fixed": np.ascontiguousarray(tracks.fixed[:, 0, 1]),
            **times,
        }
    )


def write_json(path: Path, value: Any) -> None:
    """JSON with null for what is not finite."""
    put(path, json.dumps(finite(value), indent=1, sort_keys=False) + "\n")


def _write_parquet(path: Path, table: pa.Table) -> None:
    with BytesIO() as stream:
        pyarrow.parquet.write_table(table, stream)
        put(path, stream.getvalue())


def finite(value: Any) -> Any:
    """Plain values as JSON gives them back: None for what is not finite."""
    if isinstance(value, Mapping):
        return {str(k): finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [finite(v) for v in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def _plain(table: pd.DataFrame) -> pa.Table:
    """Without pandas' own metadata, which names the versions of libraries."""
    return pa.Table.from_pandas(table, preserve_index=False).replace_schema_metadata(None)


def read_clip(results: Path, number: int) -> tuple[Tracks, Camera]:
    """Tracks and camera of one clip of RESULTS."""
    folder = clip_folder(results, number)
    own = folder / "camera.json"
    camera = Camera.read(own if own.is_file() else results / "camera.json")
    table = _load(folder / "tracks.parquet")
    return _to_tracks(table, str(folder / "tracks.parquet")), camera


def read_tracks(path: Path) -> dict[int, tuple[Tracks, str | None]]:
    """Tracks by clip, with the clip's striker where the table says it; InputError for what is no such table.

    CSV or Parquet with frame, particle, x, y in px; clip (0 if missing), striker, x_std, y_std, cov_xy may be
    there. Rows without a finite position are left out.
    """
    return split_tracks(_load(path), str(path))


def split_tracks(table: pd.DataFrame, where: str) -> dict[int, tuple[Tracks, str | None]]:
    """`read_tracks` of a table in memory. where: what messages call it."""
    _check_columns(table, where)
    if len(table) == 0:
        raise InputError(f"{where}: no rows, expected a row for each ball and frame")
    clips = table["clip"] if "clip" in table else pd.Series(0, index=table.index)
    out: dict[int, tuple[Tracks, str | None]] = {}
    numbers = _whole(clips, "clip", where)
    for number in np.unique(numbers).tolist():
        part = table[numbers == number]
        striker = None
        if "striker" in part:
            names = part["striker"].unique().tolist()
            if len(names) != 1 or names[0] not in ("a", "b"):
                raise InputError(f"{where}: striker: clip {number} has {names}, expected one of a, b")
            striker = str(names[0])
        tracks = _to_tracks(part, where)
        span = max(np.ptp(tracks.x), np.ptp(tracks.y)) if len(np.unique(tracks.particle)) > 1 else math.inf
        if span < 1:
            raise InputError(f"{where}: x, y: expected pixels, not metres: all balls lie within {span:.2g} px")
        out[number] = (tracks, striker)
    return out


def _load(path: Path) -> pd.DataFrame:
    if not path.is_file():
        what = "a folder" if path.is_dir() else "no such file"
        raise InputError(f"{path}: {what}, expected a table of tracks (CSV or Parquet)")
    if path.suffix.lower() in (".xlsx", ".xls", ".ods"):
        raise InputError(f"{path}: a spreadsheet, expected a table of tracks; save it as CSV")
    try:
        table = pd.read_parquet(path) if path.suffix.lower() in (".parquet", ".pq") else pd.read_csv(path)
    except Exception as error:  # readers raise their own kinds
        reason = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise InputError(f"{path}: cannot be read as a table of tracks ({reason})") from None
    _check_columns(table, str(path))
    return table


def _check_columns(table: pd.DataFrame, where: str) -> None:
    missing = [name for name in NEEDED if name not in table]
    if missing:
        there = ", ".join(map(str, table.columns))
        commas = " with commas between them" if ";" in there or "\t" in there else ""
        there = shown(there, quoted=False)
        raise InputError(
            f"{where}: no column {', '.join(missing)}, expected {', '.join(NEEDED)}{commas}; found {there}"
        )


def _to_tracks(table: pd.DataFrame, where: str) -> Tracks:
    frame, particle = _whole(table["frame"], "frame", where), _whole(table["particle"], "particle", where)
    x, y = _real(table["x"], "x", where), _real(table["y"], "y", where)
    for name, values in (("x", x), ("y", y)):
        if np.any(np.abs(values) > FARTHEST):
            raise InputError(f"{where}: {name}: expected positions in px, not {values[np.abs(values) > FARTHEST][0]:g}")
    kept = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    kept = kept[np.lexsort((frame[kept], particle[kept]))]
    twice = (np.diff(frame[kept]) == 0) & (np.diff(particle[kept]) == 0)
    if twice.any():
        row = kept[np.flatnonzero(twice)[0]]
        raise InputError(f"{where}: particle {particle[row]} is twice in frame {frame[row]}, expected once")

    def column(name: str, default: float) -> Any:
        values = _real(table[name], name, where) if name in table else np.full(len(table), default)
        return values[kept]

    def covariance(x_std: str, y_std: str, cov_xy: str, default: float) -> Any:
        cov = np.empty((len(kept), 2, 2))
        for axis, name in enumerate((x_std, y_std)):
            std = column(name, default)
            if np.any((std < 0) | (std > FARTHEST)):
                raise InputError(f"{where}: {name}: expected standard errors from 0 to {FARTHEST:g} px")
            cov[:, axis, axis] = std**2
        cov[:, 0, 1] = cov[:, 1, 0] = column(cov_xy, 0.0)
        if np.any(np.abs(cov[:, 0, 1]) > FARTHEST**2):
            raise InputError(f"{where}: {cov_xy}: expected covariances from {-(FARTHEST**2):g} to {FARTHEST**2:g} px^2")
        return cov

    said = table["flags"].astype(object).fillna("") if "flags" in table else pd.Series("", index=table.index)
    return Tracks(
        frame=frame[kept],
        particle=particle[kept],
        x=x[kept],
        y=y[kept],
        cov=covariance("x_std", "y_std", "cov_xy", math.nan),
        flux=column("flux", math.nan),
        flags=said.astype(str).to_numpy()[kept].astype(np.str_),
        glint_x=column("glint_x", math.nan),
        glint_y=column("glint_y", math.nan),
        fixed=covariance("x_fixed_std", "y_fixed_std", "cov_xy_fixed", 0.0),
        time=_times(column("t_s", math.nan), frame[kept], particle[kept], where),
    )


def _times(time: Any, frame: Any, particle: Any, where: str) -> Any:
    """Times that a table gives; InputError where they do not grow with the frames of a particle."""
    ball = np.diff(particle) == 0
    back = ball & ~(np.diff(time) > 0)
    if np.isfinite(time).any() and (back.any() or not np.isfinite(time).all()):
        row = int(np.flatnonzero(back)[0]) + 1 if back.any() else int(np.flatnonzero(~np.isfinite(time))[0])
        raise InputError(
            f"{where}: t_s: {time[row]:g} in frame {frame[row]} of particle {particle[row]}, expected times that grow"
        )
    return time


def _real(values: Any, name: str, where: str) -> Any:
    try:
        return pd.to_numeric(values).to_numpy(dtype=np.float64)
    except (ValueError, TypeError):
        raise InputError(f"{where}: {name}: expected numbers") from None


def _whole(values: Any, name: str, where: str) -> Any:
    numbers = _real(values, name, where)
    wrong = ~((numbers >= 0) & (numbers <= MOST) & (numbers == np.round(numbers)))  # NaN too
    if wrong.any():
        raise InputError(f"{where}: {name}: expected whole numbers from 0 to {MOST}, not {numbers[wrong][0]:g}")
    return numbers.astype(np.int64)


def to_centres(tracks: Tracks, camera: Camera) -> Tracks:
    """Tracks of glints as tracks of ball centres, where the camera allows; else flagged 'glint'."""
    seen = tracks.xy
    centre, jacobian = camera.centre_of_glint(seen)
    flags = tracks.flags
    if not camera.corrects_glint:
        flags = np.array(["|".join(filter(None, ["glint", *f.split("|")])) for f in flags.tolist()], dtype=np.str_)
    return replace(
        tracks,
        x=centre[:, 0].copy(),
        y=centre[:, 1].copy(),
        cov=jacobian @ tracks.cov @ jacobian.transpose(0, 2, 1),
        fixed=jacobian @ tracks.fixed @ jacobian.transpose(0, 2, 1),
        flags=flags,
        glint_x=seen[:, 0].copy(),
        glint_y=seen[:, 1].copy(),
    )
