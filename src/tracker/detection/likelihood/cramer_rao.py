"""The pixel model of a glint, the information of a pixel, and the Cramer-Rao bound of a position.

A glint is a Gaussian of width sigma, integrated over each pixel and along the line of the ball's motion during the
exposure. Fisher information: F_ab = sum_i J(m_i) d_a m_i d_b m_i over the pixels, with m_i their means. This is section
3.9 of Kay (1993), with a variance that follows the mean. Clipped pixels enter by their censored likelihood.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_ndtr, ndtr

from synthcam_shared.arrays import Array, list_gauss_nodes
from tracker.camera.camera import Camera
from tracker.camera.sensor import SensorSpec

ROOT_TWO_PI = math.sqrt(2.0 * math.pi)


@dataclass(frozen=True)
class GlintShape:
    """Unit-flux glints on (n, rows, columns) pixels, and their derivatives by position, 1/px."""

    value: Array
    by_x: Array
    by_y: Array


def compute_glint_shape(xy: Array, blurs: Array, sigma: float, half: int) -> GlintShape:
    """Compute the pixel model of glints of unit flux: Gaussians integrated over the pixels of square windows.

    xy, blurs: (n, 2), middles of the glints, px from the windows' central pixel, and their displacements during the
    exposure, px. sigma: width of a glint at rest, px. Windows are 2 half + 1 pixels wide.
    """
    # Gauss-Legendre nodes (n, k, 2), px, along the lines of motion, and their weights (k,)
    longest = float(np.max(np.hypot(blurs[:, 0], blurs[:, 1]), initial=0.0))
    nodes, weights = list_gauss_nodes(1 if longest < 0.02 * sigma else 2 + math.ceil(0.8 * longest / sigma))
    offsets, weights = 0.5 * nodes[:, None] * blurs[:, None, :], weights / 2.0
    edges = np.arange(-half, half + 2) - 0.5
    u = (edges - (xy[:, None, :] + offsets)[..., None]) / sigma  # (n, k, axis, edge)
    below, height = ndtr(u), np.exp(-0.5 * u * u)
    step = below[..., 1:] - below[..., :-1]
    slope = (height[..., :-1] - height[..., 1:]) / (ROOT_TWO_PI * sigma)
    col, col_slope = step[:, :, 0], slope[:, :, 0]
    row, row_slope = ((part[:, :, 1] * weights[:, None]).transpose(0, 2, 1) for part in (step, slope))
    if len(weights) == 1:
        return GlintShape(row * col, row * col_slope, row_slope * col)
    return GlintShape(row @ col, row @ col_slope, row_slope @ col)


def pixel_noise(mean: Array, sensor: SensorSpec) -> tuple[Array, Array]:
    """Compute the noise in the pixel model: variance of pixels at their means, counts^2, and k = v'/(2v), 1/counts."""
    variance = sensor.variance(mean)
    return variance, sensor.variance_slope(mean) / (2.0 * variance)


def compute_pixel_information(mean: Array, sensor: SensorSpec, noise: tuple[Array, Array] | None = None) -> Array:
    """Fisher information of one pixel on its own mean, 1/counts^2, any shape; clipping included.

    For an open pixel it is 1/v + (v'/v)^2 / 2. A pixel at the ceiling c is known to exceed c - 1/2. Its information is
    the integral of the squared score up to there, and the term of the tail beyond. `noise` is `pixel_noise` there.
    """
    clear = 6.0  # standard deviations below the ceiling, from which on it does not matter
    variance, k = pixel_noise(mean, sensor) if noise is None else noise
    info = np.asarray(1.0 / variance + 2.0 * k * k, dtype=np.float64)
    room = sensor.ceiling - 0.5 - mean
    if np.min(room, initial=np.inf) < clear * math.sqrt(np.max(variance, initial=0.0)):
        z = room / np.sqrt(variance)
        near = z < clear
        info[near] = _censored_information(z[near], 1.0 / np.sqrt(variance[near]), k[near])
    return info


