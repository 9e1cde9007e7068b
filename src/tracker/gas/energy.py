"""The sinks of the energy of translation: the plate, contacts of balls, and walls.

Between two contacts a ball loses energy to the plate, because it slides and rolls. At a contact two balls lose the
energy that the local estimate of that contact gives. Without one they lose the difference of their free paths just
before and just after. Contacts that follow one another too fast for a velocity between them are balanced together.
Turning balls also have energy of rotation, which a film of plain balls does not show.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.gas.contact_groups import (
    COMMON_ERROR_OF_EXPECTED,
    ContactGroups,
    count_hidden_rows,
    group_contacts,
    lies_within_group,
)
from tracker.gas.contact_losses import measure_energies
from tracker.gas.free_paths import FreePath, sum_sides

SINKS = {"contacts": "lost_in_contacts", "walls": "lost_at_walls", "plate": "lost_to_plate"}  # columns
SINKS |= {"unresolved": "lost_unresolved"}
ERROR_OF_HIDDEN = 0.4  # relative, of what contacts took that were not found next to others
MAX_ERROR_OF_SPREAD = 0.1  # variance of an energy over that among balls, beyond which a ball was hit beside the frame


class _Step(NamedTuple):
    """A ball from its last velocity before contacts to the first one after them."""

    row: int  # of the frames, at the end
    loss: float
    variance: float
    contacts: Ints
    whole: bool  # whether it begins and ends with a contact


def _find_resolved(steps: Sequence[_Step], groups: ContactGroups, needed: Ints) -> Flags:
    """Decide which groups of contacts are resolved: their losses are known, and so are the steps of all their balls.

    Otherwise what one ball gives to another would count as lost. needed: steps of each group.
    """
    resolved = np.isfinite(groups.loss)
    while True:
        seen = np.zeros(len(resolved), dtype=np.int64)
        for step in steps:
            own = groups.select(step.contacts)
            if step.whole and resolved[own].all():
                seen[own] += 1
        kept = resolved & (seen >= needed)
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

    The errors also hold what is not resolved: all of it at contacts of that kind, and half of it for the plate. For
    contacts they also hold what balls without a velocity in the first frame may have lost before their first one.

    frames: (n,) ascending.
    noise: of a coordinate, m.
    frame_s: duration of a frame, s.
    """
    seen, slides, lines = (_Sums(len(frames)) for _ in range(3))  # the last two err in the same direction
    lost = {name: _Sums(len(frames)) for name in SINKS}
    groups = group_contacts(contacts, paths, noise, frame_s)
    balls, at = contacts[["particle1", "particle2"]].to_numpy(), contacts["t_s"].to_numpy(dtype=np.float64)
    in_view: dict[int, list[tuple[Ints, Array, Array]]] = {}  # by ball: rows of frames, energy, variance
    before: dict[int, tuple[FreePath, float, float]] = {}  # by ball: its last path, and its energy at its last frame
    steps = list[_Step]()
    for path in sorted(paths, key=lambda path: (path.ball, path.start_time)):
        value, error = measure_energies(path.velocities.take(slice(None, -2)), noise)
        rows, known = np.searchsorted(frames, path.frame), np.isfinite(value)
        error = error + np.maximum(np.nan_to_num(value), 0) * path.unsure[:-2] ** 2  # along the velocity or across it
        listed = np.isin(path.frame, frames)  # few balls have a velocity in the others
        if path.by_friction is not None:
            velocity = np.nan_to_num(path.velocities.even + path.velocities.odd)[:-2] / 2
            slides.add(rows[listed], (velocity * path.by_friction[:-2]).sum(axis=1)[listed])
        if path.smoothed is not None:
            lines.add(rows[listed], (np.sqrt(2 * np.maximum(np.nan_to_num(value), 0)) * path.smoothed[:-2])[listed])
        in_view.setdefault(path.ball, []).append((rows[listed], value[listed], error[listed]))
        value, error, rows = value[known], error[known], rows[known]
        if not len(value) or lies_within_group(path):
            continue
        lost["plate"].add(rows[1:], -np.diff(value))
        if path.ball in before:
            earlier, energy, variance = before[path.ball]
            own = (at >= earlier.end_time) & (at <= path.start_time) & (balls == path.ball).any(axis=1)
            loss, unsure, whole = energy - value[0], variance + error[0], min(path.start, earlier.end) >= 0
            steps.append(_Step(int(rows[0]), float(loss), float(unsure), np.flatnonzero(own), whole))
        before[path.ball] = path, float(value[-1]), float(error[-1])
    hidden = {name: _Sums(len(frames)) for name in ("contacts", "walls", "plate")}
    _add_steps(steps, groups, paths, lost, hidden)
    each = [one for one in map(_join, in_view.values()) if len(one[0])]
    sides = sum_sides(paths)
    sides = sides[sides["frame"].isin(frames)]
    seen.add(np.searchsorted(frames, sides["frame"]), 0.0, sides["variance"] / 4)
    spread = _find_spread(len(frames), each)
    seen.add(np.arange(len(frames)), 0.0, count_hidden_rows(contacts, frames, frame_s) * spread)
    for rows, value, error in each:
        _add_held(seen, rows, value, error, spread)
    hit = sum(int(rows[0] == 0 and not error[0] < MAX_ERROR_OF_SPREAD * spread[0]) for rows, _, error in each)
    early = groups.expected[0, groups.label[np.argsort(at)[:10]]]
    hidden["contacts"].add(0, hit / 2 * float(early.mean() if len(early) else 0.0))  # of pairs in the first frame
    return _tabulate(seen, np.hypot(slides.value, lines.value), lost, hidden)


