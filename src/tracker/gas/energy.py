"""The sinks of the energy of translation: the plate, contacts of balls, and walls.

Between two contacts a ball loses energy to the plate, because it slides and rolls. At a contact two balls lose the
energy that the local estimate of that contact gives. Without one they lose the difference of their free paths just
before and just after. The slide after a contact may hide that difference; the kick and the restitution of the film then
give the loss. Turning balls also have energy of rotation, which a film of plain balls does not show.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.gas.velocities import FreePath, HalfVelocities

SINKS = {"contacts": "lost_in_contacts", "walls": "lost_at_walls", "plate": "lost_to_plate"}  # columns
SINKS |= {"unresolved": "lost_unresolved"}


def measure_energies(velocities: HalfVelocities, noise: float) -> tuple[Array, Array]:
    """Measure the energies of the balls per unit mass (m^2/s^2), and their variances; noise: of a coordinate, m."""
    square, variance = velocities.square(noise)
    return square / 2, variance / 4


def predict_losses(contacts: pd.DataFrame, paths: Sequence[FreePath], noise: float) -> tuple[Array, Array, Array]:
    """Predict the energy that each contact takes, by its kick K and the velocities before it.

    Along the line of centres two balls lose K^2 (1 - r)/(1 + r). The median of all K/v_n of the film gives r. Across it
    they keep the share s of their relative speed v_t and lose (1 - s^2) v_t^2/4. The kick of a wall is the whole change
    of a velocity, and its energy needs no r.

    Returns the values (n,), the variances (n,) of what each contact has for itself, and effects (n, 2). These are the
    effects of one standard error of r and of s, which all contacts share. Values are NaN for a table without kicks.
    """
    least = 5  # contacts with a known r
    lost, variance = np.full((2, len(contacts)), np.nan)
    common = np.zeros((len(contacts), 2))
    if "kick" not in contacts or not len(contacts):
        return lost, variance, common
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
    errors = [(along - kick) * kick_std, across * kick_std, kick * both]
    variance[wall] = sum(error**2 for error in errors)[wall]
    seen = ~wall & (both < 0.1 * along)
    if seen.sum() >= least:
        each, (keep, keep_error) = 2 * kick[seen] / along[seen] - 1, _find_kept_share(contacts, least)
        r = float(np.clip(np.median(each), 0.0, 1.0))
        r_error = 1.86 * float(np.median(np.abs(each - r))) / np.sqrt(seen.sum()) + 0.01  # 1.86: of a median
        share, square = (1 - r) / (1 + r), np.maximum(across**2 - both**2, 0)
        errors = [2 * share * kick * kick_std, (1 - keep**2) / 2 * np.abs(across) * both]
        effects = np.stack([2 / (1 + r) ** 2 * kick**2 * r_error, keep * keep_error / 2 * square], axis=1)
        lost[~wall] = (share * kick**2 + (1 - keep**2) * square / 4)[~wall]
        variance[~wall] = sum(error**2 for error in errors)[~wall]
        common[~wall] = effects[~wall]
    return lost, variance, common


def _find_kept_share(contacts: pd.DataFrame, least: int) -> tuple[float, float]:
    """The share s of a relative speed that bodies keep, and its error, by the contacts that show their friction.

    With fewer than `least` it lies between 1, of smooth bodies, and that of balls that stick to one another, 5/7.
    """
    max_error, columns = 0.15, ["mu_bb", "mu_bb_std", "r", "v_n", "v_t"]
    if set(columns) <= set(contacts):
        friction, std, r, along, across = contacts[columns].to_numpy(dtype=np.float64).T
        with np.errstate(divide="ignore", invalid="ignore"):
            lever = (1 + r) * along / across
        known = (std * lever < max_error) & ~contacts["misfit"].to_numpy(dtype=bool)
        if known.sum() >= least:
            each = 1 - (friction * lever)[known]
            keep = float(np.median(each))
            error = 1.86 * float(np.median(np.abs(each - keep))) / np.sqrt(known.sum()) + 0.02
            return float(np.clip(keep, 0.0, 1.0)), error
    return 6 / 7, 1 / 7


def _lies_inside(contacts: pd.DataFrame) -> Flags:
    """Decide which contacts lie inside the hull of all by more than 2 % of its smallest width."""
    out = np.zeros(len(contacts), dtype=bool)
    if "x" not in contacts:
        return out
    place = contacts[["x", "y"]].to_numpy(dtype=np.float64)
    known = np.isfinite(place).all(axis=1)
    place = place[known]
    if len(place) < 4 or np.linalg.matrix_rank(place - place.mean(axis=0), tol=1e-9) < 2:  # all on one line
        return out
    hull = ConvexHull(place)
    depth = -(place @ hull.equations[:, :2].T + hull.equations[:, 2])
    out[known] = depth.min(axis=1) > 0.02 * depth.max(axis=0).min()
    return out


def measure_contact_losses(
    contacts: pd.DataFrame, paths: Sequence[FreePath], noise: float, frame_s: float = 0.0
) -> tuple[Array, Array, Array]:
    """Energy that both balls lose in each contact (n,), its variance, and the effects (n, 2) of errors that all share.

    Contacts with an energy_lost and no misfit keep it. Others have the difference of the free paths, continued to the
    contact, if both are known, or what their kick predicts. The loss is NaN where it is not known,
    and at

    - a kink inside the hull of all contacts: a hit of a ball that was not found;
    - a wall that would take more than its kick K allows, K^2/2;
    - a wall next to another contact of the ball: the kick is not the wall's alone.

    frame_s: duration of a frame, s.
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
    predicted, error, common = predict_losses(contacts, paths, noise)
    better = np.isfinite(predicted) & ~(spread < error + (common**2).sum(axis=1))
    lost[better], spread[better] = predicted[better], error[better]
    measured = np.isfinite(contacts["energy_lost"]) & np.isfinite(contacts["energy_lost_std"]) & ~contacts["misfit"]
    given = measured.to_numpy(dtype=bool)
    lost[given] = contacts["energy_lost"][given]
    spread[given] = contacts["energy_lost_std"][given] ** 2
    common[given | ~better] = 0.0
    unlike_wall = _lies_inside(contacts) | _is_mixed(contacts, frame_s)
    if "kick" in contacts:
        most, errors = contacts["kick"].to_numpy(dtype=np.float64) ** 2 / 2, 3 * np.sqrt(spread)
        unlike_wall |= (lost > most + errors) | (lost < -errors)
    lost[(balls[:, 1] < 0) & unlike_wall] = np.nan
    return lost, spread, common


