"""Measured collisions from a tracker's results: in metres, and with a first guess of each launch."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tracker.geometry import Camera, InputError

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

MARGIN = 2  # frames at the ends of a phase that may hold a misplaced event
FEWEST = 3  # frames a ball must be seen before the contact


@dataclass(frozen=True)
class Measured:
    """One collision. Rows sorted by ball, then frame; ball 0 is the target (ball 1 of the contract), 1 the striker.

    frame (n,); ball (n,); xy (n, 2) centres on the plate, m, means over the exposure; covariance (n, 2, 2) m^2 as
    claimed; launch (6,) a first guess of place x, y (m), t_c (s), v0 (m/s), heading (rad), b. ends (2,): when each ball
    is thought to stop sliding, s.
    """

    clip: int
    striker: str
    fps: float
    exposure: float
    frame: Ints
    ball: Ints
    xy: Array
    covariance: Array
    launch: Array
    ends: Array

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


def read_results(results: Path) -> tuple[list[Measured], list[str]]:
    """The collisions of a tracker's RESULTS, and a line for each that is left out. Raises InputError."""
    camera = Camera.read(results / "camera.json")
    if not (results / "estimates.parquet").is_file():
        raise InputError(f"{results}: expected RESULTS of a tracker (no estimates.parquet)")
    table = pd.read_parquet(results / "estimates.parquet")
    kept, left_out = [], []
    for row in table.to_dict("records"):
        tracks = pd.read_parquet(results / "clips" / f"{row['clip']:06d}" / "tracks.parquet")
        outcome = collision(tracks, row, camera)
        if isinstance(outcome, Measured):
            kept.append(outcome)
        else:
            left_out.append(f"clip {row['clip']}: {outcome}")
    if not kept:
        raise InputError(f"{results}: no clip with a measured collision" + "".join(f"; {x}" for x in left_out[:1]))
    return kept, left_out


def collision(tracks: pd.DataFrame, row: Mapping[Hashable, object], camera: Camera) -> Measured | str:
    """The collision that `row` of the estimates describes, or why it cannot be used.

    tracks: columns frame, particle, x, y, x_std, y_std, cov_xy (px).
    """
    if row["status"] != "ok":
        return str(row["status"])
    guess = np.array([float(str(row[name])) for name in ("t_c", "v0", "b", "tau1", "tau2")])
    if not np.all(np.isfinite(guess)):
        return "no estimate of the contact"
    t_c, v0, b, *taus = guess
    opens = tracks["frame"] / camera.fps
    before = tracks[opens + camera.exposure <= t_c]
    counts = before["particle"].value_counts()
    if len(counts) < 2 or counts.iloc[1] < FEWEST:
        return f"a ball is seen in fewer than {FEWEST} frames before the contact"
    pair = counts.index[:2].tolist()
    travels = [float(np.ptp(before.loc[before["particle"] == p, ["x", "y"]].to_numpy(), axis=0).max()) for p in pair]
    target, striker = (pair[0], pair[1]) if travels[0] < travels[1] else (pair[1], pair[0])

    rows = pd.concat([tracks[tracks["particle"] == p].sort_values("frame") for p in (target, striker)])
    pixels = rows[["x", "y"]].to_numpy(dtype=float)
    good = np.isfinite(pixels).all(axis=1)
    rows, pixels = rows[good], pixels[good]
    xy, slope = camera.unproject(pixels)
    spread = np.empty((len(rows), 2, 2))
    spread[:, 0, 0], spread[:, 1, 1] = rows["x_std"] ** 2, rows["y_std"] ** 2
    spread[:, 0, 1] = spread[:, 1, 0] = rows["cov_xy"]
    frame = rows["frame"].to_numpy(dtype=np.int64)
    ball = (rows["particle"] == striker).to_numpy(dtype=np.int64)
    early = (frame / camera.fps + camera.exposure) <= t_c
    heading = _heading(frame[early & (ball == 1)], xy[early & (ball == 1)])
    d = np.array([np.cos(heading), np.sin(heading)])
    n = np.sqrt(max(1 - b * b, 0.0)) * d - b * np.array([-d[1], d[0]])
    place = xy[early & (ball == 0)].mean(axis=0) - camera.radius * n
    return Measured(
        clip=int(str(row["clip"])),
        striker=str(row["striker"]),
        fps=camera.fps,
        exposure=camera.exposure,
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
