"""View factors in closed form: a lamp's disc cut by a horizon or a ball, and the form factor of a ball.

Light is irradiance over pi, the radiance of a white matte surface. All arguments are arrays that broadcast.
"""

import numpy as np

from synthcam_shared.arrays import Array


def dot(a: Array, b: Array) -> Array:
    """Compute the scalar product of directions, as view factors need it, over the last axis."""
    return np.asarray(np.einsum("...k,...k->...", a, b))


def mean_cosine_above_horizon(cosine: Array, sine: Array) -> Array:
    """Mean cosine of incidence over the part of a lamp's disc above the surface's horizon.

    cosine: of the disc's middle. sine: of its angular radius. A point of the disc has the cosine c + s u, with u of
    density (2/pi) sqrt(1 - u^2).
    """
    x = np.clip(cosine / sine, -1, 1)
    root = np.sqrt(1 - x * x)
    cut = sine * 2 / np.pi * (x * (np.arccos(-x) + x * root) / 2 + root**3 / 3)
    return np.where(cosine > sine, cosine, cut)


def visible_fraction(a: Array, b: Array, apart: Array) -> Array:
    """Compute the share of a disc of angular radius a that one of radius b, `apart` rad off, leaves visible."""
    a, b, apart = np.broadcast_arrays(a, b, apart)
    out = (apart >= b).astype(float)
    edge = np.abs(apart - b) < a
    if edge.any():
        p, q, t = a[edge], b[edge], np.maximum(apart[edge], 1e-12)
        u = np.arccos(np.clip((t * t + p * p - q * q) / (2 * t * p), -1, 1))
        v = np.arccos(np.clip((t * t + q * q - p * p) / (2 * t * q), -1, 1))
        both = p * p * (u - np.sin(u) * np.cos(u)) + q * q * (v - np.sin(v) * np.cos(v))
        out[edge] = 1 - both / (np.pi * p * p)
    small = (b < a) & (apart <= a - b)
    return np.where(small, 1 - (b / a) ** 2, out)


def compute_form_factor(normal: Array, offset: Array, radius: Array | float) -> Array:
    """Form factor of a ball: its share of the surface's hemisphere, weighted by the cosine.

    normal: (..., 3). offset: (..., 3) from the surface to the ball's centre. Source: Howell, A Catalog of Radiation
    Heat Transfer Configuration Factors, section B, differential element to a sphere that its plane may cut.
    """
    far = np.maximum(np.sqrt(dot(offset, offset)), radius * (1 + 1e-9))
    h, cosine = far / radius, np.clip(dot(normal, offset) / far, -1, 1)
    square = h * h
    whole = np.maximum(cosine, 0) / square
    cut = 1 - square * cosine * cosine
    partly = (cut > 0) & (np.abs(cosine) < 1)
    if not partly.any():
        return whole
    h2, c, k = square[partly], cosine[partly], cut[partly]
    reach = np.sqrt(h2 - 1)
    slant = np.clip(-c * reach / np.sqrt(1 - c * c), -1, 1)
    out = whole.copy()
    out[partly] = ((c * np.arccos(slant) - np.sqrt(k) * reach) / h2 + np.arctan(np.sqrt(k) / reach)) / np.pi
    return np.maximum(out, 0)


def mirror_direction(normal: Array, direction: Array) -> tuple[Array, Array]:
    """Compute the direction (..., 3) in which a surface reflects light, and the cosine of its incidence."""
    cosine = -dot(normal, direction)
    return direction + 2 * cosine[..., None] * normal, cosine
