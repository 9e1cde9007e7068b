"""Results that the page shows: clips, recommended numbers, tracks with residuals, also of a search; and their film."""

from __future__ import annotations

import functools
import hashlib
import shlex
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from synthcam_shared.arrays import Ints
from synthcam_shared.errors import InputError
from synthcam_shared.json_values import replace_non_finite
from synthcam_shared.report.numbers import NOT_KNOWN
from tracker import results
from tracker.camera.camera import Camera
from tracker.camera.frames import Frames
from tracker.camera.recordings import RecordingSource, open_source, read_ends
from tracker.detection.link import Tracks
from tracker.edits import TrackEdits
from tracker.measurement.collision.adequacy import NO_DIAMETER, NOTHING_ROLLS, TOGETHER
from tracker.report import estimates_text as text
from tracker.report.collision_figures import list_residuals, view_collision
from tracker.report.pages import PAGE
from tracker.results import RUN, rows_as_dicts

SEARCHED = "residuals.parquet"  # of a search
MAX_POSITIONS = 200_000  # of tracks that the page draws
MAX_FRAMES_ALONE = 10_000_000  # of results without their film: each has a number in memory
MAX_SEARCH_S = 2.0  # among neighbours of results for their film
NEXT_STEP = (
    "If one ball rolls here, point at it by Ball, and limit the search to its path by Region. "
    "If that does not help, remove the wrong tracks by Mend, and mark the ball in each frame by Shift and a click"
)
QUANTITIES = ("v0", "b", "r", "mu_k", "C", "tau1", "tau2", "energy_fraction", "momentum_fraction")


@dataclass(frozen=True, eq=False)
class OpenedResults:
    """RESULTS of `tracker track` or `tracker measure` that are complete."""

    folder: Path
    _residuals: dict[int, dict[tuple[int, int], Any]] = field(default_factory=dict, repr=False)

    @cached_property
    def run(self) -> dict[str, Any]:
        """The entries of run.json. Raises InputError."""
        run = results.load_json(self.folder / RUN)
        if not isinstance(run, dict):
            raise InputError(f"{self.folder / RUN}: damaged, expected keys and values")
        return run

    @cached_property
    def estimates(self) -> pd.DataFrame:
        """The table of estimates. Raises InputError where the run is not complete."""
        file = self.folder / "estimates.parquet"
        try:
            return pd.read_parquet(file)
        except (OSError, ValueError) as error:
            raise InputError(f"{file}: expected the estimates of a complete run ({type(error).__name__})") from None

    @cached_property
    def numbers(self) -> list[int]:
        """The numbers of the clips."""
        return [int(number) for number in self.estimates["clip"].unique()]

    def list_edits(self, number: int) -> list[dict[str, Any]]:
        """The edits of a clip that the run has applied, without its number."""
        given = [edit for edit in self.run.get("edits", []) if edit.get("clip") in (None, number)]
        return [{key: value for key, value in edit.items() if key != "clip"} for edit in given]

    def describe_clips(self) -> list[dict[str, Any]]:
        """Each clip with its status, or the statuses of its collisions."""
        return [
            {"clip": int(str(number)), "status": ", ".join(dict.fromkeys(rows["status"].map(str)))}
            for number, rows in self.estimates.groupby("clip", sort=False)
        ]

    def find_page(self, number: int) -> str:
        """The report of a clip, in the folder; "" where none was written."""
        own = f"{results.clip_folder(self.folder, number).relative_to(self.folder)}/{PAGE}"
        return next((name for name in (own, PAGE) if (self.folder / name).is_file()), "")

    def describe_collisions(self, number: int, most: int = 20) -> dict[str, Any]:
        """The recommended numbers of a clip, with their errors; of more collisions, the first. The report has all."""
        table = self.estimates[self.estimates["clip"] == number]
        return {
            "folder": f"{self.folder}",
            "collisions": [_describe_collision(row) for row in rows_as_dicts(table.head(most))],
            "more": max(len(table) - most, 0),
        }

    def list_tracks(self, number: int, edits: TrackEdits, film: Ints | None = None) -> list[dict[str, Any]]:
        """The tracks of a clip after further edits, px, with residuals of the tied fit; film: its frames."""
        tracks, camera = results.read_clip(self.folder, number)
        if len(tracks) > MAX_POSITIONS:
            raise InputError(f"tracks: {len(tracks)} positions, the page draws at most {MAX_POSITIONS}")
        if number not in self._residuals:
            rows = rows_as_dicts(self.estimates[self.estimates["clip"] == number])
            off = list_residuals(view_collision(row, tracks, camera) for row in rows) if camera.metric else {}
            # positions tell points apart after an exchange of numbers
            known = zip(tracks.particle.tolist(), tracks.frame.tolist(), tracks.x.tolist(), strict=True)
            self._residuals[number] = {(k, x): off[p, k] for p, k, x in known if (p, k) in off}
        edited, residuals = edits.apply(tracks, number, film).tracks, self._residuals[number]
        keys = zip(edited.frame.tolist(), edited.x.tolist(), strict=True)
        metres = [residuals.get(key, (np.nan, np.nan)) for key in keys]
        return list_columns(edited, camera, np.array(metres).reshape(-1, 2))


