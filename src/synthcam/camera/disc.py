"""Flat discs that lie on a plate: their outline, the points that rays meet, and the light that they hide.

A disc is an upright cylinder. Its upper edge is rounded for the light; the outline is that of the sharp edge. Lengths
are in m. A centre is that of the cylinder.
"""

from dataclasses import dataclass

import numpy as np

from synthcam_shared.arrays import Array, list_gauss_nodes


@dataclass(frozen=True)
class Disc:
    """The shape of a disc."""

    radius: float
    height: float

    @property
    def bevel(self) -> float:
        """Radius of the rounded upper edge."""
        return min(0.2 * self.height, 0.1 * self.radius)

    def find_miss(self, start: Array, ways: Array, centre: Array) -> tuple[Array, Array]:
        """Find the least distance (...) of rays from the disc's axis, level with the disc, and its place on the ray.

        start: (3,) or (..., 3). ways: directions (..., 3); the place is in their lengths.
        """
        offset = start - centre
        down = np.where(np.abs(ways[..., 2]) < 1e-9, 1e-9, ways[..., 2])
        ends = [(side * self.height / 2 - offset[..., 2]) / down for side in (-1, 1)]
        first, last = (np.maximum(order(*ends), 0) for order in (np.minimum, np.maximum))
        u, v = ways[..., 0], ways[..., 1]
        nearest = -(offset[..., 0] * u + offset[..., 1] * v) / np.maximum(u * u + v * v, 1e-18)
        nearest = np.minimum(np.maximum(nearest, first), last)
        x, y = offset[..., 0] + nearest * u, offset[..., 1] + nearest * v
        return np.sqrt(x * x + y * y), nearest

    def meet(self, eye: Array, ways: Array, centre: Array) -> tuple[Array, Array]:
        """Find where rays from above meet the disc: points (..., 3) on its surface, and their distances from the eye.

        A ray that misses it gets the nearest point of its rim.
        """
        offset, (u, v, w) = eye - centre, (ways[..., k] for k in range(3))
        top, bottom = ((side * self.height / 2 - offset[2]) / w for side in (1, -1))
        along, square = u * offset[0] + v * offset[1], np.maximum(u * u + v * v, 1e-18)
        root = np.sqrt(np.maximum(along**2 - square * (offset[:2] @ offset[:2] - self.radius**2), 0))
        over = (offset[0] + top * u) ** 2 + (offset[1] + top * v) ** 2 <= self.radius**2
        far = np.where(over, top, np.minimum(np.maximum((-along - root) / square, top), bottom))
        x, y, z = offset[0] + far * u, offset[1] + far * v, offset[2] + far * w
        shrink = np.where(over, 1, self.radius / np.sqrt(np.maximum(x * x + y * y, 1e-24)))
        return centre + np.stack([shrink * x, shrink * y, z], axis=-1), far

    def find_normals(self, points: Array, centre: Array) -> Array:
        """Find the unit normals (n, 3) at points of the surface."""
        out = points - centre
        rim = np.hypot(out[:, 0], out[:, 1])
        lean = np.clip((rim - self.radius + self.bevel) / self.bevel, 0, 1)
        lean = np.where(out[:, 2] > self.height / 2 * (1 - 1e-6), 0.95 * lean, 1)
        side = out[:, :2] * (lean / np.maximum(rim, 1e-12))[:, None]
        return np.column_stack([side, np.sqrt(np.maximum(1 - lean**2, 0))])

    def find_visible_share(self, points: Array, ways: Array, wide: Array, centre: Array, soft: float = 0.0) -> Array:
        """Find the share (n,) of a lamp that the disc leaves visible from points, as behind a straight edge.

        ways: unit directions (n, 3) to the lamp.
        wide: its angular radius (n,).
        soft: rms blur of the edge.
        """
        miss, far = self.find_miss(points, ways, centre)
        penumbra = np.maximum(np.hypot(wide * far, 2 * soft), 1e-9)
        u = np.clip((miss - self.radius) / penumbra, -1, 1)
        above = points[:, 2] >= centre[2] + self.height / 2 * (1 - 1e-6)
        return np.where(above, 1.0, 0.5 + (u * np.sqrt(1 - u * u) + np.arcsin(u)) / np.pi)

    def hide_sky(self, distances: Array) -> Array:
        """Find the form factor (n,) of the disc for the plate at these distances from its axis: half at its foot."""
        nodes, weights = list_gauss_nodes(12)
        grid = 1 + np.linspace(0, 1, 257) ** 2 * (max(float(distances.max(initial=0)) / self.radius, 1.001) - 1)
        widest = np.arcsin(1 / grid)[:, None]
        angle = widest * (nodes + 1) / 2
        near = grid[:, None] * np.cos(angle) - np.sqrt(np.maximum(1 - (grid[:, None] * np.sin(angle)) ** 2, 0))
        tall = (self.height / self.radius) ** 2
        factors = (widest / (2 * np.pi) * tall / (tall + near**2)) @ weights
        return np.interp(distances / self.radius, grid, factors)


def measure_shares_covered_by_body(miss: Array, radius: float) -> Array:
    """Measure the share of each sample that a body covers, from the distances (h, w) of its rays from the axis."""
    down, across = np.gradient(miss)
    share = np.clip((radius - miss) / np.maximum(np.hypot(down, across), 1e-12) + 0.5, 0, 1)
    return np.where(miss < 0.5 * radius, 1.0, share)


def list_discs(radii: Array, heights: Array) -> list[Disc | None]:
    """List the disc of each body; None of balls, whose height is 0."""
    return [Disc(r, h) if h else None for r, h in zip(radii.tolist(), heights.tolist(), strict=True)]