def _is_mixed(contacts: pd.DataFrame, frame_s: float) -> Flags:
    """Decide which contacts are so near another one of the same ball that the kicks of both are one kink."""
    out, time = np.zeros(len(contacts), dtype=bool), contacts["t_s"].to_numpy(dtype=np.float64)
    balls = contacts[["particle1", "particle2"]].to_numpy()
    for ball in np.unique(balls[balls >= 0]):
        own = np.flatnonzero((balls == ball).any(axis=1))
        own = own[np.argsort(time[own], kind="stable")]
        near = np.diff(time[own]) < 2.0 * frame_s  # after more, the path between them shows
        out[own[1:][near]] = out[own[:-1][near]] = True
    return out


class _Step(NamedTuple):
    """A ball from its last velocity before contacts to the first one after them."""

    row: int  # of the frames, at the end
    loss: float
    variance: float
    contacts: Ints
    whole: bool  # whether it begins and ends with a contact


def _find_resolved(steps: Sequence[_Step], taken: Array, bodies: Ints) -> Flags:
    """Decide which contacts are resolved: their losses are known, and so are the steps of all their balls.

    Otherwise what one ball gives to another would count as lost. bodies: balls of each contact.
    """
    resolved = np.isfinite(taken)
    while True:
        seen = np.zeros(len(taken), dtype=np.int64)
        for step in steps:
            if step.whole and resolved[step.contacts].all():
                seen[step.contacts] += 1
        kept = resolved & (seen >= bodies)
        if (kept == resolved).all():
            return kept
        resolved = kept


