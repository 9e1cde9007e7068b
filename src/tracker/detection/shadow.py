"""Shadows that balls cast: how bright the ground about a ball is in a frame, over the still background."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracker.camera.lens import Array
from tracker.detection.still_background import StillBackground

NEAREST, FURTHEST = 1.5, 4.5  # px off the outline, of the ground that is looked at
ARC = 2.5  # px along the outline, that have one brightness
SURE = 4.0  # errors, by which the ground must be darker to be called so

Picture = NDArray[np.floating[Any]]


def measure_ground_light(
    frame: Picture, ground: StillBackground, at: Array, radius: float, others: list[tuple[float, float]]
) -> Callable[[Array, Array], tuple[Array, Array]]:
    """Give the share of its light that the ground has about a ball, by direction.

    Parameters
    ----------
    frame : (h, w) array
    ground : Background
    at : (2,) array
        The ball, px.
    radius : float
        px.
    others : list of (x, y)
        Places of balls that touch this one.

    Returns
    -------
    function of dx, dy
        px from the ball; the share, 1 out of its shadow, and by how much it differs from that beside.
    """
    height, width = frame.shape
    reach = int(radius + FURTHEST + 2)
    column, row = np.round(at).astype(int)
    rows, columns = np.mgrid[
        max(row - reach, 1) : min(row + reach + 1, height - 1),
        max(column - reach, 1) : min(column + reach + 1, width - 1),
    ]
    dx, dy = columns - at[0], rows - at[1]
    off = np.hypot(dx, dy) - radius
    used = (off > NEAREST) & (off < FURTHEST)
    for x, y in others:
        used &= np.hypot(columns - x, rows - y) > radius + NEAREST
    here = rows[used], columns[used]
    bins = max(int(2 * np.pi * radius / ARC), 12)
    number = _bin(dx[used], dy[used], bins).astype(int) % bins
    seen = np.bincount(number, frame[here], bins)
    level = np.bincount(number, ground.level[here], bins)
    variance = np.bincount(number, ground.error[here] ** 2, bins)
    share = np.where(level > 0, seen / np.maximum(level, 1e-9), 1.0)
    share[share > 1 - SURE * np.sqrt(variance) / np.maximum(level, 1e-9)] = 1.0
    change = np.maximum(np.abs(share - np.roll(share, 1)), np.abs(share - np.roll(share, -1)))

    def at_pixels(dx: Array, dy: Array) -> tuple[Array, Array]:
        place = _bin(dx, dy, bins) - 0.5
        first, part = np.floor(place).astype(int) % bins, place % 1.0
        return (1 - part) * share[first] + part * share[(first + 1) % bins], change[place.round().astype(int) % bins]

    return at_pixels


def _bin(dx: Array, dy: Array, bins: int) -> Array:
    return np.asarray(np.arctan2(dy, dx) % (2 * np.pi) / (2 * np.pi) * bins)
