"""The outline of each ball in the picture: its box, and the pixels that it covers, the nearer ball in front.

A ball is a sphere. Its outline is exact for a pinhole camera with a lens: the rays that touch the sphere.
"""

import numpy as np
from numpy.typing import NDArray

from synthcam.camera.pinhole import PinholeCamera

Array = NDArray[np.float64]
POINTS_ON_OUTLINE = 128  # a box is then at most 3e-4 of a radius too small


def find_boxes(camera: PinholeCamera, centres: Array, radii: Array) -> Array:
    """Find the boxes (N, 4) round the outlines, px: left, top, right and bottom, cut at the rim of the picture.

    A box out of view has no area. centres: (N, 3), m. radii: (N,), m.
    """
    towards = camera.centre - centres
    distance = np.linalg.norm(towards, axis=1)
    share = radii / distance  # the rays touch the sphere in a circle, which lies nearer to the camera than the centre
    side = np.cross(towards, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side, axis=1)[:, None]
    across = np.cross(side, towards / distance[:, None])
    angles = np.linspace(0, 2 * np.pi, POINTS_ON_OUTLINE, endpoint=False)[:, None]
    ring = np.cos(angles) * side[:, None] + np.sin(angles) * across[:, None]
    middle, radius = centres + towards * share[:, None] ** 2, radii * np.sqrt(1 - share**2)
    pixels = camera.project(middle[:, None] + radius[:, None, None] * ring)
    corner = np.array(camera.size) - 0.5
    return np.concatenate(
        [np.clip(pixels.min(axis=1), -0.5, corner), np.clip(pixels.max(axis=1), -0.5, corner)], axis=1
    )


def label_pixels(
    camera: PinholeCamera, centres: Array, radii: Array, boxes: Array, labels: NDArray[np.uint16]
) -> NDArray[np.uint16]:
    """Label the pixels (height, width) whose centres a ball covers; 0 where there is no ball.

    centres, radii and boxes: as of `find_boxes`. labels: (N,), above 0.
    """
    picture = np.zeros(camera.size[::-1], np.uint16)
    away = centres - camera.centre
    touching = (away**2).sum(axis=1) - radii**2  # square of the length of a ray up to where it touches the sphere
    for k in np.argsort(-touching):  # the farthest first: this order is right for spheres that do not overlap
        left, top = np.ceil(boxes[k, :2]).astype(int)
        right, bottom = np.floor(boxes[k, 2:]).astype(int) + 1
        if left >= right or top >= bottom:
            continue
        rays = camera.unproject(np.stack(np.meshgrid(np.arange(left, right), np.arange(top, bottom)), axis=-1))
        along = rays @ away[k]
        inside = along * np.abs(along) >= touching[k] * (rays**2).sum(axis=-1)
        picture[top:bottom, left:right][inside] = labels[k]
    return picture