def measure_losses(
    paths: Sequence[FreePath], contacts: pd.DataFrame, frames: Ints, noise: float, frame_s: float = 0.0
) -> pd.DataFrame:
    """Energy of the balls in view at each frame, and what they lost since they came into view, by sink.

    Columns: energy, lost_in_contacts, lost_at_walls, lost_to_plate, lost_unresolved, each with NAME_std, m^2/s^2. From
    the last velocity before a contact to the first one after it, balls lose what the contact takes, and the rest to the
    plate. This is unresolved if the loss of the contact is not known. So it is if a path is too short for a velocity,
    or the ball was out of view.

    The errors also hold what is not resolved: all of it at contacts of that kind, and half of it for the plate. If
    contacts of one ball follow one another within two frames, as many may be hidden, and their energy is an error too.

    frames: (n,) ascending.
    noise: of a coordinate, m.
    frame_s: duration of a frame, s.
    """
    seen, smoothed = _Sums(len(frames)), _Sums(len(frames))  # by how much all may err in the same direction
    lost = {name: _Sums(len(frames)) for name in SINKS}
    taken, variances, common = measure_contact_losses(contacts, paths, noise, frame_s)
    balls, at = contacts[["particle1", "particle2"]].to_numpy(), contacts["t_s"].to_numpy(dtype=np.float64)
    in_view: dict[int, list[tuple[Ints, Array, Array]]] = {}  # by ball: rows of frames, energy, variance
    before: dict[int, tuple[FreePath, float, float]] = {}  # by ball: its last path, and its energy at its last frame
    steps = list[_Step]()
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
        lost["plate"].add(rows[1:], -np.diff(value))
        lost["plate"].add(rows[-1], 0.0, error[0] + error[-1])
        if path.ball in before:
            earlier, energy, variance = before[path.ball]
            own = (at >= earlier.end_time) & (at <= path.start_time) & (balls == path.ball).any(axis=1)
            loss, unsure, whole = energy - value[0], variance + error[0], min(path.start, earlier.end) >= 0
            steps.append(_Step(int(rows[0]), float(loss), float(unsure), np.flatnonzero(own), whole))
        before[path.ball] = path, float(value[-1]), float(error[-1])
    bodies = 1 + (balls[:, 1] >= 0)
    resolved = _find_resolved(steps, taken, bodies)
    is_pair, mixed = (bodies > 1) | _lies_inside(contacts), _is_mixed(contacts, frame_s)
    hidden = {name: _Sums(len(frames)) for name in ("contacts", "walls", "plate", "beside others")}
    for step in steps:
        if not (step.whole and resolved[step.contacts].all()):
            lost["unresolved"].add(step.row, step.loss, step.variance)
            for name, kind in (("contacts", is_pair), ("walls", ~is_pair)):
                hidden[name].add(step.row, step.loss * kind[step.contacts].any())
            hidden["plate"].add(step.row, step.loss / 2)
            continue
        lost["plate"].add(step.row, step.loss, step.variance)
        for contact in step.contacts:
            part = np.array([taken[contact], variances[contact], *common[contact]]) / bodies[contact]
            lost["contacts" if bodies[contact] > 1 else "walls"].add(step.row, part[0], part[1], part[2:])
            lost["plate"].add(step.row, -part[0], part[1], -part[2:])
            hidden["beside others"].add(step.row, part[0] * mixed[contact])
    for parts in in_view.values():
        _add_held(seen, *(np.concatenate(part) for part in zip(*parts, strict=True)))
    return _tabulate(seen, smoothed, lost, hidden)


def _tabulate(seen: _Sums, smoothed: _Sums, lost: Mapping[str, _Sums], hidden: Mapping[str, _Sums]) -> pd.DataFrame:
    """Make the columns of `measure_losses`; `hidden` is what errors of the sinks also hold."""
    columns = {"energy": seen.value[:-1], "energy_std": np.hypot(np.sqrt(seen.variance), smoothed.value)[:-1]}
    beside = hidden["beside others"].value[:-1].cumsum()
    for name, column in SINKS.items():
        columns[column] = lost[name].value[:-1].cumsum()
        shared = (lost[name].common[:-1].cumsum(axis=0) ** 2).sum(axis=1)
        if name in hidden:
            shared += hidden[name].value[:-1].cumsum() ** 2 + beside**2
        columns[f"{column}_std"] = np.sqrt(lost[name].variance[:-1].cumsum() + shared)
    return pd.DataFrame(columns)


def _add_held(sums: _Sums, rows: Ints, value: Array, variance: Array) -> None:
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
    """Sums by frame of values, their variances, and the effects of errors that all share.

    One further entry has all that comes after the last frame.
    """

    def __init__(self, frames: int) -> None:
        self.value, self.variance, self.common = np.zeros(frames + 1), np.zeros(frames + 1), np.zeros((frames + 1, 2))

    def add(self, rows: ArrayLike, value: ArrayLike, variance: ArrayLike = 0.0, common: ArrayLike = 0.0) -> None:
        """Add to those frames."""
        rows = np.minimum(rows, len(self.value) - 1)
        np.add.at(self.value, rows, value)
        np.add.at(self.variance, rows, variance)
        np.add.at(self.common, rows, common)
