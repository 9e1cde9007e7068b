"""Computes how much of each ball other balls hide from the camera."""

import numpy as np
from scipy.spatial import cKDTree

from synthcam.camera.pinhole import PinholeCamera
from synthcam_shared.arrays import Array, Flags


def compute_hidden_shares(
    camera: PinholeCamera, centres: Array, radii: Array, *, max_paired: int = 8, outline_points: int = 400
) -> Array:
    """Share (n, frames) of the outline of each ball, 0 to 1, that balls nearer to the camera cover, in and out of view.

    centres: (n, frames, 3), m; NaN in frames in which a ball is nowhere. radii: (n,), m; NaN for bodies that are not
    balls. Balls with NaN hide nothing and get NaN.

    max_paired: up to so many balls, frames in which no two overlap are found first, by all pairs in all frames at once.
    outline_points: of the outline of a ball, evenly spread, that are searched for behind the others.
    """
    k = np.arange(outline_points) + 0.5
    spiral = k * np.pi * (3 - np.sqrt(5))  # of the golden angle: points evenly spread over the unit disc
    points = np.sqrt(k / outline_points)[:, None] * np.column_stack([np.cos(spiral), np.sin(spiral)])
    there = np.isfinite(radii)[:, None] & np.isfinite(centres).all(axis=2)
    sights = centres - camera.centre
    fars = np.linalg.norm(sights, axis=2)
    ways, angles = sights / fars[..., None], np.arcsin(np.minimum(radii[:, None] / fars, 1.0))  # of half the outline
    out = np.where(there, 0.0, np.nan)
    crowded = there.sum(axis=0) > 1
    if len(centres) <= max_paired:
        one, other = np.triu_indices(len(centres), 1)
        crowded &= (_measure_angle(ways[one], ways[other]) < angles[one] + angles[other]).any(axis=0)
    for frame in np.flatnonzero(crowded).tolist():
        balls = np.flatnonzero(there[:, frame])
        far, way, angle = (each[balls, frame] for each in (fars, ways, angles))
        pairs = cKDTree(way).query_pairs(4 * np.sin(angle.max() / 2), output_type="ndarray")
        pairs = pairs[_measure_angle(way[pairs[:, 0]], way[pairs[:, 1]]) < angle[pairs].sum(axis=1)]
        covered: dict[int, Flags] = {}
        for a, b in pairs.tolist():
            back, front = (a, b) if far[a] > far[b] else (b, a)
            rays = _aim_at_outline(way[back], float(np.tan(angle[back])), points)
            hidden = rays @ way[front] > np.cos(angle[front])
            covered[back] = covered.get(back, False) | hidden
        for back, rows in covered.items():
            out[balls[back], frame] = rows.mean()
    return out


def _measure_angle(one: Array, other: Array) -> Array:
    """The angle between unit vectors (..., 3), rad."""
    return np.asarray(2 * np.arcsin(np.minimum(np.linalg.norm(one - other, axis=-1) / 2, 1.0)))


def _aim_at_outline(way: Array, size: float, points: Array) -> Array:
    """Directions (m, 3) to points (m, 2) of an outline about the direction `way`, with the tangent of its angle."""
    side = np.cross(way, np.eye(3)[np.argmin(np.abs(way))])
    side /= np.linalg.norm(side)
    rays = way + size * (points[:, :1] * side + points[:, 1:] * np.cross(way, side))
    return np.asarray(rays / np.linalg.norm(rays, axis=1)[:, None])