def list_columns(tracks: Tracks, camera: Camera, metres: NDArray[Any]) -> list[dict[str, Any]]:
    """Columns of each track for the page: positions, errors, flags, and residuals of `metres` (n, 2), in px and um."""
    pixels = metres
    if camera.metric and len(tracks):
        slopes = camera.unproject(tracks.xy)[1]
        pixels = np.linalg.solve(slopes, metres[:, :, None])[:, :, 0]
    std = np.sqrt(np.diagonal(tracks.cov, axis1=1, axis2=2))
    columns: dict[str, Any] = {"frame": tracks.frame, "x": tracks.x.round(3), "y": tracks.y.round(3)}
    columns |= {f"{name}_std": std[:, axis].round(4) for axis, name in enumerate("xy")}
    columns |= {f"{name}_off": pixels[:, axis].round(4) for axis, name in enumerate("xy")}
    columns |= {f"{name}_off_um": (1e6 * metres[:, axis]).round(2) for axis, name in enumerate("xy")}
    columns["flags"] = tracks.flags
    return [
        {"particle": int(number), **{key: replace_non_finite(v[own].tolist()) for key, v in columns.items()}}
        for number in np.unique(tracks.particle)
        for own in [tracks.particle == number]
    ]


def _describe_collision(row: Mapping[str, Any]) -> dict[str, Any]:
    measured = text.has_values(row) or row["status"] == TOGETHER
    is_collision = measured or row.get("frame_last", -1) >= 0
    lines = text.list_quantities(row, QUANTITIES if measured else text.OF_ONE_BALL)
    rows = [
        [line.quantity.plain_symbol, line.values[0], line.quantity.unit, line.quantity.meaning]
        for line in lines
        if line.values[0] != NOT_KNOWN
    ]
    why = text.describe_recommendation(row) or text.describe_rolling(row)
    return {
        "title": f"Collision {row['collision']}" if is_collision else "Film",
        "status": text.describe_status(row),
        "why": NEXT_STEP if row["status"] in ("no_collision", NO_DIAMETER, NOTHING_ROLLS) and not rows else why,
        "method": text.METHODS[next(iter(text.order_methods(row)))] if measured else "one rolling ball",
        "rows": rows,
    }


@dataclass(frozen=True, eq=False)
class TracksAlone(RecordingSource):
    """Results whose film is not there: black frames, over which the tracks are drawn."""

    def open_film(self, index: int, contents: Any = None) -> tuple[int, Frames]:
        """Number and black frames of clip ``index``, as many as its tracks have."""
        number = self.clips[index][0]
        tracks, camera = results.read_clip(self.path, number)
        black, last = np.zeros(camera.size[::-1], np.uint8), int(tracks.frame.max(initial=0))
        if last >= MAX_FRAMES_ALONE:
            where = f"{self.clips[index][1]}: frame {last}"
            raise InputError(f"{where}: expected one below {MAX_FRAMES_ALONE}, or the film by --film")
        frames = Frames(max(last + 1, 2), black.shape, black.dtype, lambda k: black)
        frames.fps = camera.fps if camera.metric else 0.0
        return number, frames


def show_tracks_alone(opened: OpenedResults) -> TracksAlone:
    """Show opened results without their film; each clip has the camera file of its results."""
    tables = [(number, results.clip_folder(opened.folder, number) / "tracks.parquet") for number in opened.numbers]
    return TracksAlone(opened.folder, tuple(tables), dataset=len(tables) > 1)


def find_film(opened: OpenedResults, film: Path | None = None, camera: Path | None = None) -> RecordingSource | None:
    """Find the film of opened results; None where it is not found.

    It is the given one, or that of the command beside a run of the page. Otherwise it is a neighbour of RESULTS whose
    files are those that were tracked. A given film without a camera file has that of the results. Raises InputError
    for a given film that has other clips.
    """
    if film is not None:
        source = open_source(film, camera)
        if missing := sorted({*opened.numbers} - {number for number, _ in source.clips}):
            raise InputError(f"{film}: has no clip {missing[0]}, which {opened.folder} has")
        own = opened.folder / "camera.json"
        return source if source.camera_files() or not own.is_file() else replace(source, camera=own)
    return _search_film(opened.folder.resolve(), opened.run, camera)


