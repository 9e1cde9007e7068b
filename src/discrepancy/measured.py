"""Measured collisions from a tracker's results: in metres, and with a first guess of each launch."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tracker.estimate import measure
from tracker.geometry import Camera, InputError
from tracker.link import Tracks
from tracker.results import read_clip, read_tracks

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

MARGIN = 2  # frames at the ends of a phase that may hold a misplaced event
FEWEST = 3  # frames a ball must be seen before the contact
UNCLAIMED = 0.01  # px: stands in where tracks claim no error; the noise is then read off all the same
ESTIMATES = "clip striker status t_c v0 b tau1 tau2 particle1 particle2".split()


@dataclass(frozen=True)
class Measured:
    """One collision. Rows sorted by ball, then frame; ball 0 is the target (ball 1 of the contract), 1 the striker.

    frame (n,); ball (n,); xy (n, 2) centres on the plate, m, means over the exposure; covariance (n, 2, 2) m^2 as
    claimed; launch (6,) a first guess of place x, y (m), t_c (s), v0 (m/s), heading (rad), b. ends (2,): when each ball
    is thought to stop sliding, s.
    """

    clip: int
    striker: str
    camera: Camera
    frame: Ints
    ball: Ints
    xy: Array
    covariance: Array
    launch: Array
    ends: Array

    @property
    def fps(self) -> float:
        return self.camera.fps

    @property
    def exposure(self) -> float:
        return self.camera.exposure

    def phase(self) -> Ints:
        """0 before the contact, 1 sliding, 2 rolling, -1 in an exposure that holds an event: (n,)."""
        opens = self.frame / self.fps
        closes = opens + self.exposure
        end = self.ends[self.ball]
        out = np.full(len(self.frame), -1)
        out[closes <= self.launch[2]] = 0
        out[(opens >= self.launch[2]) & (closes <= end)] = 1
        out[(opens >= self.launch[2]) & (opens >= end)] = 2
        return out

    def stretches(self) -> Iterator[tuple[Array, Array]]:
        """Unbroken stretches of one ball in one phase: places (n, 2) and claimed standard deviations (n,), m."""
        phase, claimed = self.phase(), np.sqrt(np.trace(self.covariance, axis1=1, axis2=2) / 2)
        for p in range(3):
            for b in range(2):
                rows = np.flatnonzero((phase == p) & (self.ball == b))
                for part in np.split(rows, np.flatnonzero(np.diff(self.frame[rows]) != 1) + 1):
                    kept = part[MARGIN : len(part) - MARGIN]
                    yield self.xy[kept], claimed[kept]


def read_measured(measured: Path, camera: Path | None = None) -> tuple[list[Measured], list[str]]:
    """The collisions of a tracker's RESULTS, or of a table of tracks, and a line for each that is left out.

    camera: a table's camera.json; RESULTS have their own. Raises InputError.
    """
    if measured.is_dir():
        if camera is not None:
            raise InputError(f"--camera {camera}: {measured} holds its own; expected it with a table of tracks only")
        source = _results(measured)
    elif camera is None:
        if not measured.exists():
            raise InputError(f"{measured}: no such file or folder, expected RESULTS of a tracker or a table of tracks")
        raise InputError(f"{measured}: expected --camera camera.json with a table of tracks")
    else:
        source = _table(measured, camera)
    kept, left_out = [], []
    for number, tracks, own, rows in source:
        if len(rows) > 1:
            left_out.append(f"clip {number}: {len(rows)} collisions in one recording")
            continue
        outcome = collision(tracks, {"clip": number} | rows[0], own)
        if isinstance(outcome, Measured):
            kept.append(outcome)
        else:
            left_out.append(f"clip {number}: {outcome}")
    if not kept:
        raise InputError(f"{measured}: no clip with a measured collision" + "".join(f"; {x}" for x in left_out[:1]))
    return kept, left_out


Source = Iterator[tuple[int, Tracks, Camera, list[dict[Any, Any]]]]


def _results(folder: Path) -> Source:
    path = folder / "estimates.parquet"
    if not path.is_file():
        raise InputError(f"{folder}: expected RESULTS of a tracker (no estimates.parquet)")
    try:
        table = pd.read_parquet(path)
    except (OSError, ValueError) as e:  # pyarrow's are ValueErrors
        raise InputError(f"{path}: cannot be read as Parquet ({str(e).partition(chr(10))[0][:100]})") from None
    missing = [name for name in ESTIMATES if name not in table]
    if missing:
        raise InputError(f"{path}: no column {', '.join(missing)}")
    for number, rows in table.groupby("clip"):
        clip = int(str(number))
        yield clip, *read_clip(folder, clip), rows.to_dict("records")


def _table(path: Path, camera: Path) -> Source:
    base = Camera.read(camera)
    for number, (tracks, striker) in sorted(read_tracks(path).items()):
        own = replace(base, striker=striker) if striker is not None else base
        yield number, tracks, own, list(measure(tracks, own))


def collision(tracks: Tracks, row: Mapping[Any, Any], camera: Camera) -> Measured | str:
    """The collision that `row` of the estimates describes, or why it cannot be used."""
    if row["status"] != "ok":
        return str(row["status"])
    guess = np.array([float(row[name]) for name in ("t_c", "v0", "b", "tau1", "tau2")])
    if not np.all(np.isfinite(guess)):
        return "no estimate of the contact"
    t_c, v0, b, *taus = guess
    pair = {ball: tracks.particle == row[name] for ball, name in enumerate(("particle1", "particle2"))}
    early = tracks.frame / camera.fps + camera.exposure <= t_c
    if any((early & rows).sum() < FEWEST for rows in pair.values()):
        return f"a ball is seen in fewer than {FEWEST} frames before the contact"
    rows = np.concatenate([np.flatnonzero(pair[ball]) for ball in (0, 1)])
    frame, early = tracks.frame[rows], early[rows]
    ball = np.repeat([0, 1], [pair[0].sum(), pair[1].sum()])
    xy, slope = camera.unproject(tracks.xy[rows])
    spread = tracks.cov[rows]
    if not np.all(spread[:, 0, 0] * spread[:, 1, 1] > spread[:, 0, 1] ** 2):  # NaN too
        spread = np.tile(UNCLAIMED**2 * np.eye(2), (len(rows), 1, 1))
    heading = _heading(frame[early & (ball == 1)], xy[early & (ball == 1)])
    d = np.array([np.cos(heading), np.sin(heading)])
    n = np.sqrt(max(1 - b * b, 0.0)) * d - b * np.array([-d[1], d[0]])
    place = xy[early & (ball == 0)].mean(axis=0) - camera.radius * n
    return Measured(
        clip=int(row["clip"]),
        striker=str(row["striker"]),
        camera=camera,
        frame=frame,
        ball=ball,
        xy=xy,
        covariance=slope @ spread @ np.swapaxes(slope, 1, 2),
        launch=np.array([*place, t_c, v0, heading, b]),
        ends=t_c + np.array(taus),
    )


def _heading(frame: Ints, xy: Array) -> float:
    velocity = np.polyfit(frame - frame.mean(), xy, 1)[0]
    return float(np.arctan2(velocity[1], velocity[0]))


def split(clips: Sequence[Measured]) -> tuple[list[Measured], list[Measured]]:
    """(to fit, to keep out): every fourth clip in order of speed is kept out, so that both cover the speeds."""
    order = sorted(clips, key=lambda c: float(c.launch[3]))
    kept_out = {id(c) for c in order[2::4]}
    return [c for c in clips if id(c) not in kept_out], [c for c in clips if id(c) in kept_out]
