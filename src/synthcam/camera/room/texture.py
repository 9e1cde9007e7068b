"""Textures of plates: cloth, wood and paper, in world coordinates, as factors around 1.

Waves and noise imitate the look of such plates; they do not model the fibres. Lengths are in m.
"""

import numpy as np
from numpy.typing import NDArray

from synthcam.camera.room.finish import SurfaceFinish
from synthcam_shared.arrays import Array

RANDOM_NUMBERS = 1 << 12  # in the table that a texture is made of


def compute_texture(look: SurfaceFinish, points: Array) -> Array:
    """Compute the texture of a plate at points (n, 2), m: reflectance (n, c) over the mean."""
    if look.texture == "plain" or not look.contrast:
        return np.ones((len(points), 1))
    table = np.random.default_rng(look.seed).random(RANDOM_NUMBERS)
    relief = {"cloth": _cloth, "wood": _wood, "paper": _paper}[look.texture](points, table)
    tint = np.ones(look.channels)
    if look.texture == "wood" and look.channels == 3:
        tint = np.array([0.75, 1.0, 1.25])  # the dark parts of wood are red
    return np.asarray(np.maximum(1 + look.contrast * relief[:, None] * tint, 0.02))


def _cloth(points: Array, table: Array) -> Array:
    """A twill's uneven threads of .6 mm, and a nap that is brushed in patches."""
    x, y = points.T / 6e-4
    weave = np.sin(2 * np.pi * (x + y / 2)) * np.sin(2 * np.pi * (y - x / 2))
    threads = _noise(x / 2, y / 2, table) - 0.5
    nap = sum(_noise(x / step, y / step, table) - 0.5 for step in (12, 40, 130))
    return np.asarray(0.05 * weave + 0.16 * threads + 0.06 * nap)


def _wood(points: Array, table: Array) -> Array:
    """A board along x: rings cut at an angle, pores, and a slow change of the shade."""
    ring_distance, pore_width = 6e-3, 4e-4  # the pores are 20 times as long
    x, y = points.T
    bend = 7 * _noise(x / 0.6, y / 0.07, table) + 0.9 * _noise(x / 0.15, y / 0.01, table)
    ring = y / ring_distance + bend
    phase = ring % 1
    strength = table[np.floor(ring).astype(np.int64) & (RANDOM_NUMBERS - 1)]  # of the year's growth
    rings = strength * (np.where(phase < 0.85, (phase / 0.85) ** 2, (1 - phase) / 0.15) - 0.4)  # a ring ends abruptly
    pores = _noise(x / (40 * pore_width), y / pore_width, table)
    pores = pores + _noise(x / (15 * pore_width), y / (2 * pore_width), table)
    swing = _noise(x / 0.5, y / 0.04, table) - 0.5
    return np.asarray(-0.3 * rings - 0.16 * np.maximum(pores - 1, 0) + 0.25 * swing)


def _paper(points: Array, table: Array) -> Array:
    """Fibres of .5 mm, and the clouds that they form."""
    x, y = points.T / 5e-4
    return 0.03 * (_noise(x, y, table) - 0.5) + 0.04 * (_noise(x / 8, y / 8, table) - 0.5)


def _noise(x: Array, y: Array, table: Array) -> Array:
    """Random values from 0 to 1 on a grid of distance 1, interpolated smoothly."""
    i, j = np.floor(x), np.floor(y)
    u, v = x - i, y - j
    u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
    i, j = i.astype(np.int64), j.astype(np.int64)

    def at(a: NDArray[np.int64], b: NDArray[np.int64]) -> Array:
        mixed = a * 73856093 ^ b * 19349663
        return np.asarray(table[(mixed ^ mixed >> 13) & (RANDOM_NUMBERS - 1)])

    low = (1 - u) * at(i, j) + u * at(i + 1, j)
    high = (1 - u) * at(i, j + 1) + u * at(i + 1, j + 1)
    return np.asarray((1 - v) * low + v * high)