def _add_steps(
    steps: Sequence[_Step],
    groups: ContactGroups,
    paths: Sequence[FreePath],
    lost: Mapping[str, _Sums],
    hidden: Mapping[str, _Sums],
) -> None:
    """Add the losses of steps and of groups of contacts to the sinks.

    Steps without a known loss are unresolved. Of these the contacts take what their kicks let expect, if that is known.
    hidden: of the sinks, errors that add up because all may have the same sign. One is what contacts took that were not
    found next to others.
    """
    count = len(groups.loss)

    def add_hidden(name: str, k: int, loss: float, source: str) -> None:
        """Add what contacts took that were not found next to those of a group: a Poisson number of such losses."""
        hides, variance = groups.hiding[k] * loss, groups.hiding[k] * loss**2
        lost[name].add(ends[k], hides, variance)
        lost[source].add(ends[k], -hides, variance)
        for sink in (name, "plate"):
            hidden[sink].add(ends[k], ERROR_OF_HIDDEN * hides)

    inner = [path.start for path in paths if lies_within_group(path)]
    needed = groups.bodies - np.bincount(groups.label[inner], minlength=count)
    resolved, ends, kinds = _find_resolved(steps, groups, needed), np.full(count, -1), ("contacts", "walls")
    for step in steps:
        own = groups.select(step.contacts)
        ends[own] = np.maximum(ends[own], step.row)
        if step.whole and resolved[own].all():
            lost["plate"].add(step.row, step.loss)
            continue
        lost["unresolved"].add(step.row, step.loss, step.variance)
        hidden["plate"].add(step.row, step.loss / 2)
        for row, name in enumerate(kinds):
            if (groups.share[row, own] > 0).any() and not groups.expected[:, own].any():
                hidden[name].add(step.row, step.loss)
    for k in np.flatnonzero(ends >= 0):
        if resolved[k]:
            loss, variance, common = groups.loss[k], groups.variance[k], groups.common[k]
            lost["plate"].add(ends[k], -loss, variance, -common)
            unsure = loss**2 * groups.share_variance[k]
            for row, name in enumerate(kinds):
                share = groups.share[row, k]
                lost[name].add(ends[k], share * loss, share**2 * variance + unsure, share * common)
                add_hidden(name, int(k), share * loss, "plate")
            continue
        for row, name in enumerate(kinds):
            expected = groups.expected[row, k]
            lost[name].add(ends[k], expected, groups.expected_std[row, k] ** 2)
            hidden[name].add(ends[k], COMMON_ERROR_OF_EXPECTED * expected)
            lost["unresolved"].add(ends[k], -expected)
            add_hidden(name, int(k), expected, "unresolved")


def _tabulate(seen: _Sums, shared_std: Array, lost: Mapping[str, _Sums], hidden: Mapping[str, _Sums]) -> pd.DataFrame:
    """Make the columns of `measure_losses`; `hidden` is what errors of the sinks also hold."""
    columns = {"energy": seen.value[:-1], "energy_std": np.hypot(np.sqrt(seen.variance), shared_std)[:-1]}
    for name, column in SINKS.items():
        columns[column] = lost[name].value[:-1].cumsum()
        shared = (lost[name].common[:-1].cumsum(axis=0) ** 2).sum(axis=1)
        if name in hidden:
            shared += hidden[name].value[:-1].cumsum() ** 2
        if name == "plate":  # it is the rest of the energies of the first and of each frame
            shared[1:] += columns["energy_std"][0] ** 2 + columns["energy_std"][1:] ** 2
        columns[f"{column}_std"] = np.sqrt(lost[name].variance[:-1].cumsum() + shared)
    return pd.DataFrame(columns)


def _join(parts: Sequence[tuple[Ints, Array, Array]]) -> tuple[Ints, Array, Array]:
    """The rows of frames, energies and variances of one ball."""
    rows, value, variance = zip(*parts, strict=True)
    return np.concatenate(rows), np.concatenate(value), np.concatenate(variance)


def _find_spread(frames: int, each: Sequence[tuple[Ints, Array, Array]]) -> Array:
    """The variance of the energies of the balls in each frame; each: of a ball, rows of frames, energies, variances."""
    sums = np.zeros((3, frames))
    for rows, value, _ in each:
        known = np.isfinite(value)
        for power in range(3):
            np.add.at(sums[power], rows[known], value[known] ** power)
    count = np.maximum(sums[0], 1)
    return np.asarray(np.maximum(sums[2] / count - (sums[1] / count) ** 2, 0.0))


def _add_held(sums: _Sums, rows: Ints, value: Array, variance: Array, spread: Array) -> None:
    """Add the energy of one ball; where it has no velocity, its last known energy, which may have changed since.

    Before its first velocity and after its last one, its energy may be that of any ball; spread: variance of these.
    """
    at = np.flatnonzero(np.isfinite(value))
    if not len(at):
        return
    last = np.maximum(np.searchsorted(at, np.arange(len(value)), side="right") - 1, 0)
    after = np.minimum(last + 1, len(at) - 1)
    held, change = value[at[last]], value[at[after]] - value[at[last]]
    unsure = np.where(np.isfinite(value), 0.0, change**2 / 3)
    outside = np.ones(len(value), dtype=bool)
    outside[at[0] : at[-1] + 1] = False
    unsure = np.where(outside, 2 * spread[rows], unsure)
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
