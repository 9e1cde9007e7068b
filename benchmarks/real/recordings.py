"""Hits in tracks of others: reads clones of their repositories and cuts out each hit.

The repositories are not part of this project. Each function takes the path to a clone:

- `read_billiards`: github.com/erdo100/3cushiontool, a match of three-cushion billiards;
- `read_pucks`: github.com/Vidar-Petersson/TIF083-Expfys1A, two pucks on an air table;
- `read_discs`: github.com/Schitrus/TIF083A, discs on an air table, series 5 to 7.
"""

from __future__ import annotations

import io
import pickle
import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tracker.camera.camera import Camera
from tracker.measurement.positions import BallTrack, to_ball_tracks
from tracker.tables.read import read_frame
from tracker.tables.table_options import TableOptions

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class RecordedHit:
    """One hit: its name, positions in m (clip, frame, particle, x, y, t_s) and the keys of camera.json.

    balls: which balls of the recording particles 0 and 1 are, if it has more than two.
    """

    name: str
    tracks: pd.DataFrame
    camera: dict[str, Any]
    balls: tuple[int, int] = (0, 1)


# --- billiards ---

BILLIARD_FILE = "Scripts/20221225_2_Match_Ersin_Cemal.pkl"
BILLIARD_COMMIT = "d1082e4"
FRAME_S = 0.01991
BALL_M, TABLE_M = 0.0615, (2.84, 1.42)


def read_billiards(clone: Path) -> list[RecordedHit]:
    """Read the first hit of each shot, from the last cushion before it to the first event after it."""
    shots = _ArrayUnpickler(io.BytesIO(_read_blob(clone, BILLIARD_FILE, BILLIARD_COMMIT))).load()
    camera = {"size": [2840, 1420], "fps": 1 / FRAME_S, "scale": 1e-3, "exposure": 0.0, "ball_diameter": BALL_M}
    hits = []
    for number, shot in enumerate(shots):
        balls = {k: np.column_stack([ball[c] for c in "txy"]) for k, ball in shot["balls"].items()}
        if (rows := _cut_first_hit(balls)) is not None:
            cue, target, _ = _order_by_start(balls)
            hits.append(RecordedHit(f"shot {number}", rows, camera, (target, cue)))
    return hits


