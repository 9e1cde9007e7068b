"""A launch: the numbers from which a model works out one collision, the columns of an array (clips, 6) or (clips, 9).

The place x, y (m) and instant t_c (s) of the contact, the striker's speed v0 (m/s) and heading (rad) just before it,
and the impact parameter b. Where strikers do not roll, three more: how each spins, m/s, as `SPIN` of
`synthcam.dynamics.launch`. A striker without slip rolls: it has another past than one of ever so little slip.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from discrepancy.arrays import Array
from synthcam.dynamics.batch import LAUNCH
from synthcam.dynamics.launch import SPIN

X, Y, T_C, V0, HEADING, B = range(len(LAUNCH))
SLIP, SIDE = slice(len(LAUNCH), len(LAUNCH) + 2), len(LAUNCH) + 2
WITH_SPIN = len(LAUNCH) + len(SPIN)


def free(launches: Array) -> NDArray[np.bool_]:
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


def spin(row: Mapping[Any, Any], heading: float) -> Array:
    """The last three of a launch, from a row of estimates: zero where the striker rolls."""
    ux, uy, side = (float(row.get(name, 0.0)) for name in ("u2ix", "u2iy", "side2i"))
    found = np.array([ux * np.cos(heading) + uy * np.sin(heading), uy * np.cos(heading) - ux * np.sin(heading), side])
    return np.asarray(np.nan_to_num(found))


def alike(launches: list[Array]) -> list[Array]:
    """Launches of equal length: without spins where no striker has one."""
    if all(len(launch) == len(LAUNCH) or not launch[len(LAUNCH) :].any() for launch in launches):
        return [launch[: len(LAUNCH)] for launch in launches]
    return [np.concatenate([launch, np.zeros(WITH_SPIN - len(launch))]) for launch in launches]


def normal_speed(launches: Array) -> Array:
    """The speed along the line of centres at the contact, (clips,), m/s."""
    return np.asarray(launches[:, V0] * np.sqrt(1 - launches[:, B] ** 2))


def possible(launches: Array) -> bool:
    """Whether the striker moves, and hits, in each of (clips, 6)."""
    return bool(np.all(np.abs(launches[:, B]) < 1) and np.all(launches[:, V0] > 0))
