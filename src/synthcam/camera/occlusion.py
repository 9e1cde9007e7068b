"""Computes how much of each ball other balls hide from the camera."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from synthcam.camera.pinhole import PinholeCamera
from synthcam_shared.arrays import Array, Flags

OUTLINE_POINTS = 400  # of the outline of a ball, evenly spread, that are looked for behind the others


def compute_hidden_shares(camera: PinholeCamera, centres: Array, radii: Array, *, max_paired: int = 8) -> Array:
    """Share (n, frames) of the outline of each ball, 0 to 1, that balls nearer to the camera cover, in and out of view.

    centres: (n, frames, 3), m; NaN in frames in which a ball is nowhere. radii: (n,), m; NaN for bodies that are not
    balls. Balls with NaN hide nothing and get NaN.

    max_paired: up to so many balls, frames in which no two overlap are found first, by all pairs in all frames at once.
    """
    eye, points = camera.centre, _spread_points(OUTLINE_POINTS)
    there = np.isfinite(radii)[:, None] & np.isfinite(centres).all(axis=2)
    out = np.where(there, 0.0, np.nan)
    crowded = there.sum(axis=0) > 1
    if len(centres) <= max_paired:
        crowded &= _overlap(eye, centres, radii)
    for frame in np.flatnonzero(crowded).tolist():
        balls = np.flatnonzero(there[:, frame])
        sight = centres[balls, frame] - eye
        far = np.linalg.norm(sight, axis=1)
        angle = np.arcsin(np.minimum(radii[balls] / far, 1.0))  # of half the outline
        way = sight / far[:, None]
        pairs = cKDTree(way).query_pairs(4 * np.sin(angle.max() / 2), output_type="ndarray")
        between = 2 * np.arcsin(np.minimum(np.linalg.norm(way[pairs[:, 0]] - way[pairs[:, 1]], axis=1) / 2, 1.0))
        pairs = pairs[between < angle[pairs].sum(axis=1)]
        covered: dict[int, Flags] = {}
        for one, other in pairs.tolist():
            back, front = (one, other) if far[one] > far[other] else (other, one)
            if back not in covered:
                covered[back] = np.zeros(OUTLINE_POINTS, dtype=bool)
            rays = _aim_at_outline(way[back], float(np.tan(angle[back])), points)
            covered[back] |= rays @ way[front] > np.cos(angle[front])
        for back, rows in covered.items():
            out[balls[back], frame] = rows.mean()
    return out


def _overlap(eye: Array, centres: Array, radii: Array) -> Flags:
    """Tell for each frame whether the outlines of two balls overlap, as the camera sees them."""
    sight = centres - eye
    far = np.linalg.norm(sight, axis=2)
    angle, way = np.arcsin(np.minimum(radii[:, None] / far, 1.0)), sight / far[..., None]
    one, other = np.triu_indices(len(centres), 1)
    between = 2 * np.arcsin(np.minimum(np.linalg.norm(way[one] - way[other], axis=2) / 2, 1.0))
    return np.asarray((between < angle[one] + angle[other]).any(axis=0))


def _spread_points(count: int) -> Array:
    """Points (count, 2) evenly spread over the unit disc, on a spiral of the golden angle."""
    k = np.arange(count) + 0.5
    angle = k * np.pi * (3 - np.sqrt(5))
    return np.asarray(np.sqrt(k / count)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


def _aim_at_outline(way: Array, size: float, points: Array) -> Array:
    """Directions (m, 3) to points (m, 2) of an outline about the direction `way`, with the tangent of its angle."""
    side = np.cross(way, np.eye(3)[np.argmin(np.abs(way))])
    side /= np.linalg.norm(side)
    rays = way + size * (points[:, :1] * side + points[:, 1:] * np.cross(way, side))
    return np.asarray(rays / np.linalg.norm(rays, axis=1)[:, None])
