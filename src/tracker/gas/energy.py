"""The sinks of the energy of translation: the plate, contacts of balls, and walls.

Between two contacts a ball loses energy to the plate, because it slides and rolls. At a contact two balls lose what the
local estimate of that contact gives, or the difference of their free paths just before and just after. Where the slide
after it hides that difference, its kick and the restitution of the film give the loss. Turning balls also have energy
of rotation, which a film of plain balls does not show.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

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


def predict_losses(
    contacts: pd.DataFrame, paths: Sequence[FreePath], noise: float, *, least: int = 5, keep_error: float = 0.3
) -> tuple[Floats, Floats]:
    """Predict the energy that each contact takes, by its kick K and the velocities before it, and its variance.

    Along the line of centres two balls lose K^2 (1 - r)/(1 + r). The median of all K/v_n of the film gives r. Across it
    they keep the share s of their relative speed v_t and lose (1 - s^2) v_t^2/4; s is that of surfaces that stick to
    one another, 5/7. The kick of a wall is the whole change of a velocity, and its energy needs no r.

    least: contacts with a known r. keep_error: of s. Values are NaN for a table without kicks.
    """
    lost, variance = np.full(len(contacts), np.nan), np.full(len(contacts), np.nan)
    if "kick" not in contacts or not len(contacts):
        return lost, variance
    kick, kick_std, *normal = (contacts[name].to_numpy(dtype=np.float64) for name in ("kick", "kick_std", "nx", "ny"))
    balls = contacts[["particle1", "particle2"]].to_numpy()
    wall = balls[:, 1] < 0
    before, spread = np.full((len(contacts), 2, 2), np.nan), np.full((len(contacts), 2), np.nan)
    before[wall, 1] = spread[wall, 1] = 0.0
    for path in paths:
        if path.end >= 0:
            last, which = path.velocities.take(slice(-1, None)), int(balls[path.end, 0] != path.ball)
            before[path.end, which] = (last.even[0] + last.odd[0]) / 2
            gain = last.gain_even[0] + last.gain_odd[0] + 2 * last.gain_common[0]
            spread[path.end, which] = noise**2 * gain / 4 + path.unsure[-1] ** 2
    approach, both = before[:, 1] - before[:, 0], np.sqrt(spread.sum(axis=1))
    along = approach[:, 0] * normal[0] + approach[:, 1] * normal[1]
    across = approach[:, 0] * normal[1] - approach[:, 1] * normal[0]
    lost[wall] = (kick * (along - kick / 2))[wall]
    lost[wall & _lies_inside(contacts)] = np.nan  # a hit of a ball whose partner is not found
    errors = [(along - kick) * kick_std, across * kick_std, kick * both]
    variance[wall] = sum(error**2 for error in errors)[wall]
    seen = ~wall & (both < 0.1 * along)
    if seen.sum() >= least:
        keep, each = 5 / 7, 2 * kick[seen] / along[seen] - 1
        r = float(np.clip(np.median(each), 0.0, 1.0))
        r_error = 1.86 * float(np.median(np.abs(each - r))) / np.sqrt(seen.sum()) + 0.01  # 1.86: of a median
        share, square = (1 - r) / (1 + r), np.maximum(across**2 - both**2, 0)
        errors = [
            2 * share * kick * kick_std,
            2 / (1 + r) ** 2 * kick**2 * r_error,
            keep * keep_error / 2 * square,
            (1 - keep**2) / 2 * np.abs(across) * both,
        ]
        lost[~wall] = (share * kick**2 + (1 - keep**2) * square / 4)[~wall]
        variance[~wall] = sum(error**2 for error in errors)[~wall]
    return lost, variance


def _lies_inside(contacts: pd.DataFrame, *, share: float = 0.02) -> NDArray[np.bool_]:
    """Decide which contacts lie inside the hull of all by more than a share of its smallest width."""
    if "x" not in contacts or len(contacts) < 4:
        return np.zeros(len(contacts), dtype=bool)
    place = contacts[["x", "y"]].to_numpy(dtype=np.float64)
    if np.linalg.matrix_rank(place - place.mean(axis=0), tol=1e-9) < 2:  # all on one line
        return np.zeros(len(contacts), dtype=bool)
    hull = ConvexHull(place)
    depth = -(place @ hull.equations[:, :2].T + hull.equations[:, 2])
    return np.asarray(depth.min(axis=1) > share * depth.max(axis=0).min())


def measure_contact_losses(contacts: pd.DataFrame, paths: Sequence[FreePath], noise: float) -> tuple[Floats, Floats]:
    """Energy that both balls lose in each contact (n,), and its variance; NaN where it is not known.

    Contacts with an energy_lost and no misfit keep it. Others have the difference of the free paths, continued to the
    contact, if both are known, or what their kick predicts.
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
    predicted, error = predict_losses(contacts, paths, noise)
    better = np.isfinite(predicted) & ~(spread < error)
    lost[better], spread[better] = predicted[better], error[better]
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
    balls, at = contacts[["particle1", "particle2"]].to_numpy(), contacts["t_s"].to_numpy(dtype=np.float64)
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
            row, loss, unsure = int(rows[0]), energy - float(value[0]), variance + float(error[0])
            own = (at >= earlier.end_time) & (at <= path.start_time) & (balls == path.ball).any(axis=1)
            if min(path.start, earlier.end) < 0 or not np.isfinite(taken[own]).all():
                lost["unresolved"].add(row, loss, unsure)
            else:
                for contact in np.flatnonzero(own):
                    sharers = 1 + (balls[contact, 1] >= 0)
                    share, error_of_share = taken[contact] / sharers, variances[contact] / sharers
                    lost["contacts" if sharers > 1 else "walls"].add(row, share, error_of_share)
                    loss, unsure = loss - share, unsure + error_of_share
                lost["plate"].add(row, loss, unsure)
        before[path.ball] = path, float(value[-1]), float(error[-1])
    for parts in in_view.values():
        _add_held(seen, *(np.concatenate(part) for part in zip(*parts, strict=True)))
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
