"""Plates with texture: cloth, wood and paper, still, in world coordinates. Each gives factors about one.

Waves and noise of such plates as they are to the eye, no model of their fibres. Lengths are m.
"""

import numpy as np
from numpy.typing import NDArray

from synthcam.camera.room.finish import SurfaceFinish

Array = NDArray[np.float64]

THREAD = 6e-4  # of a cloth
RING = 6e-3  # between a board's rings
GRAIN = 4e-4  # across a board's pores; they are 20 times as long
FIBRE = 5e-4  # of paper
CELLS = 1 << 12  # of a table of random numbers


def factors(look: SurfaceFinish, points: Array) -> Array:
    """Reflectance (n, c) over the plate's mean at points (n, 2), m."""
    if look.texture == "plain" or not look.contrast:
        return np.ones((len(points), 1))
    table = np.random.default_rng(look.seed).random(CELLS)
    relief = {"cloth": _cloth, "wood": _wood, "paper": _paper}[look.texture](points, table)
    tint = np.ones(look.channels)
    if look.texture == "wood" and look.channels == 3:
        tint = np.array([0.75, 1.0, 1.25])  # what is dark in wood is red
    return np.asarray(np.maximum(1 + look.contrast * relief[:, None] * tint, 0.02))


def _cloth(points: Array, table: Array) -> Array:
    """A twill's threads, uneven along their length, and a nap that was brushed here and there."""
    x, y = points.T / THREAD
    weave = np.sin(2 * np.pi * (x + y / 2)) * np.sin(2 * np.pi * (y - x / 2))
    threads = _noise(x / 2, y / 2, table) - 0.5
    nap = sum(_noise(x / step, y / step, table) - 0.5 for step in (12, 40, 130))
    return np.asarray(0.05 * weave + 0.16 * threads + 0.06 * nap)


def _wood(points: Array, table: Array) -> Array:
    """A board along x: rings cut at a slant, pores, and a long swing of the shade."""
    x, y = points.T
    bend = 7 * _noise(x / 0.6, y / 0.07, table) + 0.9 * _noise(x / 0.15, y / 0.01, table)
    ring = y / RING + bend
    phase = ring % 1
    strength = table[np.floor(ring).astype(np.int64) & (CELLS - 1)]  # a good year or a bad one
    rings = strength * (np.where(phase < 0.85, (phase / 0.85) ** 2, (1 - phase) / 0.15) - 0.4)  # it ends at once
    pores = _noise(x / (40 * GRAIN), y / GRAIN, table) + _noise(x / (15 * GRAIN), y / (2 * GRAIN), table)
    swing = _noise(x / 0.5, y / 0.04, table) - 0.5
    return np.asarray(-0.3 * rings - 0.16 * np.maximum(pores - 1, 0) + 0.25 * swing)


def _paper(points: Array, table: Array) -> Array:
    """Fibres and the clouds in which they settle."""
    x, y = points.T / FIBRE
    return 0.03 * (_noise(x, y, table) - 0.5) + 0.04 * (_noise(x / 8, y / 8, table) - 0.5)


def _noise(x: Array, y: Array, table: Array) -> Array:
    """Values from 0 to 1 on a grid of ones, smoothly joined."""
    i, j = np.floor(x), np.floor(y)
    u, v = x - i, y - j
    u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
    i, j = i.astype(np.int64), j.astype(np.int64)

    def at(a: NDArray[np.int64], b: NDArray[np.int64]) -> Array:
        mixed = a * 73856093 ^ b * 19349663
        return np.asarray(table[(mixed ^ mixed >> 13) & (CELLS - 1)])

    low = (1 - u) * at(i, j) + u * at(i + 1, j)
    high = (1 - u) * at(i, j + 1) + u * at(i + 1, j + 1)
    return np.asarray((1 - v) * low + v * high)
