"""A launch: the numbers that determine one collision's motion, columns of an array (clips, 6) or (clips, 9).

- `X`, `Y` (m) and `T_C` (s): position and time of the contact;
- `V0` (m/s) and `HEADING` (rad): the striker's velocity just before it;
- `B`: the impact parameter over the ball's diameter; `MEETS_NOTHING` of a free ball, whose own position x and y are;
- `SLIP` (2 columns) and `SIDE`, m/s, where strikers do not roll: the spin, as `SPIN` of `synthcam.dynamics.launch`.

A striker with zero slip rolls. It has another past than a striker with a very small slip.
"""

from __future__ import annotations

import numpy as np

from discrepancy.policy import current_policy
from synthcam.dynamics.batch import LAUNCH_COLUMNS
from synthcam.dynamics.launch import SPIN_COLUMNS
from synthcam_shared.arrays import Array, Flags

X, Y, T_C, V0, HEADING, B = range(len(LAUNCH_COLUMNS))
SLIP, SIDE = slice(len(LAUNCH_COLUMNS), len(LAUNCH_COLUMNS) + 2), len(LAUNCH_COLUMNS) + 2
WITH_SPIN = len(LAUNCH_COLUMNS) + len(SPIN_COLUMNS)
MEETS_NOTHING = 2.0  # the impact parameter of a ball that touches no other
MAX_SPIN_TO_SPEED = 10.0  # a cue gives a slip or a spin of 3 to 4 times the speed


def find_free_launch_columns(launches: Array) -> Flags:
    """Which numbers of launches (clips, p) a fit may change.

    Not a rolling ball's slip, a side spin of zero, or time and impact parameter of a free ball.
    """
    out = np.ones(launches.shape, dtype=bool)
    free = launches[:, B] == MEETS_NOTHING
    out[free, T_C] = out[free, B] = False
    if launches.shape[1] == WITH_SPIN:
        out[:, SLIP] = np.any(launches[:, SLIP] != 0, axis=1)[:, None]
        out[:, SIDE] = launches[:, SIDE] != 0
    return out


def pad_spins(launches: Array) -> Array:
    """Pad launches (clips, 6) with spins of zero to (clips, 9); those that have nine numbers stay."""
    return np.pad(launches, ((0, 0), (0, WITH_SPIN - launches.shape[1])))


def allow_side_spin(launch: Array) -> Array:
    """Give a launch (6,) or (9,) nine numbers, with a side spin of a thousandth of the speed instead of zero."""
    out = pad_spins(launch[None])[0]
    out[SIDE] = out[SIDE] or 1e-3 * out[V0]
    return np.asarray(out)


def limit_spins(launches: Array) -> Array:
    """Limit the spins of launches (clips, p) to MAX_SPIN_TO_SPEED, and let strikers with a tiny slip roll.

    Below 2 % of the speed a slip is set to zero. Its direction would decide the striker's whole past, and no derivative
    would lead a fit away from there.
    """
    if launches.shape[1] != WITH_SPIN:
        return launches
    out, slip, most = launches.copy(), np.hypot(*launches[:, SLIP].T), MAX_SPIN_TO_SPEED * np.abs(launches[:, V0])
    fast = slip > most
    out[fast, SLIP] *= (most[fast] / slip[fast])[:, None]
    out[:, SIDE] = np.clip(out[:, SIDE], -most, most)
    out[slip < 0.02 * launches[:, V0], SLIP] = 0.0
    return out


def equalise_launches(launches: list[Array], rejected: list[bool] | None = None) -> list[Array]:
    """Give all launches the same number of parameters: 6 where no striker spins, else 9.

    If most strikers have a side spin, the fit may give one to each. A striker whose side spin is zero then starts from
    a hundredth of the others' median.

    rejected: whether the tracker's model of each clip is rejected. Such a clip does not count as one without spin,
    unless fewer than `SearchPolicy.min_collisions` others remain.
    """
    if all(len(launch) == len(LAUNCH_COLUMNS) or not launch[len(LAUNCH_COLUMNS) :].any() for launch in launches):
        return [launch[: len(LAUNCH_COLUMNS)] for launch in launches]
    out = limit_spins(np.concatenate([pad_spins(launch[None]) for launch in launches]))
    spins = out[:, SIDE] != 0
    counts = spins | ~np.array(rejected if rejected else np.zeros(len(out), dtype=bool))
    if counts.sum() < current_policy().min_collisions:
        counts[:] = True
    if np.mean(spins[counts]) > current_policy().spinning_strikers_share:
        out[~spins, SIDE] = 0.01 * np.median(np.abs(out[spins, SIDE]))
    return list(out)


def normal_speed(launches: Array) -> Array:
    """Compute from launches the striker's speed along the line of centres at the contact, (clips,), m/s."""
    return np.asarray(launches[:, V0] * np.sqrt(np.maximum(1 - launches[:, B] ** 2, 0.0)))


def is_possible_launch(launches: Array) -> bool:
    """True if in each of the launches (clips, p) the striker moves, and hits the target or is free."""
    hits = (np.abs(launches[:, B]) < 1) | (launches[:, B] == MEETS_NOTHING)
    return bool(np.all(hits) and np.all(launches[:, V0] > 0))
