"""Reflection of a lamp at one or two spheres, and OpenCV's lens distortion with its inverse."""

import numpy as np

from synthcam_shared.arrays import Array


def find_mirror_normal(
    centres: Array, radius: float, eye: Array, light: Array, start: Array | None = None, steps: int = 20
) -> Array:
    """Unit normals (n, 3) of spheres (n, 3) at which an eye sees a point of light.

    The normal halves the angle between the directions to light and eye. It is iterated from upright or from `start`, in
    so many steps at most, because these directions start on the surface.
    """
    normal = np.broadcast_to([0.0, 0.0, 1.0], centres.shape) if start is None else start
    for _ in range(steps):
        point = centres + radius * normal
        fresh = _unit(_unit(eye - point) + _unit(light - point))
        change = float(np.max(np.abs(fresh - normal), initial=0.0))
        normal = fresh
        if change < 1e-13:
            break
    return normal


def distort(straight: Array, dist: Array) -> tuple[Array, Array]:
    """OpenCV's lens model on normalised coordinates (..., 2): bent ones, and d bent / d straight (..., 2, 2)."""
    if not dist.any():
        return straight, np.broadcast_to(np.eye(2), (*straight.shape, 2))
    k1, k2, p1, p2, k3 = dist
    x, y = straight[..., 0], straight[..., 1]
    q = x * x + y * y
    radial = 1 + q * (k1 + q * (k2 + q * k3))
    slope = k1 + q * (2 * k2 + q * 3 * k3)  # d radial / d q
    bent_x = x * radial + 2 * p1 * x * y + p2 * (q + 2 * x * x)
    bent_y = y * radial + p1 * (q + 2 * y * y) + 2 * p2 * x * y
    across = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    down = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    cross = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    jacobian = np.stack([across, cross, cross, down], axis=-1).reshape(*straight.shape, 2)
    return np.stack([bent_x, bent_y], axis=-1), jacobian


def undistort(bent: Array, dist: Array) -> tuple[Array, Array]:
    """Inverse of ``distort`` by Newton's method; the Jacobian is still d bent / d straight."""
    straight = bent.copy()
    if not dist.any():
        return distort(straight, dist)
    for _ in range(30):
        image, jacobian = distort(straight, dist)
        miss = bent - image
        if np.max(np.abs(miss), initial=0.0) < 1e-15:
            return straight, jacobian
        straight = straight + np.linalg.solve(jacobian, miss[..., None])[..., 0]
    return straight, distort(straight, dist)[1]


def _unit(vectors: Array) -> Array:
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.asarray(vectors / np.sqrt(x * x + y * y + z * z)[..., None], dtype=np.float64)


def find_secondary_mirror_normal(centres: Array, others: Array, radius: float, eye: Array, light: Array) -> Array:
    """Unit normals (n, 3) of spheres (n, 3) at which an eye sees a light after a reflection at the spheres ``others``.

    Both reflections halve their angles; steps are damped, for close spheres turn each other's rays strongly.
    """
    along = _unit(others - centres)
    up = np.array([0.0, 0.0, 1.0])
    normal, other = _unit(up + along), _unit(up - along)
    for _ in range(80):
        point, from_ = centres + radius * normal, others + radius * other
        way = _unit(from_ - point)
        fresh = _unit(_unit(eye - point) + way)
        fresh_other = _unit(_unit(light - from_) - way)
        change = float(np.max(np.abs(fresh - normal), initial=0.0))
        normal, other = _unit(normal + 0.5 * (fresh - normal)), _unit(other + 0.5 * (fresh_other - other))
        if change < 1e-5:  # of the radius, 1e-4 px
            break
    return normal
