"""A launch: the numbers from which a model works out one collision, the columns of an array (clips, 6) or (clips, 9).

The place x, y (m) and instant t_c (s) of the contact, the striker's speed v0 (m/s) and heading (rad) just before it,
and the impact parameter b. Where strikers do not roll, three more: how each spins, m/s, as `SPIN_COLUMNS` of
`synthcam.dynamics.launch`. A striker without slip rolls: it has another past than one of ever so little slip.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from discrepancy.arrays import Array
from discrepancy.policy import current_policy
from synthcam.dynamics.batch import LAUNCH_COLUMNS
from synthcam.dynamics.launch import SPIN_COLUMNS
from tracker.measurement.collision.adequacy import MISFIT

X, Y, T_C, V0, HEADING, B = range(len(LAUNCH_COLUMNS))
SLIP, SIDE = slice(len(LAUNCH_COLUMNS), len(LAUNCH_COLUMNS) + 2), len(LAUNCH_COLUMNS) + 2
GUESS = 0.2  # of the speed, a slip and a spin to start from
WITH_SPIN = len(LAUNCH_COLUMNS) + len(SPIN_COLUMNS)
BEGUN = 1e-3  # of the speed, a spin about the vertical to start from where it is asked for
LARGEST_SPIN = 10.0  # of the speed, a slip and a spin: a cue gives 3 or 4
LEAST_SLIP = 0.02  # of the speed: where a slip ends, its direction decides a whole past, and no derivative leads on


def find_free_columns(launches: Array) -> NDArray[np.bool_]:
    """Which numbers of launches (clips, p) a fit may change: no slip of a ball that rolls, no side spin where none is.

    Returns
    -------
    (clips, p) array of bool
    """
    out = np.ones(launches.shape, dtype=bool)
    if launches.shape[1] == WITH_SPIN:
        out[:, SLIP] = np.any(launches[:, SLIP] != 0, axis=1)[:, None]
        out[:, SIDE] = launches[:, SIDE] != 0
    return out


def pad_spins(launches: Array) -> Array:
    """The launches (clips, 6) or (clips, 9), as (clips, 9)."""
    return np.pad(launches, ((0, 0), (0, WITH_SPIN - launches.shape[1])))


def allow_side_spin(launch: Array) -> Array:
    """A launch (6,) or (9,) whose striker may spin about the vertical: (9,)."""
    out = pad_spins(launch[None])[0]
    out[SIDE] = out[SIDE] or BEGUN * out[V0]
    return np.asarray(out)


def limit_spins(launches: Array) -> Array:
    """The launches (clips, p): strikers that have all but ended to slide roll; none spins faster than LARGEST_SPIN."""
    if launches.shape[1] != WITH_SPIN:
        return launches
    out, slip, most = launches.copy(), np.hypot(*launches[:, SLIP].T), LARGEST_SPIN * np.abs(launches[:, V0])
    fast = slip > most
    out[fast, SLIP] *= (most[fast] / slip[fast])[:, None]
    out[:, SIDE] = np.clip(out[:, SIDE], -most, most)
    out[slip < LEAST_SLIP * launches[:, V0], SLIP] = 0.0
    return out


def guess_spin(row: Mapping[Any, Any], heading: float, v0: float, pull: Array) -> Array:
    """A first guess of the last three of a launch: zero where the striker rolls.

    Parameters
    ----------
    row : mapping
        Of the estimates. Where its fit was rejected, and not for errors alone that are claimed too small, a spin is
        believed only of a ball that slows down as one that slides, and one that does so slides.
    heading, v0 : float
        rad, m/s.
    pull : (2,) array
        The striker's acceleration before the contact, m/s^2.
    """
    ahead = np.array([np.cos(heading), np.sin(heading)])
    axes = np.stack([ahead, [-ahead[1], ahead[0]]])
    slip, side = np.array([row.get("u2ix", 0.0), row.get("u2iy", 0.0)], dtype=float), float(row.get("side2i", 0.0))
    size = float(np.hypot(*pull))
    doubted = row["status"] == MISFIT and not _explains_by_errors(row)
    if doubted and size < current_policy().sliding_deceleration_m_s2:
        slip, side = np.zeros(2), 0.0
    elif doubted and not np.any(np.nan_to_num(slip)):
        slip, side = -GUESS * v0 * pull / size, GUESS * v0
    return np.asarray(np.nan_to_num([*(axes @ slip), side]))


def _explains_by_errors(row: Mapping[Any, Any]) -> bool:
    """Whether the tied fit agrees with the free one, once errors are as large as that leaves."""
    tied, dof, free, dof_free = (float(row.get(name, np.nan)) for name in ("chi2", "dof", "chi2_free", "dof_free"))
    if not (dof > dof_free > 0 and free > 0):
        return False
    return bool(chdtrc(dof - dof_free, max(tied - free, 0.0) * dof_free / free) > current_policy().spin_p_value)


def equalise_launches(launches: list[Array], rejected: list[bool] | None = None) -> list[Array]:
    """Launches of equal length: without spins where no striker has one.

    Where most strikers spin about the vertical, each may: the spin of one that seems not to is begun with a hundredth
    of theirs.

    Parameters
    ----------
    launches : list of (6,) or (9,) arrays
    rejected : list of bool, optional
        Whether the tracker's model of each clip is rejected: that it found no spin there says nothing. So few others
        that they make no study say nothing of all.
    """
    if all(len(launch) == len(LAUNCH_COLUMNS) or not launch[len(LAUNCH_COLUMNS) :].any() for launch in launches):
        return [launch[: len(LAUNCH_COLUMNS)] for launch in launches]
    out = limit_spins(np.concatenate([pad_spins(launch[None]) for launch in launches]))
    spins = out[:, SIDE] != 0
    told = spins | ~np.array(rejected if rejected else np.zeros(len(out), dtype=bool))
    if told.sum() < current_policy().min_collisions:
        told[:] = True
    if np.mean(spins[told]) > current_policy().spinning_strikers_share:
        out[~spins, SIDE] = 0.01 * np.median(np.abs(out[spins, SIDE]))
    return list(out)


def normal_speed(launches: Array) -> Array:
    """The speed along the line of centres at the contact, (clips,), m/s."""
    return np.asarray(launches[:, V0] * np.sqrt(1 - launches[:, B] ** 2))


def is_possible(launches: Array) -> bool:
    """Whether the striker moves, and hits, in each of (clips, 6)."""
    return bool(np.all(np.abs(launches[:, B]) < 1) and np.all(launches[:, V0] > 0))
