"""The picture of a camera by plain float64 rays and quadrature: the judge of `benchmarks.camera.camera`. Draws nothing.

A lamp's image is the region of the picture whose rays end on the lamp. Its edge is found along 128 directions by
bisection, and area, reflectance and moments are integrated inside it by Gauss and the trapezoidal rule.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve
from scipy.special import ndtr

from synthcam.camera.lamp import Lamp
from synthcam.camera.pinhole import PinholeCamera

Array = NDArray[np.float64]
Ints = NDArray[np.intp]
Radii = Sequence[float] | Array

DIRECTIONS, NODES = 128, 12
FINE = 24  # cells a pixel, each way, of an outline's area


def trace(
    camera: PinholeCamera, centres: Array, radii: Radii, pixels: Array, most: int
) -> tuple[Array, Array, Array, Ints, Ints]:
    """Rays through pixels (M, 2): last points and ways (M, 3), reflectance kept, bounces, the first ball or -1."""
    flat = cv2.undistortPoints(
        pixels.reshape(-1, 1, 2), camera.K, camera.dist, criteria=(cv2.TERM_CRITERIA_MAX_ITER, 100, 0)
    ).reshape(-1, 2)
    way = np.c_[flat, np.ones(len(flat))] @ camera.R
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    point = np.tile(-camera.R.T @ camera.t, (len(way), 1))
    kept, last, bounces = np.ones(len(way)), np.full(len(way), -1), np.zeros(len(way), int)
    first = np.full(len(way), -1)
    for turn in range(most):
        nearest, ball = np.full(len(way), np.inf), np.full(len(way), -1)
        for k, (centre, radius) in enumerate(zip(centres, radii, strict=True)):
            offset = point - centre
            b, c = (offset * way).sum(1), (offset * offset).sum(1) - radius**2
            root = b * b - c
            far = np.where((root > 0) & (b < 0) & (last != k), -b - np.sqrt(np.maximum(root, 0)), np.inf)
            ball, nearest = np.where(far < nearest, k, ball), np.minimum(far, nearest)
        hit = ball >= 0
        point[hit] += nearest[hit, None] * way[hit]
        normal = (point - centres[ball]) / np.asarray(radii)[ball, None]
        cosine = -(way * normal).sum(1)
        kept = np.where(hit, kept * (0.55 + 0.45 * (1 - cosine) ** 5), kept)
        way = np.where(hit[:, None], way + 2 * cosine[:, None] * normal, way)
        bounces, last = bounces + hit, np.where(hit, ball, -2)
        first = first if turn else ball
    return point, way, kept, bounces, first


def missed(
    camera: PinholeCamera, lamp: Lamp, centres: Array, radii: Radii, pixels: Array, order: int
) -> tuple[Array, Array]:
    """How far (M, 2), m, rays pass the lamp's middle in its plane, and reflectance kept; NaN unless `order` bounces."""
    point, way, kept, bounces, _ = trace(camera, centres, radii, pixels, order + 1)
    way = np.where(((bounces == order) & (way[:, 2] > 0))[:, None], way, np.nan)
    over = point + ((lamp.position[2] - point[:, 2]) / way[:, 2])[:, None] * way
    return (over - lamp.position)[:, :2], kept


def lamp_image(
    camera: PinholeCamera, lamp: Lamp, centres: Array, radii: Radii, start: Array, order: int
) -> tuple[Array, float, Array]:
    """Place (2,) px, flux px^2 and variances (2,) px^2 of the lamp's image of that order next to the pixel `start`."""
    middle = np.array(start, float)
    for _ in range(20):
        step = 1e-6
        around = middle + step * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
        gap, _ = missed(camera, lamp, centres, radii, around, order)
        slope = np.stack([gap[1] - gap[2], gap[3] - gap[4]], axis=1) / (2 * step)
        move = np.linalg.solve(slope, -gap[0])
        middle = middle + move
        if np.abs(move).max() < 1e-10:
            break
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    low = np.zeros(DIRECTIONS)
    high = 1.5 * lamp.radius / np.linalg.svd(slope, compute_uv=False).min() * np.ones(DIRECTIONS)
    for _ in range(46):
        half = (low + high) / 2
        gap, _ = missed(camera, lamp, centres, radii, middle + half[:, None] * rays, order)
        inside = np.nan_to_num(np.linalg.norm(gap, axis=1), nan=np.inf) < lamp.radius
        low, high = np.where(inside, half, low), np.where(inside, high, half)
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    share = (nodes + 1) / 2
    at = middle + (low[:, None] * share)[..., None] * rays[:, None]
    _, kept = missed(camera, lamp, centres, radii, at.reshape(-1, 2), order)
    weight = kept.reshape(at.shape[:2]) * weights / 2 * share * (low**2)[:, None] * (2 * np.pi / DIRECTIONS)
    flux = weight.sum()
    position = (weight[..., None] * at).sum((0, 1)) / flux
    return position, flux, (weight[..., None] * (at - position) ** 2).sum((0, 1)) / flux


def spot(camera: PinholeCamera, shape: tuple[int, ...], position: Array, flux: float, variance: Array) -> Array:
    """A spot (h, w) through the optics' Gaussian and square pixels."""
    sides = []
    for axis, count in ((1, shape[0]), (0, shape[1])):
        edges = np.arange(count + 1) - 0.5
        sides.append(np.diff(ndtr((edges - position[axis]) / np.sqrt(variance[axis] + camera.psf_sigma_px**2))))
    return np.asarray(flux * np.outer(*sides))


