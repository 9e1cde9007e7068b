"""Balances of momentum of groups of contacts that the tracker cannot measure one by one.

A ball that soon meets another one has too few positions between both contacts. But the balls of such a group have paths
before its first contact and after its last one. Their momenta are the same, whatever happened between. A heavier ball
shows in that balance, and in both of its components.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from synthcam_shared.arrays import Array, Ints
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.gas.contact_groups import lies_within_group
from tracker.gas.free_paths import FreePath
from tracker.gas.gas import GasCamera, GasSettings, find_free_paths, sort_contacts
from tracker.gas.hidden_slides import USUAL_FRICTION
from tracker.measurement.positions import to_ball_tracks

MIN_POSITIONS_BETWEEN = 8  # of a ball between two contacts that are balanced separately
MIN_GROUPS = 10  # whose balances show how large their errors are


@dataclass(frozen=True, eq=False)
class MomentumBalance:
    """The momentum that equal balls would gain in a group of contacts, over the largest change of one of them.

    contacts: rows of the sorted table. gained: (2,) components, with the standard error of either.
    balls: (k,). levers: (k, 2), change of `gained` by the logarithm of the mass of each ball.
    """

    contacts: Ints
    gained: Array
    std: float
    balls: Ints
    levers: Array


def balance_groups(
    tracks: Tracks, camera: Camera, contacts: pd.DataFrame, measured: Collection[int]
) -> list[MomentumBalance]:
    """Balance the momenta of groups of contacts without walls, of which no contact is measured.

    measured: collisions with values of their own. The errors are at least as large as the balances of many groups show,
    with those that are measured.
    """
    if not (camera.metric and camera.knows_diameter) or not len(contacts):
        return []
    table = sort_contacts(contacts)
    known = GasCamera(camera.ball_diameter, camera.fps, camera.glides)
    paths, noise = find_free_paths(to_ball_tracks(tracks, camera), table, known, GasSettings())
    within = [lies_within_group(path, MIN_POSITIONS_BETWEEN) for path in paths]
    ends = np.array([[p.start, p.end] for p, inner in zip(paths, within, strict=True) if inner], dtype=np.int64)
    first, second = ends.reshape(-1, 2).T
    graph = coo_matrix((np.ones(len(first)), (first, second)), (len(table), len(table)))
    count, label = connected_components(graph, directed=False)
    sides: list[list[tuple[FreePath, bool, bool]]] = [[] for _ in range(count)]
    for path, inner in zip(paths, within, strict=True):
        for row, after in ((path.start, True), (path.end, False)):
            if row >= 0:
                sides[label[row]].append((path, after, inner))
    at_wall = (table["particle2"] < 0).to_numpy()
    every = list[MomentumBalance]()
    for group in range(count):
        members = np.flatnonzero(label == group)
        if not at_wall[members].any() and len(sides[group]) == 4 * len(members):  # two balls, before and after
            balance = _balance(members, sides[group], noise, 0.0 if camera.glides else USUAL_FRICTION)
            every += [balance] if balance is not None else []
    wider = 1.0
    if len(every) >= MIN_GROUPS:
        scores = np.concatenate([np.abs(each.gained) / each.std for each in every])
        wider = max(float(np.median(scores)) / 0.67449, 1.0)
    collision = table["collision"].to_numpy()
    return [
        MomentumBalance(each.contacts, each.gained, wider * each.std, each.balls, each.levers)
        for each in every
        if not np.isin(collision[each.contacts], list(measured)).any()  # these paths are in their own values
    ]


def _balance(
    members: Ints, sides: Sequence[tuple[FreePath, bool, bool]], noise: float, friction: float
) -> MomentumBalance | None:
    """Balance the momenta of one group; None without all velocities.

    sides: paths that begin or end in the group, whether after it, and whether they lie within the group.
    friction: deceleration of a ball that slides between its contacts, m/s^2, in an unknown direction of the plane.
    """
    change, variance = dict[int, Array](), 0.0
    for path, after, inner in sides:
        if inner:  # counted once, at its start
            variance += after * (friction * (path.end_time - path.start_time)) ** 2 / 2
            continue
        velocities, at = path.velocities, -2 if after else -1
        velocity = (velocities.even[at] + velocities.odd[at]) / 2
        gain = velocities.gain_even[at] + velocities.gain_odd[at] + 2 * velocities.gain_common[at]
        variance += noise**2 * float(gain) / 4 + float(path.unsure_in_all[at]) ** 2 / 2
        change[path.ball] = change.get(path.ball, np.zeros(2)) + (-velocity if after else velocity)
    balls = np.array(sorted(change))
    lost = np.array([change[ball] for ball in balls]).reshape(-1, 2)
    size = float(np.hypot(*lost.T).max(initial=0.0))
    if not (np.isfinite(lost).all() and np.isfinite(variance) and size > 0):
        return None
    total = lost.sum(axis=0)
    # the mean of what a ball loses and of what the others gain is linear in the logarithm of its mass
    return MomentumBalance(members, -total / size, float(np.sqrt(variance)) / size, balls, (lost - total / 2) / size)
