"""The sinks of the energy of translation: the plate, contacts of balls, and walls.

Between two contacts a ball loses energy to the plate, because it slides and rolls. At a contact two balls lose what the
local estimate of that contact gives, or the difference of their free paths just before and just after. Turning balls
also have energy of rotation, which a film of plain balls does not show.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tracker.gas.velocities import FreePath, HalfVelocities

Floats = NDArray[np.float64]
SINKS = {
    "contacts": "lost_in_contacts",
    "walls": "lost_at_walls",
    "plate": "lost_to_plate",
    "unresolved": "lost_unresolved",
}


def measure_energies(velocities: HalfVelocities, noise: float) -> tuple[Floats, Floats]:
    """Measure the energies of the balls per unit mass (m^2/s^2), and their variances; noise: of a coordinate, m."""
    square, variance = velocities.square(noise)
    return square / 2, variance / 4


def measure_contact_losses(contacts: pd.DataFrame, paths: Sequence[FreePath], noise: float) -> tuple[Floats, Floats]:
    """Energy that both balls lose in each contact (n,), and its variance; NaN where it is not known.

    Contacts with an energy_lost and no misfit keep it. Others have the difference of the free paths, continued to the
    contact, if both are known.
    """
    balls = contacts[["particle1", "particle2"]].to_numpy()
    value, variance = np.full((len(contacts), 2, 2), np.nan), np.full((len(contacts), 2, 2), np.nan)
    value[balls[:, 1] < 0, 1] = variance[balls[:, 1] < 0, 1] = 0.0
    for path in paths:
        own, error = measure_energies(path.velocities.take(slice(-2, None)), noise)
        error = error + 2 * np.maximum(own, 0) * path.unsure[[0, -1]] ** 2
        for row, after, k in ((path.start, 1, 0), (path.end, 0, 1)):
            if row >= 0:
                which = int(balls[row, 0] != path.ball)
                value[row, which, after], variance[row, which, after] = own[k], error[k]
    lost, spread = (value[:, :, 0] - value[:, :, 1]).sum(axis=1), variance.sum(axis=(1, 2))
    measured = np.isfinite(contacts["energy_lost"]) & np.isfinite(contacts["energy_lost_std"]) & ~contacts["misfit"]
    given = measured.to_numpy(dtype=bool)
    lost[given] = contacts["energy_lost"][given]
    spread[given] = contacts["energy_lost_std"][given] ** 2
    return lost, spread


def measure_losses(
    paths: Sequence[FreePath], contacts: pd.DataFrame, frames: NDArray[np.int64], noise: float
) -> pd.DataFrame:
    """Energy of the balls in view at each frame, and what they lost since they came into view, by sink.

    Columns: energy, lost_in_contacts, lost_at_walls, lost_to_plate, lost_unresolved, each with NAME_std, m^2/s^2. From
    the last velocity before a contact to the first one after it, balls lose what the contact takes, and the rest to the
    plate. This is unresolved where the loss of the contact is not known, where a path is too short for a velocity, and
    where nobody saw the ball.

    frames: (n,) ascending. noise: of a coordinate, m.
    """
    seen, smoothed = _Sums(len(frames)), _Sums(len(frames))  # by how much all may err in the same direction
    lost = {name: _Sums(len(frames)) for name in SINKS}
    taken, variances = measure_contact_losses(contacts, paths, noise)
    steps: dict[int, list[tuple[int, float, float]]] = {}  # by contact: row of frames, loss across it, its variance
    in_view: dict[int, list[tuple[NDArray[np.int64], Floats, Floats]]] = {}  # by ball: rows of frames, energy, variance
    before: dict[int, tuple[FreePath, float, float]] = {}  # by ball: its last path, and its energy at its last frame
    for path in sorted(paths, key=lambda path: (path.ball, path.start_time)):
        value, error = measure_energies(path.velocities.take(slice(None, -2)), noise)
        rows, known = np.searchsorted(frames, path.frame), np.isfinite(value)
        shift = np.sqrt(2 * np.maximum(np.nan_to_num(value), 0)) * path.unsure
        error = error + shift**2
        smoothed.add(rows, shift, 0.0)
        in_view.setdefault(path.ball, []).append((rows, value, error))
        value, error, rows = value[known], error[known], rows[known]
        if not len(value):
            continue
        lost["plate"].add(rows[1:], -np.diff(value), 0.0)
        lost["plate"].add(rows[-1], 0.0, error[0] + error[-1])
        if path.ball in before:
            earlier, energy, variance = before[path.ball]
            step = int(rows[0]), energy - float(value[0]), variance + float(error[0])
            if path.start >= 0 and earlier.end == path.start:
                steps.setdefault(path.start, []).append(step)
            else:
                lost["unresolved"].add(*step)
        before[path.ball] = path, float(value[-1]), float(error[-1])
    for parts in in_view.values():
        _add_held(seen, *(np.concatenate(part) for part in zip(*parts, strict=True)))
    for contact, both in steps.items():
        wall = contacts["particle2"].iloc[contact] < 0
        if not np.isfinite(taken[contact]) or len(both) < 2 - wall:
            for step in both:
                lost["unresolved"].add(*step)
            continue
        lost["walls" if wall else "contacts"].add(both[0][0], taken[contact], variances[contact])
        for row, energy, variance in both:
            lost["plate"].add(row, energy - taken[contact] / len(both), variance + variances[contact] / len(both))
    columns = {"energy": seen.value[:-1], "energy_std": np.hypot(np.sqrt(seen.variance), smoothed.value)[:-1]}
    for name, column in SINKS.items():
        columns[column] = lost[name].value[:-1].cumsum()
        columns[f"{column}_std"] = np.sqrt(lost[name].variance[:-1].cumsum())
    return pd.DataFrame(columns)


def _add_held(sums: _Sums, rows: NDArray[np.int64], value: Floats, variance: Floats) -> None:
    """Add the energy of one ball; where it has no velocity, its last known energy, which may have changed since."""
    at = np.flatnonzero(np.isfinite(value))
    if not len(at):
        return
    last = np.maximum(np.searchsorted(at, np.arange(len(value)), side="right") - 1, 0)
    after = np.minimum(last + 1, len(at) - 1)
    held, change = value[at[last]], value[at[after]] - value[at[last]]
    unsure = np.where(np.isfinite(value), 0.0, change**2 / 3)
    sums.add(rows, held, variance[at[last]] + unsure)


class _Sums:
    """Sums of values and of their variances by frame; what comes after the last frame goes into one further entry."""

    def __init__(self, frames: int) -> None:
        self.value, self.variance = np.zeros(frames + 1), np.zeros(frames + 1)

    def add(self, rows: NDArray[np.int64] | int, value: Floats | float, variance: Floats | float) -> None:
        """Add to those frames."""
        rows = np.minimum(rows, len(self.value) - 1)
        np.add.at(self.value, rows, value)
        np.add.at(self.variance, rows, variance)