def separate(image: Array, spots: Sequence[Array], positions: Array) -> Array:
    """Offsets (n, 2) px of overlapping spots (n, h, w), by least squares."""
    columns: list[Array] = []
    for spot in spots:
        down, across = (np.asarray(slope) for slope in np.gradient(spot))
        columns += [spot, -across, -down]
    used = np.zeros(image.shape, bool)
    for x, y in np.round(positions).astype(int):
        used[max(y - 6, 0) : y + 7, max(x - 6, 0) : x + 7] = True
    shapes: Array = np.stack([c[used] for c in columns], axis=1)
    found = np.linalg.lstsq(shapes, image[used], rcond=None)[0].reshape(-1, 3)
    return np.asarray(found[:, 1:] / found[:, :1], dtype=float)


def window(camera: PinholeCamera, centres: Array) -> tuple[Ints, Ints]:
    """First and last (column, row) of a box around balls (N, 3) and their blur."""
    at, half = camera.project(centres), 1.3 * centres[0, 2] / camera.scale + 8
    return np.floor(at.min(axis=0) - half).astype(int), np.ceil(at.max(axis=0) + half).astype(int)


def hidden(camera: PinholeCamera, centres: Array, radius: float, low: Ints, high: Ints, defocus: float = 0.0) -> Array:
    """Share (h, w) of the plate that balls (N, 3) hide in the box `low` to `high`.

    The outline is a polygon of 720 corners; Gaussian, pixel and disc are applied to its exact area in cells of
    1/FINE px. Balls may touch in the picture but not overlap.
    """
    size, lines = high - low, 8
    area = np.zeros(size[::-1] * FINE)
    heights = (np.arange(size[1] * FINE * lines) + 0.5) / (FINE * lines) - 0.5 + low[1]
    cells = np.arange(size[0] * FINE + 1) / FINE - 0.5 + low[0]
    for centre in centres:
        left, right = _chords(_corners(camera, centre, radius), heights)
        length = np.clip(np.minimum(right[:, None], cells[1:]) - np.maximum(left[:, None], cells[:-1]), 0, None) * FINE
        area += length.reshape(size[1] * FINE, lines, -1).mean(axis=1)
    return blurred(np.minimum(area, 1), camera.psf_sigma_px, defocus)


def lit(camera: PinholeCamera, centres: Array, radii: Radii, dark: Array, room: float, box: tuple[Ints, Ints]) -> Array:
    """Light (h, w) of balls in a dim room less that of the plate behind them, in a box from (column, row) on.

    By 16 x 16 rays a pixel, four bounces; dark: (N,) the plate's radiance under each ball.
    """
    (low, high), fine = box, 16
    size = high - low
    x, y = ((np.arange(n * fine) + 0.5) / fine - 0.5 + start for n, start in zip(size, low, strict=True))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    _, way, kept, bounces, first = trace(camera, centres, radii, grid, 4)
    plate = np.asarray(dark)[np.maximum(first, 0)]
    light = kept * (plate + (room / 0.55 - plate) * np.maximum(way[:, 2], 0)) - plate
    return blurred(np.where(bounces > 0, light, 0).reshape(size[::-1] * fine), camera.psf_sigma_px, fine=fine)


def blurred(cells: Array, sigma: float, defocus: float = 0.0, fine: int = FINE) -> Array:
    """Cells of 1/fine px through the Gaussian, the square pixel and, summed in real space, the disc of defocus."""
    if defocus:
        side = np.arange(-np.ceil(defocus * fine) - 1, np.ceil(defocus * fine) + 2)
        part = (np.arange(8) + 0.5) / 8 - 0.5
        inside = np.hypot(*np.meshgrid(*[(side[:, None] + part).ravel() / fine] * 2)) < defocus
        disc = inside.reshape(len(side), 8, len(side), 8).mean(axis=(1, 3))
        cells = fftconvolve(cells, disc / disc.sum(), mode="same")
    kernels = []
    for count in cells.shape:
        at = (np.arange(count) + 0.5) / fine - 0.5
        edges = np.arange(count // fine + 1)[:, None] - 0.5
        kernels.append(np.diff(ndtr((edges - at) / sigma), axis=0) / fine)
    return np.asarray(kernels[0] @ cells @ kernels[1].T)


def displaced(drawn: Array, true: Array, where: Any = True) -> Array:
    """Offsets (n,) px, towards the brighter side, of a drawn edge from the true one, where that is steep."""
    down, across = np.gradient(true)
    steep = np.hypot(down, across) * where
    on = steep > 0.6 * steep.max()
    return np.asarray((drawn - true)[on] / steep[on])


def _corners(camera: PinholeCamera, centre: Array, radius: float) -> Array:
    eye = camera.centre - centre
    far = np.linalg.norm(eye)
    axis = eye / far
    side = np.cross(axis, [0, 1, 0])
    side /= np.linalg.norm(side)
    turn = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    ring = radius**2 / far * axis + radius * np.sqrt(1 - (radius / far) ** 2) * (
        np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(axis, side)
    )
    return camera.project(centre + ring)


def _chords(corners: Array, heights: Array) -> tuple[Array, Array]:
    """Left and right ends of a convex outline at heights; an empty chord has its ends swapped."""
    left, right = np.full(len(heights), np.inf), np.full(len(heights), -np.inf)
    for (xa, ya), (xb, yb) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        inside = (heights >= min(ya, yb)) & (heights < max(ya, yb))
        if ya == yb or not inside.any():
            continue
        x = xa + (heights[inside] - ya) / (yb - ya) * (xb - xa)
        left[inside], right[inside] = np.minimum(left[inside], x), np.maximum(right[inside], x)
    return left, right
