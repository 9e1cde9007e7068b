"""Motions between known instants: cubic Hermite pieces."""

from __future__ import annotations

import numpy as np

from synthcam.dynamics.kinematics import Array


def interpolate_hermite(ends: Array, wide: Array, shares: Array) -> Array:
    """Places (k, n - 1, m, 2) at `shares` (m,) of the pieces between (x, y, vx, vy) (k, n, 4); wide: s, (k, n - 1)."""
    s, h = shares[:, None], wide[..., None, None]
    a, b = ends[:, :-1, None], ends[:, 1:, None]
    left = (1 - s) ** 2 * ((1 + 2 * s) * a[..., :2] + s * h * a[..., 2:])
    return np.asarray(left + s**2 * ((3 - 2 * s) * b[..., :2] + (s - 1) * h * b[..., 2:]))
