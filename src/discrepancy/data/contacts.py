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
from tracker.measurement.camera_errors import remove_shared, shared_effects
from tracker.measurement.collision.adequacy import MISFIT, TOGETHER
from tracker.measurement.local.recommendation import NONE, recommend
from tracker.recording import Result
from tracker.results import read_clip

NAMES = ("v0", "b", "r", "s", "mass_ratio")  # what is read of the local estimate
NEEDED = ("v0_local", "b_local", "r_local", "s_local", "mass_ratio", "local", "local_shared", "status")
QUANTITIES = ("restitution", "friction", "recoil")


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
    shared: Array  # (n, 3, k): changes of QUANTITIES by one standard error of each error that several contacts share

    @classmethod
    def of(cls, rows: Iterable[Mapping[Any, Any]], stated: Mapping[int, float] | None = None) -> Self:
        """Take them from rows of the estimates; stated: mass of ball a over that of b by clip, default 1.

        Rows without a usable local estimate are left out, such as those whose momentum is not conserved.
        """
        every = [row for row in rows if _is_usable(row)]
        read = [_read_row(row, (stated or {}).get(int(row["clip"]), 1.0)) for row in every]
        columns = {f.name: np.array([row[f.name] for row in read]) for f in fields(cls) if f.name != "shared"}
        changes = np.array([_differentiate_quantities(row) for row in every]).reshape(-1, len(QUANTITIES), len(NAMES))
        table = pd.DataFrame({"local_shared": [row["local_shared"] for row in every], "fit": "local"})
        return cls(**columns, shared=changes @ shared_effects(table, NAMES))

    def __len__(self) -> int:
        return len(self.clip)

    @property
    def speed(self) -> Array:
        """Speed of approach, m/s."""
        return np.hypot(self.speed_n, self.speed_t)

    def select(self, rows: NDArray[np.bool_]) -> Self:
        """Some of the contacts."""
        return replace(self, **{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def split_errors(self, quantity: str) -> tuple[Array, Array]:
        """The standard errors (n,) of each contact alone, and the effects (n, k) of errors that several share."""
        effects = self.shared[:, [QUANTITIES.index(quantity)]]
        return remove_shared(getattr(self, f"{quantity}_std"), effects), effects[:, 0]


def _is_usable(row: Mapping[Any, Any]) -> bool:
    """Decide by the rule of the tracker, as if there were no tied fit."""
    if row["status"] == TOGETHER or not (_is_known(row, "v0_local") and _is_known(row, "b_local")):
        return False
    return recommend({**row, "status": MISFIT})["recommended"] != NONE


def _is_known(row: Mapping[Any, Any], name: str) -> bool:
    value, std = row.get(name), row.get(f"{name}_std")
    return value is not None and std is not None and bool(np.isfinite(value) and 0 < std < np.inf)


def _read_values(row: Mapping[Any, Any]) -> dict[str, tuple[float, float]]:
    """Read the values of NAMES and their standard errors; NaN where the tracks do not show one."""
    columns = {name: name if name == "mass_ratio" else f"{name}_local" for name in NAMES}
    known = {name: _is_known(row, column) for name, column in columns.items()}
    return {n: (float(row[c]), float(row[f"{c}_std"])) if known[n] else (np.nan, np.nan) for n, c in columns.items()}


def _differentiate_quantities(row: Mapping[Any, Any]) -> Array:
    """Differentiate QUANTITIES by NAMES: (3, 5); 0 where one is not known."""
    _, b, r, s, ratio = (value for value, _ in _read_values(row).values())
    root = np.sqrt(max(1 - b * b, 1e-6))
    steepness = abs(b) / ((1 + r) * root)  # the friction that would stop the centres' tangential velocity
    out = np.zeros((len(QUANTITIES), len(NAMES)))
    out[0, NAMES.index("r")] = 1.0
    out[1, 1:4] = np.sign(b) * (1 - s) / ((1 + r) * root**3), -(1 - s) * steepness / (1 + r), -steepness
    out[2, NAMES.index("mass_ratio")] = 1 / ratio
    return np.nan_to_num(out)


def _read_row(row: Mapping[Any, Any], stated: float) -> dict[str, float]:
    values = _read_values(row)
    (v0, _), (b, b_std), (r, r_std), (s, s_std), (ratio, ratio_std) = values.values()
    told = 1 / stated if row["striker"] == "a" else stated
    speed_n, speed_t = v0 * np.sqrt(max(1 - b * b, 0.0)), v0 * abs(b)
    by_b, by_r, by_s = _differentiate_quantities(row)[1, 1:4]
    return {
        "clip": int(row["clip"]),
        "a_strikes": row["striker"] == "a",
        "glides": row.get("motion_local") == "glide",
        "speed_n": speed_n,
        "speed_t": speed_t,
        "restitution": r,
        "restitution_std": r_std,
        "friction": (1 - s) * speed_t / ((1 + r) * speed_n),
        "friction_std": float(np.linalg.norm([by_b * b_std, by_r * r_std, by_s * s_std])),
        "recoil": float(np.log(ratio / told)) if ratio > 0 else np.nan,
        "recoil_std": ratio_std / ratio if ratio > 0 else np.nan,
    }


def read_contacts(measured: Path | Sequence[Result] | pd.DataFrame) -> Contacts:
    """Read contacts as evidence on the impact, from a tracker's RESULTS or results in memory; none from a table."""
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
