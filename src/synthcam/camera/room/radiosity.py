"""Light thrown to and fro between one ball and the plate it rests on, by radiosity, as tables.

Lengths are in radii of the ball, from where it touches the plate. Light is irradiance over pi; one is that of the plate
without balls. A neighbour's part is not in the tables.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthcam.camera.room.view_factors import dot, form_factor, mean_cosine_above_horizon, visible_fraction

Array = NDArray[np.float64]

RINGS, SECTORS, FAR = 48, 32, 200.0  # of the plate, and how far out
BELTS = 24  # of the ball
BOUNCES = 6
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class LightSource:
    """A piece of a lamp seen from n places: unit ways (n, 3), angular radii (n,), rad, light (n,) on a plate."""

    way: Array
    wide: Array
    light: Array


@dataclass(frozen=True)
class ReflectionTable:
    """Values (n, SECTORS, c) at the middles of n cells of a coordinate from 0 to 1 and of an angle about z."""

    values: Array

    def at(self, height: Array, angle: Array) -> Array:
        n, m = self.values.shape[:2]
        row = np.clip(height * n - 0.5, 0, n - 1)
        column = angle / (2 * np.pi) * m - 0.5
        i, j = np.minimum(row.astype(int), n - 2), np.floor(column).astype(int)
        u, v = (row - i)[..., None], (column - j)[..., None]
        j, k = j % m, (j + 1) % m
        low = (1 - v) * self.values[i, j] + v * self.values[i, k]
        return np.asarray((1 - u) * low + u * ((1 - v) * self.values[i + 1, j] + v * self.values[i + 1, k]))


@dataclass(frozen=True)
class PlateExchange:
    """below: light that a ball gets from the plate, over (1 + n_z)/2. glow: light that the plate gets from it, over
    r/(1 + r)."""

    below: ReflectionTable
    glow: ReflectionTable

    def on_ball(self, normals: Array) -> Array:
        return self.below.at((1 + normals[..., 2]) / 2, np.arctan2(normals[..., 1], normals[..., 0]))

    def on_plate(self, offsets: Array) -> Array:
        """offsets (..., 2) from the point of contact, radii."""
        r = np.hypot(offsets[..., 0], offsets[..., 1])
        return self.glow.at(r / (1 + r), np.arctan2(offsets[..., 1], offsets[..., 0]))


def solve_plate_exchange(
    sources: Callable[[Array], list[LightSource]], ambient: float, ball: Array, plate: Array
) -> PlateExchange:
    """The tables of a ball and a plate of mean reflectances (c,) under lamps and an even sky.

    sources: of points (n, 3) on the plate, the lamps there.
    """
    turn = (np.arange(SECTORS) + 0.5) / SECTORS * 2 * np.pi
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    up = (np.arange(BELTS) + 0.5) / BELTS * 2 - 1
    normals = np.concatenate(
        [np.sqrt(1 - up * up)[:, None, None] * ring, np.broadcast_to(up[:, None, None], (BELTS, SECTORS, 1))], axis=-1
    ).reshape(-1, 3)
    edges = np.arange(RINGS + 1) / RINGS * FAR / (1 + FAR)
    edges, middle = edges / (1 - edges), (edges[1:] + edges[:-1]) / 2
    middle = middle / (1 - middle)
    spots = np.pad((middle[:, None, None] * ring).reshape(-1, 2), ((0, 0), (0, 1)))
    areas = np.repeat(np.pi * np.diff(edges**2) / SECTORS, SECTORS)
    to_plate, to_ball = _exchange(normals, spots, areas)

    to_centre = UP - spots
    far = np.sqrt(dot(to_centre, to_centre))
    on_plate = np.full((len(spots), 1), ambient) * (1 - to_ball.sum(1, keepdims=True))
    on_ball = ambient * (1 + normals[:, 2:]) / 2
    for source in sources(spots):
        apart = np.arccos(np.clip(dot(to_centre, source.way) / far, -1, 1))
        on_plate[:, 0] += source.light * visible_fraction(source.wide, np.arcsin(1 / far), apart)
    for source in sources(np.zeros((1, 3))):
        seen = mean_cosine_above_horizon(normals @ source.way[0], np.sin(source.wide))
        on_ball[:, 0] += source.light * seen / source.way[0, 2]
    below, glow = np.zeros((len(normals), len(ball))), np.zeros((len(spots), len(ball)))
    for _ in range(BOUNCES):
        glow = to_ball @ (ball * (on_ball + below))
        below = to_plate @ (plate * (on_plate + glow))
    return PlateExchange(
        ReflectionTable(below.reshape(BELTS, SECTORS, -1)),
        ReflectionTable(_up_to_one(glow.reshape(RINGS, SECTORS, -1))),
    )


def _exchange(normals: Array, spots: Array, areas: Array) -> tuple[Array, Array]:
    """Form factors (belts, spots) of the plate's pieces seen from the ball's, and (spots, belts) the other way.

    Between pieces by their middles, and scaled so that each sum is the closed form's.
    """
    way = spots[None] - (normals + UP)[:, None]
    square = dot(way, way)
    leaving, arriving = dot(normals[:, None], way), (normals[:, 2] + 1)[:, None]
    kernel = np.maximum(leaving, 0) * arriving / (np.pi * square * square)
    to_plate = kernel * areas
    whole = (1 - normals[:, 2]) / 2
    to_plate *= (whole / np.maximum(to_plate.sum(1), 1e-30))[:, None]
    to_ball = kernel.T * (4 * np.pi / len(normals))
    upright = np.broadcast_to(UP, spots.shape)
    seen = form_factor(upright, UP - spots, 1.0)
    to_ball *= (seen / np.maximum(to_ball.sum(1), 1e-30))[:, None]
    return to_plate, to_ball


def _up_to_one(values: Array) -> Array:
    """Rows up to where r is FAR, continued with zeros to r/(1 + r) = 1, in cells of the same width."""
    return np.concatenate([values, np.zeros((max(1, round(RINGS / FAR)), *values.shape[1:]))])
