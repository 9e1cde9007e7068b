"""The plate under the lamps: irradiance, gloss, grain, and the discs that cast the shadows of balls on it.

The plate does not move: it is computed once for a film, in double precision.
"""

from collections.abc import Iterator

import numpy as np

from synthcam.camera.lamp import Lamp
from synthcam.camera.pinhole import PinholeCamera
from synthcam.camera.surface import Surface
from synthcam_shared.arrays import Array

BLACK_PLATE_RADIANCE = 0.05  # of the plate under the lamp, over that of the room seen in a ball
SMALL_LAMP_M = 0.03  # radius of a disc below which its shadows are those of a point


def is_plain_plate(lamp: Lamp, surface: Surface) -> bool:
    """Tell whether a small lamp faces down on a dull, even plate without shadows."""
    even = not (surface.plate_gloss or surface.plate_texture or surface.plate_shadow)
    return even and lamp.second is None and lamp.towards is None and lamp.shape == "disc" and lamp.radius < SMALL_LAMP_M


def compute_irradiance(lamp: Lamp, points: Array) -> Array:
    """Irradiance of the plate at points (..., 3), m, over that below the first lamp if it faces down."""
    total = np.zeros(points.shape[:-1])
    factor = lamp.position[2] ** 2 / lamp.cells(np.inf).areas[0]
    for each, position, area in _iterate_parts(lamp):
        way = points - position
        square = (way * way).sum(-1)
        fall = np.maximum(way @ each.axes[:, 2], 0) * -way[..., 2] / square**2
        total += factor * each.radiance * area * fall
    return total


def compute_gloss(lamp: Lamp, surface: Surface, eye: Array, points: Array) -> Array:
    """Compute the gloss of the plate: radiance, over a lamp's own, that its rough mirror reflects to the eye.

    Beckmann's lobe without masking (Beckmann & Spizzichino 1963): reflectance D / (4 cos_in cos_out), times the
    light's cos_in and solid angle.
    """
    total, wide = np.zeros(points.shape[:-1]), 2 * surface.plate_roughness**2
    out = eye - points
    out /= np.linalg.norm(out, axis=-1, keepdims=True)
    for each, position, area in _iterate_parts(lamp):
        way = position - points
        square = (way * way).sum(-1)
        way /= np.sqrt(square)[..., None]
        half = way + out
        up = half[..., 2] / np.linalg.norm(half, axis=-1)
        lobe = np.exp(-(1 / up**2 - 1) / wide) / (np.pi * wide * up**4)
        solid = area * np.maximum(-(way @ each.axes[:, 2]), 0) / square
        total += each.radiance * surface.plate_gloss * lobe / (4 * out[..., 2]) * solid
    return total


def compute_grain(surface: Surface, points: Array) -> Array:
    """Relative brightness (h, w) of the plate's grain at points (h, w, 3); the same grain on every plate.

    It is a sum of 60 waves of random directions, with wavelengths of 1 to 4 plate_grain.
    """
    rng = np.random.default_rng(1)
    out = np.zeros(points.shape[:-1])
    for _ in range(60):
        turn, phase = rng.uniform(0, 2 * np.pi, 2)
        wave = 2 * np.pi / (surface.plate_grain * rng.uniform(1, 4)) * np.array([np.cos(turn), np.sin(turn)])
        out += np.cos(points[..., :2] @ wave + phase)
    return np.asarray(1 + surface.plate_texture * out / np.sqrt(30))


def plate_points(camera: PinholeCamera) -> Array:
    """Find the points (h, w, 3), m, of the plate that the pixels of a rendered picture show at their centres."""
    way = camera.unproject(np.stack(np.meshgrid(*map(np.arange, camera.size)), axis=-1))
    return np.asarray(camera.centre - way * (camera.centre[2] / way[..., 2])[..., None])


def shadow_casters(lamp: Lamp, at: Array) -> Array:
    """Discs (L, 5) of the lamps, which cast shadows near a point (3,), m.

    Each is a position, m, the radius of a disc of equal area, m, and the share of the light.
    """
    found = []
    for each, position, area in _iterate_parts(lamp):
        way = at - position
        fall = max(float(way @ each.axes[:, 2]), 0.0) * -way[2] / (way @ way) ** 2
        found.append([*position, np.sqrt(area / np.pi), each.radiance * area * fall])
    discs = np.array(found)
    discs[:, 4] /= max(discs[:, 4].sum(), 1e-30)
    return discs


def _iterate_parts(lamp: Lamp) -> Iterator[tuple[Lamp, Array, float]]:
    """Lamp, position, m, and area, m^2, of each part that casts its own shadow: small discs, cells of larger lamps."""
    for each in lamp.all:
        cells = each.cells(np.inf if each.shape == "disc" and each.radius < SMALL_LAMP_M else each.half_width / 4)
        for position, area in zip(cells.positions, cells.areas, strict=True):
            yield each, position, area
