"""The brightness of the ground in a ball's shadow, for the fit of discs; `contrast_regions` finds the shadows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracker.camera.lens import Array
from tracker.detection.still_background import StillBackground

Picture = NDArray[np.floating[Any]]


def measure_ground_light(
    frame: Picture,
    ground: StillBackground,
    at: Array,
    radius: float,
    others: list[tuple[float, float]],
) -> Callable[[Array, Array], tuple[Array, Array]]:
    """Measure, by direction from a ball, the brightness of the ground relative to the still background.

    `at` (2,) is the centre of the ball, px; `others` are those of balls that touch it. The result is a function of
    offsets dx and dy from the ball, px. It returns the relative brightness, 1 outside the shadow, and its difference
    from the neighbouring directions.
    """
    height, width = frame.shape
    nearest, furthest = 1.5, 4.5  # distance of the ground from the outline, px
    arc_px = 2.5  # length along the outline over which the brightness is averaged
    min_sigma = 4.0  # standard errors by which ground in shadow is darker than the background
    reach = int(radius + furthest + 2)
    column, row = np.round(at).astype(int)
    rows, columns = np.mgrid[
        max(row - reach, 1) : min(row + reach + 1, height - 1),
        max(column - reach, 1) : min(column + reach + 1, width - 1),
    ]
    dx, dy = columns - at[0], rows - at[1]
    off = np.hypot(dx, dy) - radius
    used = (off > nearest) & (off < furthest)
    for x, y in others:
        used &= np.hypot(columns - x, rows - y) > radius + nearest
    here = rows[used], columns[used]
    bins = max(int(2 * np.pi * radius / arc_px), 12)
    number = _bin(dx[used], dy[used], bins).astype(int) % bins
    seen = np.bincount(number, frame[here], bins)
    level = np.bincount(number, ground.level[here], bins)
    variance = np.bincount(number, ground.error[here] ** 2, bins)
    share = np.where(level > 0, seen / np.maximum(level, 1e-9), 1.0)
    share[share > 1 - min_sigma * np.sqrt(variance) / np.maximum(level, 1e-9)] = 1.0
    change = np.maximum(np.abs(share - np.roll(share, 1)), np.abs(share - np.roll(share, -1)))

    def at_pixels(dx: Array, dy: Array) -> tuple[Array, Array]:
        at_bin = _bin(dx, dy, bins) - 0.5
        first, part = np.floor(at_bin).astype(int) % bins, at_bin % 1.0
        return (1 - part) * share[first] + part * share[(first + 1) % bins], change[at_bin.round().astype(int) % bins]

    return at_pixels


def _bin(dx: Array, dy: Array, bins: int) -> Array:
    """The direction of offsets, as a number from 0 to `bins`."""
    return np.asarray(np.arctan2(dy, dx) % (2 * np.pi) / (2 * np.pi) * bins)
