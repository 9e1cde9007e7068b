"""Contacts of two bodies as evidence on the impact: what the tracker's local estimates say of each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from discrepancy.arrays import Array, Ints
from tracker.camera.camera import Camera
from tracker.recording import Result
from tracker.results import read_clip

NEEDED = ("v0_local", "b_local", "r_local", "s_local", "balance_n_local", "mass_ratio")


@dataclass(frozen=True, eq=False)
class Contacts:
    """n contacts; NaN where the tracks do not show a quantity.

    Velocities are of approach, along and across the line of centres, m/s. friction: tangential over normal impulse.
    recoil: logarithm of the mass ratio, struck over striking body, that recoil shows, over that of the camera file.
    """

    clip: Ints  # (n,)
    a_strikes: NDArray[np.bool_]  # (n,): whether ball a of the camera file strikes
    glides: NDArray[np.bool_]  # (n,): whether the bodies glide, and do not roll
    speed_n: Array
    speed_t: Array
    restitution: Array
    restitution_std: Array
    friction: Array
    friction_std: Array
    recoil: Array
    recoil_std: Array

    @classmethod
    def of(cls, rows: Iterable[Mapping[Any, Any]], stated: Mapping[int, float] | None = None) -> Self:
        """Take them from rows of the estimates; stated: mass of ball a over that of b by clip, default 1."""
        every = [_read_row(row, (stated or {}).get(int(row["clip"]), 1.0)) for row in rows]
        known = [row for row in every if np.isfinite(row["speed_n"])]
        return cls(**{f.name: np.array([row[f.name] for row in known]) for f in fields(cls)})

    def __len__(self) -> int:
        return len(self.clip)

    @property
    def speed(self) -> Array:
        """Speed of approach, m/s."""
        return np.hypot(self.speed_n, self.speed_t)

    def select(self, rows: NDArray[np.bool_]) -> Self:
        """Some of the contacts."""
        return replace(self, **{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def _read_row(row: Mapping[Any, Any], stated: float) -> dict[str, float]:
    def get(name: str) -> tuple[float, float]:
        pair = (row.get(name), row.get(f"{name}_std"))
        value, std = (np.nan if x is None else float(x) for x in pair)
        return (value, std) if np.isfinite(value) and std > 0 else (np.nan, np.nan)

    (v0, _), (b, _), (r, r_std), (s, s_std) = (get(f"{name}_local") for name in ("v0", "b", "r", "s"))
    ratio, ratio_std = get("mass_ratio")
    told = 1 / stated if row["striker"] == "a" else stated
    speed_n, speed_t = v0 * np.sqrt(max(1 - b * b, 0.0)), v0 * abs(b)
    steepness = speed_t / ((1 + r) * speed_n)  # the friction that would stop the centres' tangential velocity
    return {
        "clip": int(row["clip"]),
        "a_strikes": row["striker"] == "a",
        "glides": row.get("motion_local") == "glide",
        "speed_n": speed_n,
        "speed_t": speed_t,
        "restitution": r,
        "restitution_std": r_std,
        "friction": (1 - s) * steepness,
        "friction_std": float(np.hypot(s_std * steepness, (1 - s) * steepness * r_std / (1 + r))),
        "recoil": float(np.log(ratio / told)) if ratio > 0 else np.nan,
        "recoil_std": ratio_std / ratio if ratio > 0 else np.nan,
    }


def read_contacts(measured: Path | Sequence[Result] | pd.DataFrame) -> Contacts:
    """Read the contacts of a tracker's RESULTS, or of results in memory; none of a table of tracks."""
    if isinstance(measured, pd.DataFrame) or (isinstance(measured, Path) and not measured.is_dir()):
        return Contacts.of([])
    rows, stated = list[dict[Any, Any]](), dict[int, float]()
    for number, table, ratio in _iterate_estimates(measured):
        rows += table.to_dict("records")
        stated[number] = ratio
    return Contacts.of(rows, stated)


def _iterate_estimates(measured: Path | Sequence[Result]) -> Iterator[tuple[int, pd.DataFrame, float]]:
    """Iterate over the clips that have local estimates: number, rows, and the mass ratio of the camera file."""
    if isinstance(measured, Path):
        table = pd.read_parquet(measured / "estimates.parquet")
        if set(NEEDED) <= set(table):
            for number, rows in table.groupby("clip"):
                yield int(str(number)), rows, _stated_ratio(read_clip(measured, int(str(number)))[1])
        return
    for k, result in enumerate(measured):
        if set(NEEDED) <= set(result.estimates):
            yield k, result.estimates.assign(clip=k), _stated_ratio(result.camera)


def _stated_ratio(camera: Camera) -> float:
    ratio = camera.mass_ratio
    return 1.0 if ratio is None else ratio
