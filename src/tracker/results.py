"""Writes and reads the files of RESULTS: run.json, tracks, tables of estimates, and the marks of a finished run.

Everything is written aside and moved into place. Files hold no times and no paths, so that the same input gives the
same bytes.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet

from synthcam_shared.errors import InputError
from synthcam_shared.json_values import replace_non_finite
from synthcam_shared.outputs import write_atomically
from tracker.camera.camera import Camera
from tracker.camera.camera_keys import read_json
from tracker.detection.link import Tracks
from tracker.tables.content import FileContent
from tracker.tables.rows import check_columns, make_tracks_table, to_csv, to_tracks

RUN = "run.json"
CONTACTS = "contacts.parquet"
# by clip, where the motion blur is not as long as the camera file's exposure makes it, s
EXPOSURE_SEEN_KEY = "exposure_seen_s"

OTHER_DETECTOR = "detector.json"  # in the folder of a clip: the detector that replaced that of the run
OTHER_DETECTORS_KEY = "other_detectors"  # the same by clip, in run.json


def clip_folder(results: Path, number: int) -> Path:
    """Return the folder of a clip in RESULTS."""
    return results / "clips" / f"{number:06d}"


def list_clips(results: Path) -> list[int]:
    """List the numbers of the clips with tracks in RESULTS. Raises InputError where there are none."""
    numbers = sorted(int(file.parent.name) for file in (results / "clips").glob("[0-9]*/tracks.parquet"))
    if not numbers:
        raise InputError(f"{results}: no clips/ with tracks in it, expected RESULTS, as tracker track makes them")
    return numbers


def is_clip_done(results: Path, number: int) -> bool:
    """Test whether a clip in RESULTS is complete, by its mark."""
    return clip_folder(results, number).is_dir()


def write_clip_results(
    results: Path,
    number: int,
    tracks: Tracks,
    motion: pd.DataFrame,
    rows: Sequence[Mapping[str, Any]],
    camera: Camera,
    files: Mapping[str, bytes] = MappingProxyType({}),
) -> None:
    """Writes the folder of one clip of RESULTS aside and moves it into place. files: further ones by name."""
    final = clip_folder(results, number)
    aside = final.with_suffix(".tmp")
    shutil.rmtree(aside, ignore_errors=True)
    aside.mkdir(parents=True)
    table = make_tracks_table(tracks)
    columns = {name: pa.array(motion[name].to_numpy(), from_pandas=True) for name in motion.columns}
    try:
        _write_parquet(aside / "tracks.parquet", table)
        write_atomically(aside / "tracks.csv", to_csv(table))
        _write_parquet(aside / "motion.parquet", pa.table(columns))
        write_json(aside / "estimates.json", list(rows))
        write_json(aside / "camera.json", camera.to_dict())
        for name, data in files.items():
            write_atomically(aside / name, data)
        os.replace(aside, final)
    except BaseException:
        shutil.rmtree(aside, ignore_errors=True)
        raise


def finish_results(partial: Path, final: Path, numbers: Iterable[int]) -> pd.DataFrame:
    """Finish RESULTS: gather all estimates, fit them together, move the whole into place; return the estimates."""
    from tracker.measurement.estimate import fit_all_jointly

    order = sorted(numbers)
    calibrate_local(partial, order)
    table = gather_estimates(partial, order)
    _write_parquet(partial / "estimates.parquet", table)
    write_json(partial / "fit.json", fit_all_jointly(table))
    _write_contacts(partial, order)
    cameras = {n: load_json(clip_folder(partial, n) / "camera.json") for n in order}
    if seen := {n: camera[EXPOSURE_SEEN_KEY] for n, camera in cameras.items() if EXPOSURE_SEEN_KEY in camera}:
        write_json(partial / RUN, load_json(partial / RUN) | {EXPOSURE_SEEN_KEY: seen})
    marks = {n: clip_folder(partial, n) / OTHER_DETECTOR for n in order}
    if others := {n: load_json(mark) for n, mark in marks.items() if mark.is_file()}:
        write_json(partial / RUN, load_json(partial / RUN) | {OTHER_DETECTORS_KEY: others})
    write_atomically(partial / "camera.json", (clip_folder(partial, order[0]) / "camera.json").read_bytes())
    os.replace(partial, final)
    return table


def _write_contacts(results: Path, numbers: Sequence[int]) -> None:
    """Write contacts.parquet and contacts.csv of the clips with more than two balls, if there are any."""
    from tracker.measurement.crowd.contact_table import tabulate_contacts

    parts = []
    for number in numbers:
        own = pyarrow.parquet.read_table(clip_folder(results, number) / "tracks.parquet", columns=["particle"])
        if pc.count_distinct(own["particle"]).as_py() < 3:
            continue
        table = tabulate_contacts(*read_clip(results, number), read_rows(results, number))
        if len(table):
            parts.append(table.assign(clip=number)[["clip", *table.columns]])
    if parts:
        every = pd.concat(parts, ignore_index=True)
        _write_parquet(results / CONTACTS, every)
        write_atomically(results / "contacts.csv", every.to_csv(index=False, lineterminator="\n"))


def read_contact_table(results: Path, number: int) -> pd.DataFrame:
    """Read the contacts of one clip of RESULTS with the columns of contacts.parquet, without clip."""
    from tracker.measurement.crowd.contact_table import tabulate_contacts

    if (results / CONTACTS).is_file():
        every = FileContent.of(results / CONTACTS).cells()
        if "clip" in every and (every["clip"] == number).any():
            return every[every["clip"] == number].drop(columns="clip").reset_index(drop=True)
    return tabulate_contacts(*read_clip(results, number), read_rows(results, number))


def calibrate_local(results: Path, numbers: Sequence[int]) -> None:
    """Write into RESULTS the local estimates with errors that the balances of momentum of the set show.

    A second time changes nothing, because the errors start from the values of each clip alone.
    """
    from tracker.measurement.local.local_columns import calibrate_set

    clips = [read_rows(results, number) for number in numbers]
    every = calibrate_set([row for rows in clips for row in rows])
    for number, rows in zip(numbers, clips, strict=True):
        changed, every = every[: len(rows)], every[len(rows) :]
        if replace_non_finite(changed) != replace_non_finite(rows):
            write_json(clip_folder(results, number) / "estimates.json", changed)


def read_rows(results: Path, number: int) -> list[dict[str, Any]]:
    """Read the rows of estimates of one clip of RESULTS."""
    path = clip_folder(results, number) / "estimates.json"
    found = load_json(path)
    if not isinstance(found, list) or not all(isinstance(row, dict) and "status" in row for row in found):
        raise InputError(f"{path}: damaged, expected a list of estimates; remove {results} to start anew")
    return found


def gather_estimates(results: Path, numbers: Iterable[int]) -> pd.DataFrame:
    """Gather all clips' estimates of RESULTS, one row a collision, ``clip`` first."""
    return make_estimates_table({"clip": number, **row} for number in numbers for row in read_rows(results, number))


