"""Locates what a ball mirrors besides the lamp: the zenith of the room, and the lamp as another ball mirrors it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.camera.lens import Array, mirror_normal, pair_normal


def locate_zenith_point(camera: Camera, glints: ArrayLike, share: float) -> Array:
    """Locate points on the line from the image of a ball's centre to where the ball mirrors the zenith.

    The image of a room that is the same in all directions is symmetric about that line.

    Parameters
    ----------
    camera : Camera
        Without a lamp the glints themselves are returned.
    glints : (n, 2) array
        Of the balls, px.
    share : float
        Of the way to the zenith's image.

    Returns
    -------
    (n, 2) array
        px.
    """
    seen = np.asarray(glints, dtype=np.float64)
    if not camera.corrects_glint or seen.size == 0:
        return seen.copy()
    middle = camera.ball_of_glint(seen)
    overhead = np.concatenate([middle[..., :2], np.full_like(middle[..., :1], 1e6)], axis=-1)
    zenith = camera.project(middle + camera.radius * mirror_normal(middle, camera.radius, camera.position, overhead))
    centre = camera.project(middle)
    return np.asarray(centre + share * (zenith - centre), dtype=np.float64)


def locate_secondary_glints(camera: Camera, glints: ArrayLike, others: ArrayLike) -> Array:
    """Locate the lamp in balls as their neighbours mirror it.

    Parameters
    ----------
    camera : Camera
    glints, others : (n, 2) array
        Primary glints of the balls, and of a neighbour of each, px.

    Returns
    -------
    (n, 2) array
        px.

    Raises
    ------
    InputError
        Without a lamp in the camera.
    """
    middle, other = camera.ball_of_glint(glints), camera.ball_of_glint(others)
    normal = pair_normal(middle, other, camera.radius, camera.position, _lamp_position(camera))
    return camera.project(middle + camera.radius * normal)


def secondary_flux_ratio(camera: Camera, glints: ArrayLike, others: ArrayLike) -> Array:
    """Flux (n,) of those secondary glints over that of the primary ones, but for one factor of the balls' reflectance.

    The image of a small lamp is as large as the determinant of its pixel's derivative by the lamp's position. Arguments
    as of `locate_secondary_glints`.
    """
    middle, other = camera.ball_of_glint(glints), camera.ball_of_glint(others)
    lamp = _lamp_position(camera)
    moved = [lamp, *(lamp + 0.03 * lamp[2] * axis for axis in np.eye(3)[:2])]
    areas = []
    for normals in (
        [pair_normal(middle, other, camera.radius, camera.position, light) for light in moved],
        [mirror_normal(middle, camera.radius, camera.position, light) for light in moved],
    ):
        still, by_x, by_y = (camera.project(middle + camera.radius * normal) for normal in normals)
        areas.append(np.abs(np.linalg.det(np.stack([by_x - still, by_y - still], axis=-1))))
    return np.asarray(areas[0] / areas[1], dtype=np.float64)


def _lamp_position(camera: Camera) -> Array:
    if camera.lamp is None:
        raise InputError("camera: lamp is missing, expected its position for the position of a glint")
    return np.array(camera.lamp.position, dtype=np.float64)
