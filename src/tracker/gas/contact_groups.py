"""Contacts that follow one another too fast for a velocity between them, and what they take together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.gas.contact_losses import (
    expect_losses,
    find_approaches,
    find_measured,
    lies_inside,
    measure_contact_losses,
    measure_end_energies,
)
from tracker.gas.free_paths import FreePath
from tracker.gas.hidden_slides import USUAL_FRICTION

MOST_SIGMA = 4.0  # of the loss of a contact from the expected one; beyond it another contact was not found
HIDDEN_SHARE = 0.1  # of the energy of contacts next to one another, by one of the other kind that was not found
COMMON_ERROR_OF_EXPECTED = 0.3  # relative, of losses that the kicks let expect
HIDING_FRAMES = 1.5  # between two contacts of a ball, of which one is not found; in films of known truth


class ContactGroups(NamedTuple):
    """Contacts whose losses are only known together, because a path between them shows no velocity; and the losses."""

    label: Ints  # of each contact, the number of its group
    loss: Array  # of each group, m^2/s^2; NaN if it is not known
    variance: Array
    common: Array  # (groups, 2) effects of errors that all contacts share
    expected: Array  # (2, groups) what its contacts of balls, and its contacts with walls, usually take
    expected_std: Array
    share: Array  # (2, groups) of balls and of walls in its loss
    share_variance: Array  # (groups,)
    hiding: Array  # (groups,) contacts that were not found because one of the group was near, for each of these
    bodies: Ints  # (groups,) sum of the numbers of balls of its contacts

    def select(self, contacts: Ints) -> Ints:
        """The groups of these contacts."""
        return np.unique(self.label[contacts])


def lies_within_group(path: FreePath, least: int = 0) -> bool:
    """Decide whether a path lies within a group of contacts, because it does not show what each of them took.

    least: positions of a path that shows it.
    """
    return min(path.start, path.end) >= 0 and not (path.usable and len(path.time) >= least)


class _GroupedContacts(NamedTuple):
    """Contacts with the number of the group of each, and the energy that each takes by itself."""

    table: pd.DataFrame
    label: Ints
    groups: int
    lone: Flags  # kinks of balls that hit one that was not found
    is_wall: Flags
    taken: Array
    variance: Array

    @property
    def sizes(self) -> Ints:
        """The number of contacts of each group."""
        return np.bincount(self.label, minlength=self.groups).astype(np.int64)

    @property
    def single(self) -> Flags:
        """The contacts that are a group by themselves."""
        return np.asarray(self.sizes[self.label] == 1)

    def add_up(self, values: Array | Flags | Ints) -> Array:
        """Sums over the contacts of each group."""
        return np.asarray(np.bincount(self.label, values, self.groups), dtype=np.float64)


def group_contacts(contacts: pd.DataFrame, paths: Sequence[FreePath], noise: float, frame_s: float) -> ContactGroups:
    """Join contacts between which a ball has no usable path, and balance the energies of the balls before and after.

    The contacts of a group take what its balls lose in all, but for what the plate takes between them. Losses far from
    what the kicks let expect are not known: a contact that was not found changes them.
    """
    taken, variance, common = measure_contact_losses(contacts, paths, noise, frame_s)
    bodies = 1 + (contacts["particle2"].to_numpy() >= 0)
    lone = lies_inside(contacts) & (bodies == 1)
    label, groups = _join_contacts(len(contacts), paths)
    given = _GroupedContacts(contacts, label, groups, lone, (bodies == 1) & ~lone, taken, variance)
    given, expected, std = _expect_by_kicks(given, paths, noise)
    single, joined = given.single, given.sizes > 1
    loss, variance, effects = np.full(groups, np.nan), np.zeros(groups), np.zeros((groups, 2))
    loss[label[single]], variance[label[single]] = given.taken[single], given.variance[single]
    effects[label[single]] = common[single]
    balance, whole = _balance_groups(label, groups, bodies, paths, noise)
    balance[0][given.add_up(lone) > 0] = np.nan  # another ball has a part of the energy
    far = np.abs(balance[0] - expected.sum(axis=0)) > MOST_SIGMA * np.sqrt((std**2).sum(axis=0) + balance[1])
    loss[joined], variance[joined] = np.where(far, np.nan, balance[0])[joined], balance[1][joined]
    disturbed = ~np.isfinite(loss) & whole & expected.any(axis=0)
    loss[disturbed], variance[disturbed] = expected.sum(axis=0)[disturbed], (std**2).sum(axis=0)[disturbed]
    effects[disturbed, 0] = COMMON_ERROR_OF_EXPECTED * loss[disturbed]
    numbers = np.array([given.add_up(kind) for kind in (~given.is_wall, given.is_wall)])
    weights = np.where(expected.any(axis=0), expected, numbers)
    share = weights / np.maximum(weights.sum(axis=0), 1e-300)
    return ContactGroups(
        label=label,
        loss=loss,
        variance=variance,
        common=effects,
        expected=expected,
        expected_std=std,
        share=share,
        share_variance=np.maximum(share.prod(axis=0), np.where(joined, HIDDEN_SHARE * (1 - HIDDEN_SHARE), 0.0)),
        hiding=given.add_up(count_hidden(contacts, frame_s)) / np.maximum(given.sizes, 1),
        bodies=given.add_up(bodies).astype(np.int64),
    )


def _join_contacts(count: int, paths: Sequence[FreePath]) -> tuple[Ints, int]:
    """The number of the group of each contact, and the number of groups."""
    inner = [path for path in paths if lies_within_group(path)]
    links = np.array([[path.start, path.end] for path in inner], dtype=np.int64).reshape(-1, 2).T
    graph = coo_matrix((np.ones(len(inner)), tuple(links)), (count, count))
    groups, label = connected_components(graph, directed=False)
    return label.astype(np.int64), groups


def _expect_by_kicks(
    given: _GroupedContacts, paths: Sequence[FreePath], noise: float
) -> tuple[_GroupedContacts, Array, Array]:
    """Weigh what contacts take by what their kicks let expect.

    Also returns, for each group, what its contacts of balls and with walls usually take (2, groups), and the errors.
    """
    expected, std = np.zeros((2, given.groups)), np.zeros((2, given.groups))
    if "kick" not in given.table or not len(given.table):
        return given, expected, std
    across = find_approaches(given.table, paths, noise)[1]
    alone = np.where(given.single, given.taken, np.nan)
    each, error = expect_losses(given.table, alone, given.variance, across, given.is_wall)
    far = np.abs(given.taken - each) > MOST_SIGMA * np.hypot(error, np.sqrt(given.variance))
    measured = find_measured(given.table)
    taken = np.where(far & ~measured, np.nan, given.taken)
    usual = _combine(taken, given.variance, each, error)
    taken, variance = np.where(measured, (taken, given.variance), usual)
    scatter, share = np.hypot(each, error), np.where(given.lone, 0.75, 1.0)  # the other ball may have a kink of its own
    for row, kind in enumerate((~given.is_wall, given.is_wall)):
        known = kind & np.isfinite(each)
        expected[row] = given.add_up(np.where(known, share * each, 0.0))
        std[row] = np.sqrt(given.add_up(np.where(known, (share * scatter) ** 2, 0.0)))
    return given._replace(taken=taken, variance=variance), expected, std


def count_hidden(contacts: pd.DataFrame, frame_s: float) -> Array:
    """Count the contacts (n,) that hide within `HIDING_FRAMES` of each, by those of its balls a little farther.

    Within 2 frames many are not found; up to 12 frames the density of contacts is about the same. The share that was
    found is that of the whole film. A table without kicks is not the tracker's, and may have all contacts.
    """
    nearest, farthest = 2.0, 12.0  # frames
    if "kick" not in contacts:
        return np.zeros(len(contacts))
    balls, frame = contacts[["particle1", "particle2"]].to_numpy(), contacts["t_s"].to_numpy() / max(frame_s, 1e-12)
    near, found = np.zeros(len(contacts)), 0
    for ball in np.unique(balls[balls >= 0]):
        own = np.flatnonzero((balls == ball).any(axis=1))
        apart = np.abs(np.subtract.outer(frame[own], frame[own]))
        near[own] += ((apart > nearest) & (apart < farthest)).sum(axis=1)
        found += int((apart < HIDING_FRAMES).sum()) - len(own)
    expected = near / (farthest - nearest) * HIDING_FRAMES
    return np.asarray(max(1 - found / max(expected.sum(), 1e-300), 0.0) * expected / 2)


def count_hidden_rows(contacts: pd.DataFrame, frames: Ints, frame_s: float) -> Array:
    """Count the balls (n,) at each frame whose last contact before it, or next one after it, is one that hides.

    Such a ball has not yet, or no longer, the velocity of its path beside the contact that was found.
    """
    hidden, at = count_hidden(contacts, frame_s), contacts["t_s"].to_numpy(dtype=np.float64) / max(frame_s, 1e-12)
    out = np.zeros(len(frames))
    for each, when in zip(hidden[hidden > 0], at[hidden > 0], strict=True):
        near = slice(*np.searchsorted(frames, [when - HIDING_FRAMES, when + HIDING_FRAMES]))
        out[near] += each / 2 * (1 - np.abs(frames[near] - when) / HIDING_FRAMES)  # it is as likely before as after
    return out


def _combine(value: Array, variance: Array, expected: Array, scatter: Array) -> tuple[Array, Array]:
    """Weigh losses and what is usual by their variances; a loss keeps its value where nothing usual is known."""
    least = 0.1  # scatter of contacts about what is usual, over that
    prior = np.maximum(scatter, least * expected) ** 2
    weight = np.where(prior > 0, variance / (variance + np.where(prior > 0, prior, 1.0)), 0.0)
    return value + weight * (np.nan_to_num(expected) - value), variance * (1 - weight)


def _balance_groups(
    label: Ints, groups: int, bodies: Ints, paths: Sequence[FreePath], noise: float
) -> tuple[tuple[Array, Array], Flags]:
    """What the balls of each group of contacts lose in all, without the plate's part, with its variance.

    NaN where a ball has no velocity before or after. Also returns where all balls have a path before and after.
    """
    ends, sums = np.zeros((len(label), 2), dtype=np.int64), np.zeros((2, groups))
    for path in paths:
        value, error = measure_end_energies(path, noise)
        for row, after, k in ((path.start, 1, 0), (path.end, 0, 1)):
            if row >= 0:
                ends[row, after] += 1
                if not lies_within_group(path):
                    sums[:, label[row]] += (-value[k] if after else value[k]), error[k]
        if lies_within_group(path):
            speed = np.sqrt(2 * max(float(np.nanmax(value, initial=0.0)), 0.0))
            most = USUAL_FRICTION * (path.end_time - path.start_time) * speed  # to the plate
            sums[:, label[path.start]] += 0.0, most**2 / 3
    whole = np.ones(groups, dtype=bool)
    np.logical_and.at(whole, label, (ends == bodies[:, None]).all(axis=1))
    return (np.where(whole, sums[0], np.nan), sums[1]), whole