def _censored_information(z: Array, root: Array, k: Array) -> Array:
    """Information with a ceiling z standard deviations above the mean; below it score = root u + k (u^2 - 1)."""
    low = ndtr(z)
    phi = np.exp(-0.5 * z * z) / ROOT_TWO_PI
    one, two, three = -phi, low - z * phi, -(z * z + 2) * phi
    four = 3 * low - (z**3 + 3 * z) * phi
    open_part = root**2 * two + 2 * root * k * (three - one) + k * k * (four - 2 * two + low)
    hazard = np.exp(-0.5 * z * z - log_ndtr(-z)) / ROOT_TWO_PI
    return np.asarray(open_part + phi * hazard * (root + k * z) ** 2, dtype=np.float64)


def differentiate_pixels(shape: GlintShape, flux: Array) -> Array:
    """Compute the derivatives (n, 4, h, w) of the pixel model by x, y, log flux and background."""
    grown = flux[:, None, None]
    return np.stack([grown * shape.by_x, grown * shape.by_y, grown * shape.value, np.ones_like(shape.value)], 1)


def compute_fisher_information(weight: Array, parts: Array) -> Array:
    """(n, p, p) information on p parameters from the pixels' own (n, h, w) and derivatives (n, p, h, w)."""
    flat = parts.reshape(*parts.shape[:2], -1)
    return np.asarray((flat * weight.reshape(len(parts), 1, -1)) @ flat.transpose(0, 2, 1), dtype=np.float64)


def localisation_bound(
    camera: Camera, flux: ArrayLike, xy: ArrayLike, blur: ArrayLike | None = None, background: ArrayLike | None = None
) -> Array:
    """Cramer-Rao bound (n, 2, 2), px^2, of the positions of glints, with free flux and flat background.

    flux: (n,) counts.
    xy, blur: positions and displacements during the exposure, (n, 2) px.
    background: counts; default: the black level.

    Raises ValueError for a camera without a width of the PSF.
    """
    return _bound(camera, flux, xy, blur, background)[0]


def localisation_bound_fixed(camera: Camera, flux: ArrayLike, xy: ArrayLike) -> Array:
    """The part (n, 2, 2), px^2, of a resting glint's bound that is the same in every frame.

    It comes from the pixels' own response and offset: a fixed error of a pixel shifts the position by cov d_a m / v.
    The arguments are those of `localisation_bound`.
    """
    return _bound(camera, flux, xy, None, None)[1]


def _bound(
    camera: Camera, flux: ArrayLike, xy: ArrayLike, blur: ArrayLike | None, background: ArrayLike | None
) -> tuple[Array, Array]:
    """Bound and its fixed part, (n, 2, 2) px^2 each."""
    if camera.sigma is None:
        raise ValueError("the bound needs psf.sigma_px")
    flux_ = np.atleast_1d(np.asarray(flux, dtype=np.float64))
    positions = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
    lines = np.zeros_like(positions) if blur is None else np.asarray(blur, dtype=np.float64).reshape(-1, 2)
    level = camera.sensor.black_level if background is None else background
    ground = np.broadcast_to(np.asarray(level, dtype=np.float64), flux_.shape)
    half = math.ceil(4.0 * camera.sigma + 0.5 + float(np.max(np.abs(lines), initial=0.0)) / 2.0)
    out, fixed = np.empty((2, len(flux_), 2, 2))
    for start in range(0, len(flux_), 2048):  # blocks, so that memory stays small
        part = slice(start, start + 2048)
        shape = compute_glint_shape(positions[part] - np.round(positions[part]), lines[part], camera.sigma, half)
        mean = ground[part, None, None] + flux_[part, None, None] * shape.value
        info, parts = compute_pixel_information(mean, camera.sensor), differentiate_pixels(shape, flux_[part])
        cov = np.linalg.inv(compute_fisher_information(info, parts))
        pattern = cov @ compute_fisher_information(info**2 * camera.sensor.fixed_pattern_variance(mean), parts) @ cov
        out[part], fixed[part] = cov[:, :2, :2], pattern[:, :2, :2]
    return out, fixed
