"""The outline of each ball in the picture: its box, and the pixels that it covers, the nearer ball in front.

A ball is a sphere, a disc an upright cylinder. Outlines are exact for a pinhole camera with a lens: the rays that touch
the body.
"""

import pickle
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from synthcam.camera.disc import list_discs
from synthcam.camera.pinhole import PinholeCamera
from synthcam_shared.arrays import Array


def find_boxes(camera: PinholeCamera, centres: Array, radii: Array, heights: Array | None = None) -> Array:
    """Find the boxes (N, 4) round the outlines, px: left, top, right and bottom, cut at the rim of the picture.

    The farthest points of an outline follow from the map's slope at its middle. That is right to second order in the
    size of the ball. A box out of view has no area.

    centres: (N, 3), m.
    radii: (N,), m.
    heights: of discs (N,), m, and 0 of balls; None of balls alone.
    """
    towards = camera.centre - centres
    distance = np.linalg.norm(towards, axis=1)
    share = radii / distance  # the rays touch the sphere in a circle, which lies nearer to the camera than the centre
    side = np.cross(towards, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side, axis=1)[:, None]
    across = np.cross(side, towards / distance[:, None])
    middle, radius = centres + towards * share[:, None] ** 2, radii * np.sqrt(1 - share**2)
    boxes = _bound_circles(camera, middle, radius, side, across)
    if heights is not None and heights.any():  # the box of a disc is that of its two rims
        flat = heights > 0
        x, y = np.broadcast_to(np.eye(3)[:2, None], (2, int(flat.sum()), 3))
        lift = heights[flat, None] / 2 * np.array([0, 0, 1.0])
        rims = [_bound_circles(camera, centres[flat] + sign * lift, radii[flat], x, y) for sign in (-1, 1)]
        boxes[flat] = np.concatenate([np.minimum(*rims)[:, :2], np.maximum(*rims)[:, 2:]], axis=1)
    return boxes


def _bound_circles(camera: PinholeCamera, middle: Array, radius: Array, side: Array, across: Array) -> Array:
    """Find the boxes (N, 4) round circles in the planes of two unit vectors (N, 3) each."""
    _, slope = camera.project_with_slope(middle)
    angle = np.arctan2(*(np.einsum("nij,nj->ni", slope, along) for along in (across, side)))  # (N, 2), largest x and y
    ring = np.cos(angle)[..., None] * side[:, None] + np.sin(angle)[..., None] * across[:, None]
    signs = np.array([-1.0, 1.0])[:, None, None, None]
    ends = camera.project(middle[:, None] + signs * radius[:, None, None] * ring)  # (2, N, 2, 2)
    extremes = np.einsum("snii->sni", ends)  # x of the one, y of the other
    low, high = np.clip(np.sort(extremes, axis=0), -0.5, np.array(camera.size) - 0.5)
    return np.concatenate([low, high], axis=1)


def label_pixels(
    camera: PinholeCamera,
    centres: Array,
    radii: Array,
    boxes: Array,
    labels: NDArray[np.uint16],
    heights: Array | None = None,
) -> NDArray[np.uint16]:
    """Label the pixels (height, width) whose centres a ball covers; 0 where there is no ball.

    centres, radii, boxes and heights: as of `find_boxes`. labels: (N,), above 0.
    """
    discs = list_discs(radii, np.zeros(len(radii)) if heights is None else heights)
    picture = np.zeros(camera.size[::-1], np.uint16)
    away = centres - camera.centre
    touching = (away**2).sum(axis=1) - radii**2  # square of the length of a ray up to where it touches the sphere
    table = _trace_all_pixels(pickle.dumps(replace(camera, camera_json={}))) if camera.dist.any() else None
    order = touching  # right for spheres that do not overlap
    if any(discs):  # bodies that stand beside each other: the same of circles about their feet
        order = (away[:, :2] ** 2).sum(axis=1) - radii**2
    for k in np.argsort(-order):  # the farthest first
        left, top = np.ceil(boxes[k, :2]).astype(int)
        right, bottom = np.floor(boxes[k, 2:]).astype(int) + 1
        if left >= right or top >= bottom:
            continue
        if table is None:
            rays = camera.unproject(_list_pixels(left, right, top, bottom))
        else:
            rays = table[top:bottom, left:right]
        if disc := discs[k]:
            miss, _ = disc.find_miss(camera.centre, rays, centres[k])
            picture[top:bottom, left:right][miss <= disc.radius] = labels[k]
            continue
        along = rays @ away[k]
        inside = along * np.abs(along) >= touching[k] * (rays**2).sum(axis=-1)
        picture[top:bottom, left:right][inside] = labels[k]
    return picture


def _list_pixels(left: int, right: int, top: int, bottom: int) -> Array:
    return np.stack(np.meshgrid(np.arange(left, right), np.arange(top, bottom)), axis=-1).astype(float)


@lru_cache(maxsize=1)
def _trace_all_pixels(camera: bytes) -> Array:
    """The rays (height, width, 3) of all pixels of a pickled camera: to undo a lens takes a microsecond for each."""
    read: PinholeCamera = pickle.loads(camera)
    return read.unproject(_list_pixels(0, read.size[0], 0, read.size[1]))
