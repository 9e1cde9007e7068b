"""The energy that bodies lose to the air that carries them, by the law of their free paths, and the rest of it.

Bodies on air slow down alike on all free paths. A hit that was not found takes energy that would count as lost to the
plate. The law shows how much that is.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from synthcam_shared.arrays import Array
from tracker.gas.energy import SINKS

ERROR_OF_SUM = 0.005  # relative, of a sum over frames instead of an integral


def balance_on_air(time: pd.DataFrame, table: pd.DataFrame, values: Mapping[str, float]) -> pd.DataFrame:
    """Replace the loss to the plate by that of the law of gliding; contacts and walls share the rest of the energy.

    Their losses are measured, and so is their sum. All three are adjusted by their errors. If they disagree by more
    than these, hits of either kind are missing: both variances grow by the same until they agree. Without a law nothing
    changes.

    time: the observables by frame. table: velocities, from `tabulate_velocities`. values: the law, from
    `measure_rolling_loss`.
    """
    if not np.isfinite(values["rolling_loss"]):
        return time
    plate, plate_std = _integrate_loss(time, table, values)
    (contacts, walls), (of_contacts, of_walls) = (
        [time[f"{SINKS[name]}{end}"].to_numpy() for name in ("contacts", "walls")] for end in ("", "_std")
    )
    total = time[list(SINKS.values())].sum(axis=1).to_numpy()
    of_rest = plate_std**2 + time["energy_std"].to_numpy() ** 2 + time["energy_std"].iloc[0] ** 2
    off = total - plate - contacts - walls
    claimed = np.stack([of_contacts**2, of_walls**2])
    excess = np.maximum(off**2 - claimed.sum(axis=0) - of_rest, 0.0)
    variances = claimed + excess / 2
    gains = variances / np.maximum(variances.sum(axis=0) + of_rest, 1e-300)
    out = {SINKS["plate"]: plate, f"{SINKS['plate']}_std": plate_std}
    for name, measured, gain, variance in zip(("contacts", "walls"), (contacts, walls), gains, variances, strict=True):
        out |= {SINKS[name]: measured + gain * off, f"{SINKS[name]}_std": np.sqrt(variance * (1 - gain))}
    out[SINKS["unresolved"]] = (1 - gains.sum(axis=0)) * off
    return time.assign(**out)


def _integrate_loss(time: pd.DataFrame, table: pd.DataFrame, values: Mapping[str, float]) -> tuple[Array, Array]:
    """The energy (n,) that all bodies have lost up to each frame by the law of gliding, m^2/s^2, and its error."""
    square = (table[["even_x", "even_y"]].to_numpy() * table[["odd_x", "odd_y"]].to_numpy()).sum(axis=1)
    speed = np.sqrt(np.maximum(square, 0.0))
    by_loss, by_drag = speed, speed * (speed - values["rolling_speed"])
    rows = np.searchsorted(time["frame"], table["frame"])
    known = rows < len(time)
    everyone = ((time["balls"] + time["unknown"]) / time["balls"]).to_numpy()
    step = np.diff(time["t_s"].to_numpy())
    sums = []
    for part in (by_loss, by_drag):
        power = np.bincount(rows[known], part[known], len(time)) * everyone
        sums.append(np.append(0.0, ((power[1:] + power[:-1]) / 2 * step).cumsum()))
    drag, drag_std = (float(np.nan_to_num(values[f"rolling_drag{end}"])) for end in ("", "_std"))
    lost = values["rolling_loss"] * sums[0] + drag * sums[1]
    errors = values["rolling_loss_std"] * sums[0], drag_std * sums[1], ERROR_OF_SUM * lost
    return lost, np.sqrt(sum(error**2 for error in errors))
