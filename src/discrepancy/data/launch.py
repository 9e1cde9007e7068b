"""A launch: the six numbers from which a model works out one collision, the columns of an array (clips, 6).

The place x, y (m) and instant t_c (s) of the contact, the striker's speed v0 (m/s) and heading (rad) just before it,
and the impact parameter b.
"""

from __future__ import annotations

import numpy as np

from discrepancy.arrays import Array
from synthcam.dynamics.batch import LAUNCH

SIZE = len(LAUNCH)
X, Y, T_C, V0, HEADING, B = range(SIZE)


def normal_speed(launches: Array) -> Array:
    """The speed along the line of centres at the contact, (clips,), m/s."""
    return np.asarray(launches[:, V0] * np.sqrt(1 - launches[:, B] ** 2))


def possible(launches: Array) -> bool:
    """Whether the striker moves, and hits, in each of (clips, 6)."""
    return bool(np.all(np.abs(launches[:, B]) < 1) and np.all(launches[:, V0] > 0))
