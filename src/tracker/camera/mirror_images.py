"""Locates what a ball mirrors besides the lamp: the zenith of the room, and the lamp as another ball mirrors it."""

import numpy as np
from numpy.typing import ArrayLike

from synthcam_shared.arrays import Array
from tracker.camera.camera import Camera
from tracker.camera.lens import find_mirror_normal, find_secondary_mirror_normal


def locate_zenith_point(camera: Camera, glints: ArrayLike, share: float) -> Array:
    """Locate points (n, 2), px, at a share of the way from the image of a ball's centre to where it mirrors the zenith.

    The image of a room that is the same in all directions is symmetric about that line. Without a lamp in the camera
    the glints (n, 2), px, themselves are returned.
    """
    seen = np.asarray(glints, dtype=np.float64)
    if not camera.corrects_glint or seen.size == 0:
        return seen.copy()
    middle = camera.ball_of_glint(seen)
    overhead = np.concatenate([middle[..., :2], np.full_like(middle[..., :1], 1e6)], axis=-1)
    normal = find_mirror_normal(middle, camera.radius, camera.position, overhead)
    zenith = camera.project(middle + camera.radius * normal)
    centre = camera.project(middle)
    return np.asarray(centre + share * (zenith - centre), dtype=np.float64)


def locate_secondary_glints(camera: Camera, glints: ArrayLike, others: ArrayLike) -> Array:
    """Locate (n, 2), px, the lamp in balls as their neighbours mirror it. InputError without a lamp in the camera.

    glints, others: (n, 2), px, primary glints of the balls, and of a neighbour of each.
    """
    middle, other, lamp = _find_pairs(camera, glints, others)
    normal = find_secondary_mirror_normal(middle, other, camera.radius, camera.position, lamp)
    return camera.project(middle + camera.radius * normal)


def secondary_flux_ratio(camera: Camera, glints: ArrayLike, others: ArrayLike) -> Array:
    """Compute the flux (n,) of those mirrored glints over that of primary ones, but for one factor of reflectance.

    The image of a small lamp is as large as the determinant of its pixel's derivative by the lamp's position. Arguments
    as of `locate_secondary_glints`.
    """
    middle, other, lamp = _find_pairs(camera, glints, others)
    lights = np.repeat(lamp + 0.03 * lamp[2] * np.eye(3)[[2, 0, 1]] * [1, 1, 0], len(middle), axis=0)
    middle, other = (
        np.tile(middle, (3, 1)),
        np.tile(other, (3, 1)),
    )  # at once: most of the time is that of numpy's calls
    areas = []
    for normal in (
        find_secondary_mirror_normal(middle, other, camera.radius, camera.position, lights),
        find_mirror_normal(middle, camera.radius, camera.position, lights),
    ):
        still, by_x, by_y = camera.project(middle + camera.radius * normal).reshape(3, -1, 2)
        areas.append(np.abs(np.linalg.det(np.stack([by_x - still, by_y - still], axis=-1))))
    return np.asarray(areas[0] / areas[1], dtype=np.float64)


def _find_pairs(camera: Camera, glints: ArrayLike, others: ArrayLike) -> tuple[Array, Array, Array]:
    """Centres (n, 3) of balls and of their neighbours, and the position (3,) of the lamp, m."""
    middle, other = camera.ball_of_glint(np.stack([glints, others]))
    assert camera.lamp is not None  # `ball_of_glint` refuses a camera without one
    return middle, other, np.array(camera.lamp.position, dtype=np.float64)