def make_estimates_table(rows: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Make the table of estimates in RESULTS, one row a collision; None of JSON stands for NaN."""
    table = pd.DataFrame([replace_non_finite(row) for row in rows])
    text_columns = "cov status striker noise flags extrapolated motion_local local local_shared recommended why".split()
    for name in table.columns:
        if table[name].dtype == object and name not in text_columns:
            table[name] = table[name].astype(float)
    return table


def load_json(path: Path) -> Any:
    """Load a JSON file of RESULTS. Raises InputError where it is missing or damaged."""
    try:
        return read_json(path, 1 << 30)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; expected a file of results") from None
    except ValueError as error:
        raise InputError(f"{path}: damaged, expected JSON ({error})") from None


def write_json(path: Path, value: Any) -> None:
    """Write a file of RESULTS as JSON, with null for what is not finite."""
    write_atomically(path, json.dumps(replace_non_finite(value), indent=1, sort_keys=False) + "\n")


def _write_parquet(path: Path, table: pa.Table | pd.DataFrame) -> None:
    if isinstance(table, pd.DataFrame):  # without pandas' own metadata, which names the versions of libraries
        table = pa.Table.from_pandas(table, preserve_index=False).replace_schema_metadata(None)
    with BytesIO() as stream:
        pyarrow.parquet.write_table(table, stream)
        write_atomically(path, stream.getvalue())


def read_clip(results: Path, number: int) -> tuple[Tracks, Camera]:
    """Read the tracks and the camera of one clip of RESULTS."""
    folder = clip_folder(results, number)
    own = folder / "camera.json"
    camera = Camera.read(own if own.is_file() else results / "camera.json")
    content = FileContent.of(folder / "tracks.parquet")
    table = content.cells()
    check_columns(table, content.where)
    return to_tracks(table, content.where), camera


def rows_as_dicts(estimates: pd.DataFrame) -> list[dict[str, Any]]:
    """Convert a table of estimates of RESULTS to dictionaries by column, one for each collision."""
    return [{str(name): value for name, value in row.items()} for row in estimates.to_dict("records")]