class _ArrayUnpickler(pickle.Unpickler):
    """Reads lists, dictionaries, numbers, texts and arrays of numbers; anything else in the file is refused."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("numpy", "ndarray"):
            return np.ndarray
        if (module, name) == ("numpy", "dtype"):
            return np.dtype
        if name == "_reconstruct" and module.endswith("core.multiarray"):
            return np.ndarray(0).__reduce__()[0]
        raise pickle.UnpicklingError(f"{module}.{name}: expected arrays and plain values only")


def _cut_first_hit(balls: dict[int, Floats]) -> pd.DataFrame | None:
    """Cut the first hit out of one shot, (t, x, y) by ball; None where it is too short.

    The recorder dropped positions that moved by less than 2 mm, so a ball at rest is entered in every frame.
    """
    starts = {k: _first_move(rows) for k, rows in balls.items()}
    cue, target, *third = _order_by_start(balls)
    hit = starts[target]
    if not np.isfinite(hit) or _is_at_rail(balls[target][0, 1:]):
        return None
    early = (starts[cue], *(t for t in _cushions(balls[cue]) if t < hit))
    first, parts = max(early), []
    for particle, ball in enumerate((target, cue)):
        t, xy = balls[ball][:, 0], balls[ball][:, 1:]
        last = min([t for t in _cushions(balls[ball]) if t >= hit] + [starts[k] for k in third])
        keep = (t > first + 1.5 * FRAME_S) & (t < last - 0.5 * FRAME_S)
        if ball == target:
            keep &= t >= hit
        times, places = t[keep], xy[keep]
        if ball == target:
            frames = np.arange(np.ceil(first / FRAME_S + 1.5), np.rint(_touch_time(balls[cue], xy[0], hit) / FRAME_S))
            times = np.concatenate([frames * FRAME_S, times])
            places = np.concatenate([np.tile(xy[0], (len(frames), 1)), places])
        parts.append(pd.DataFrame({"t_s": times, "particle": particle, "x": places[:, 0], "y": places[:, 1]}))
    rows = pd.concat(parts)
    rows = rows.assign(frame=np.rint(rows["t_s"] / FRAME_S).astype(int)).drop_duplicates(["frame", "particle"])
    one, two = (rows[rows["particle"] == k] for k in (0, 1))
    enough = (two["t_s"] < hit).sum() >= 4 and min((b["t_s"] >= hit).sum() for b in (one, two)) >= 4
    near = _nearest(one, two) < 2 * BALL_M
    return rows.reset_index(drop=True) if enough and near else None


def _order_by_start(balls: dict[int, Floats]) -> list[int]:
    """The balls in the order in which they start to move: the striker, the ball that it hits first, the third."""
    return sorted(balls, key=lambda k: _first_move(balls[k]))


def _first_move(rows: Floats) -> float:
    """Time of the first position that is 2 mm from the first one; inf if there is none."""
    moved = np.hypot(*(rows[:, 1:] - rows[0, 1:]).T) > 0.002
    return float(rows[np.argmax(moved), 0]) if moved.any() else np.inf


def _touch_time(cue: Floats, target: Floats, hit: float) -> float:
    """Time of the first position of the cue ball that is as near to the resting ball as any up to the hit."""
    rows = cue[cue[:, 0] <= hit]
    return float(rows[np.argmin(np.hypot(*(rows[:, 1:] - target).T)), 0])


def _is_at_rail(place: Floats, within: float = 0.015) -> bool:
    return bool((np.minimum(place, np.array(TABLE_M) - place) < BALL_M / 2 + within).any())


def _cushions(rows: Floats, within: float = 0.05) -> list[float]:
    """Times at which a ball turns back beside a cushion."""
    out = []
    for axis in (0, 1):
        place = rows[:, 1 + axis]
        step = np.diff(place)
        turns = np.flatnonzero(step[1:] * step[:-1] < 0) + 1
        rail = np.minimum(place, TABLE_M[axis] - place) < BALL_M / 2 + within
        out += [float(rows[k, 0]) for k in turns if rail[k]]
    return sorted(out)


def _nearest(one: pd.DataFrame, two: pd.DataFrame) -> float:
    both = one.merge(two, on="frame")
    return float(np.hypot(both["x_x"] - both["x_y"], both["y_x"] - both["y_y"]).min()) if len(both) else np.inf


# --- pucks and discs on air ---

PUCK_HZ = 500.0


def read_pucks(clone: Path, before: int = 90, after: int = 110, step: int = 2) -> list[RecordedHit]:
    """Read the hits of two pucks of 50 mm, by the middles of three markers on each.

    Their files name the pucks in any order. Particle 0 is the one whose markers are 42.1 mm apart at most, particle 1
    that of 44.0 mm. The scales say 28.73 and 28.19 g, but not which is which.
    """
    camera = {"size": [1000, 1000], "fps": PUCK_HZ / step, "scale": 1e-3, "exposure": 0.0, "ball_diameter": 0.05}
    hits = []
    for name, (a, b) in _read_puck_tables(clone):
        rows = _cut_around_contact(a[:, :2], b[:, :2], PUCK_HZ, before, after, step)
        if rows is not None:
            hits.append(RecordedHit(name, rows, camera))
    return hits


def read_puck_angles(clone: Path) -> dict[str, tuple[Floats, Floats]]:
    """Read the directions in which particles 0 and 1 of each hit point, rad, PUCK_HZ times a second."""
    return {name: (np.unwrap(a[:, 2]), np.unwrap(b[:, 2])) for name, (a, b) in _read_puck_tables(clone)}


def _read_puck_tables(clone: Path) -> Iterator[tuple[str, tuple[Floats, Floats]]]:
    """Iterate over the names of hits with x and y, m, and angles of both pucks (n, 3)."""
    for file in _list_files(clone, "src/RAW_DATA/del2/centers"):
        if re.fullmatch(r".*/centers/Measurement\d+\.tsv\.csv", file):
            table = pd.read_csv(io.BytesIO(_read_blob(clone, file)))
            order = "ab" if _longest_side(clone, file) < 43.0 else "ba"
            a, b = (table[[f"c_{k}_x", f"c_{k}_y", f"ang_{k}"]].to_numpy(np.float64) for k in order)
            yield Path(file).name.split(".")[0], (a, b)


def _longest_side(clone: Path, file: str) -> float:
    """Longest distance of the three markers on puck a of a file, mm: the first marker and the two next to it."""
    raw = file.replace("/centers", "").removesuffix(".csv")
    table = pd.read_csv(io.BytesIO(_read_blob(clone, raw)), sep="\t", skiprows=11, nrows=50).replace(0.0, np.nan)
    markers = [table[[f"New {k:04d} X", f"New {k:04d} Y"]].to_numpy(np.float64) for k in range(6)]
    near = sorted(range(6), key=lambda k: float(np.hypot(*(markers[k] - markers[0])[0])))[:3]
    sides = (np.hypot(*(markers[i] - markers[k]).T) for i, k in zip(near, near[1:] + near[:1], strict=True))
    return max(float(np.nanmedian(side)) for side in sides)


def read_discs(clone: Path, series: tuple[int, ...] = (5, 6, 7)) -> list[RecordedHit]:
    """Read the hits of weighed discs; the names of the files have their masses, g.

    Series 7 has springs. The discs of series 5 have tape and stick; their diameter is their distance after the hit.
    """
    hits = []
    for number in series:
        for file in _list_files(clone, f"data/S{number}"):
            if file.endswith(".tsv"):
                hits += list(_read_disc_file(clone, file, number == 5))
    return hits


def _read_disc_file(clone: Path, file: str, taped: bool) -> Iterator[RecordedHit]:
    lines = _read_blob(clone, file).decode("utf-8", "replace").splitlines()
    head = {line.split("\t")[0]: line.split("\t")[1:] for line in lines[:13]}
    at = next(i for i, line in enumerate(lines) if line.startswith("Frame\t"))
    table = pd.read_csv(io.StringIO("\n".join(lines[at:])), sep="\t").replace(0.0, np.nan)
    names = [next(n for n in head["MARKER_NAMES"] if re.match(rf"{side}\d", n)) for side in "vh"]
    masses = [float(re.match(r"[vh](\d+)_(\d)", n).expand(r"\1.\2")) / 1000 for n in names]  # type: ignore[union-attr]
    a, b = (table[[f"{n} X", f"{n} Y"]].to_numpy(np.float64) / 1000 for n in names)
    rate = float(head["FREQUENCY"][0])
    rows = _cut_around_contact(a, b, rate, 125, 125, 2)
    if rows is None:
        return
    apart = np.hypot(*(a - b).T)
    at = int(np.nanargmin(apart))
    stuck = apart[at + 40 : at + 126]  # tape swings first
    touch = round(float(np.nanmedian(stuck) if taped else np.nanmin(apart)), 4)  # of discs of different sizes
    camera = {"size": [1000, 1000], "fps": rate / 2, "scale": 1e-3, "exposure": 0.0, "ball_diameter": touch}
    yield RecordedHit(Path(file).stem, rows, camera | {"ball_masses": masses})


def _cut_around_contact(a: Floats, b: Floats, rate: float, before: int, after: int, step: int) -> pd.DataFrame | None:
    apart = np.hypot(*(a - b).T)
    if not np.isfinite(apart).any():
        return None
    at = int(np.nanargmin(apart))
    rows = np.arange(max(at - before, 0), min(at + after + 1, len(a)), step)
    parts = [
        pd.DataFrame({"frame": rows // step, "t_s": rows / rate, "particle": k, "x": p[rows, 0], "y": p[rows, 1]})
        for k, p in enumerate((a, b))
    ]
    table = pd.concat(parts).dropna().reset_index(drop=True)
    return table if len(table) > 40 else None


def _read_blob(clone: Path, file: str, commit: str = "HEAD") -> bytes:
    return subprocess.run(["git", "-C", clone, "show", f"{commit}:{file}"], capture_output=True, check=True).stdout


def _list_files(clone: Path, folder: str) -> list[str]:
    asked = ["git", "-C", str(clone), "ls-tree", "-r", "--name-only", "-z", "HEAD", folder]
    listed: str = subprocess.run(asked, capture_output=True, check=True, text=True).stdout
    return listed.strip("\0").split("\0")


def to_table(hits: list[RecordedHit]) -> pd.DataFrame:
    """Join hits into one table, each a clip."""
    return pd.concat([hit.tracks.assign(clip=k) for k, hit in enumerate(hits)], ignore_index=True)


def read_balls(hit: RecordedHit, camera: Camera) -> list[BallTrack]:
    """Read the paths of the bodies of a hit with a camera, in m."""
    ((tracks, _),) = read_frame(hit.tracks, hit.camera, TableOptions(unit="m")).clips.values()
    return list(to_ball_tracks(tracks, camera))