def _search_film(folder: Path, run: Mapping[str, Any], camera: Path | None) -> RecordingSource | None:
    """The film of a run, with its camera file; None where the search finds none in MAX_SEARCH_S."""
    named, near, read = _name_film(folder), _list_neighbours(folder), functools.cache(_read_camera)
    others = [] if camera else [path for path in near if path.suffix == ".json"]
    until = time.monotonic() + MAX_SEARCH_S
    for path in (*named, *near):
        with suppress(InputError, OSError):
            source, mark = open_source(path, camera), hashlib.sha256()
            if len(source) != run.get("clips"):
                continue
            for part in read_ends(source):
                mark.update(part)
                if path not in named and time.monotonic() > until:
                    return None
            if _add(mark, *(file.read_bytes() for file in source.camera_files())) == run.get("input"):
                return source
            for other in others:
                if _add(mark, read(other)) == run.get("input"):
                    return open_source(path, other)
    return None


def _add(mark: Any, *parts: bytes) -> str:
    """The digest with more parts."""
    whole = mark.copy()
    whole.update(b"".join(parts))
    return str(whole.hexdigest())


def _read_camera(path: Path, max_bytes: int = 1 << 20) -> bytes:
    """The content of a file that may be a camera file; b"" of one that is none, or is too large for one."""
    with suppress(OSError):
        if path.is_file() and path.stat().st_size <= max_bytes:
            return path.read_bytes()
    return b""


def _name_film(folder: Path) -> list[Path]:
    """The film that the command beside a run of the page names."""
    command = folder.with_name(f"{folder.name.replace('results_', 'command_')}.txt")
    with suppress(OSError, ValueError, IndexError):  # ValueError: no text, or quotes that do not match
        return [Path(shlex.split(command.read_text())[2])]
    return []


def _list_neighbours(folder: Path, most: int = 100) -> list[Path]:
    """Files and folders beside results, and beside the folder that they lie in; of each at most so many."""
    near = list[Path]()
    for one in (folder.parent, folder.parent.parent):
        with suppress(OSError):
            near += [path for path in islice(sorted(one.iterdir()), most) if path != folder]
    return near


@dataclass(frozen=True, eq=False)
class SearchedResiduals:
    """The residuals that `discrepancy find` wrote, for the results that it searched."""

    report: Path
    searched: OpenedResults

    @property
    def is_there(self) -> bool:
        """True if the search has written them."""
        return (self.report / SEARCHED).is_file()

    def describe(self, number: int) -> dict[str, Any]:
        """Each model with its residuals of a clip: rms, um, and tracks; no model where the search left the clip out.

        The rms is None where the tracks have no frame of the search, as after another run into the same folder.
        held_out: whether the clip is one of those that the search kept for tests. Raises InputError.
        """
        tracks, camera = results.read_clip(self.searched.folder, number)
        table = self._read(number)
        if len(table) > MAX_POSITIONS:
            raise InputError(f"search: {len(table)} positions, the page draws at most {MAX_POSITIONS}")
        out: list[dict[str, Any]] = []
        if len(table):
            rows = _find_rows(tracks, camera.unproject(tracks.xy)[0], table)
            kept, rows = table[rows >= 0], rows[rows >= 0]
            names = results.load_json(self.report / "discrepancy.json").get("models", [])
            for name, key in zip(names, ("base", "best"), strict=False):
                metres = np.full((len(tracks), 2), np.nan)
                metres[rows] = kept[[f"x_{key}", f"y_{key}"]]
                shown = list_columns(tracks, camera, metres)
                rms = None if np.isnan(metres).all() else float(f"{1e6 * np.sqrt(np.nanmean(metres**2)):.3g}")
                out.append({"name": name, "rms_um": rms, "tracks": shown})
        return {"clip": number, "models": out, "held_out": bool(table["held_out"].any())}

    def _read(self, number: int) -> pd.DataFrame:
        file = self.report / SEARCHED
        try:
            return pd.read_parquet(file, filters=[("clip", "==", number)])
        except (OSError, ValueError) as error:
            raise InputError(f"{file}: expected the residuals of a search ({type(error).__name__})") from None


def _find_rows(tracks: Tracks, metres: NDArray[Any], table: pd.DataFrame) -> Ints:
    """For each row of the table the nearest position of its frame in the tracks; -1 where the frame has none."""
    order = np.argsort(tracks.frame, kind="stable")
    frames, out = tracks.frame[order], np.full(len(table), -1)
    wanted = table["frame"].to_numpy()
    first, last = (np.searchsorted(frames, wanted, side=side) for side in ("left", "right"))
    for k, xy in enumerate(table[["x", "y"]].to_numpy()):
        here = order[first[k] : last[k]]
        if len(here):
            out[k] = here[np.argmin(((metres[here] - xy) ** 2).sum(axis=1))]
    return out
