"""Radiosity: light that a ball and its plate, or two balls, reflect to each other, as tables.

Lengths are in radii of the ball, from its point of contact with the plate. Light is irradiance over pi, and 1
is that of the plate without balls. These tables are of a single ball, without neighbours.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from synthcam.camera.room.view_factors import compute_form_factor, dot, mean_cosine_above_horizon, visible_fraction
from synthcam_shared.arrays import Array

EXCHANGE_CELLS = 14, 12  # of a ball: outwards from the line of centres, and around it
EXCHANGE_ANGLE = 2.2  # from the line of centres, rad: a large ball is seen from behind the equator too
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class LightSource:
    """A cell of a lamp seen from n points."""

    way: Array  # unit directions (n, 3)
    wide: Array  # angular radii (n,), rad
    light: Array  # on a plate (n,)


@dataclass(frozen=True)
class ReflectionTable:
    """Values (n, m, c) in n cells of a coordinate from 0 to 1 and m cells of an angle about z, at their middles."""

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


def find_cell(normals: Array) -> tuple[Array, Array]:
    """Find the coordinate (1 + n_z)/2 and the angle about z of unit vectors (..., 3) in a table over a ball."""
    return (1 + normals[..., 2]) / 2, np.arctan2(normals[..., 1], normals[..., 0])


def _divide_ball(belts: int, sectors: int) -> Array:
    """Unit vectors (belts sectors, 3) in the middles of the cells of a table over a ball."""
    turn = (np.arange(sectors) + 0.5) / sectors * 2 * np.pi
    up = (np.arange(belts) + 0.5) / belts * 2 - 1
    ring = np.sqrt(1 - up * up)[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    return np.concatenate([ring, np.broadcast_to(up[:, None, None], (belts, sectors, 1))], axis=-1).reshape(-1, 3)


_BELTS, _SECTORS = 48, 64
FACES = _divide_ball(_BELTS, _SECTORS)  # at which the light of one of many balls is computed


def tabulate_faces(light: Array) -> ReflectionTable:
    """Make a table of the light (n, c) at FACES."""
    return ReflectionTable(light.reshape(_BELTS, _SECTORS, -1))


@dataclass(frozen=True)
class PlateExchange:
    """Light that a ball and its plate exchange."""

    below: ReflectionTable  # the ball's light from the plate, by (1 + n_z)/2
    glow: ReflectionTable  # the plate's light from the ball, by r/(1 + r)

    def on_ball(self, normals: Array) -> Array:
        return self.below.at(*find_cell(normals))

    def on_plate(self, offsets: Array) -> Array:
        """Light (..., c) of the plate at offsets (..., 2) from the point of contact, radii."""
        r = np.hypot(offsets[..., 0], offsets[..., 1])
        return self.glow.at(r / (1 + r), np.arctan2(offsets[..., 1], offsets[..., 0]))


def solve_plate_exchange(
    sources: Callable[[Array], list[LightSource]], ambient: float, ball: Array, plate: Array
) -> PlateExchange:
    """Solve the light that a ball and a plate of mean reflectances (c,) reflect to each other, under lamps and sky.

    sources: points (n, 3) on the plate -> the lamps as they are seen there. Six reflections are followed.
    """
    cells = _divide_ball_and_plate()
    normals, spots = cells.normals, cells.spots
    to_centre = UP - spots
    far = np.sqrt(dot(to_centre, to_centre))
    on_plate = np.full((len(spots), 1), ambient) * (1 - cells.to_ball.sum(1, keepdims=True))
    on_ball = ambient * (1 + normals[:, 2:]) / 2
    for source in sources(spots):
        apart = np.arccos(np.clip(dot(to_centre, source.way) / far, -1, 1))
        on_plate[:, 0] += source.light * visible_fraction(source.wide, np.arcsin(1 / far), apart)
    for source in sources(np.zeros((1, 3))):
        seen = mean_cosine_above_horizon(normals @ source.way[0], np.sin(source.wide))
        on_ball[:, 0] += source.light * seen / source.way[0, 2]
    below, glow = np.zeros((len(normals), len(ball))), np.zeros((len(spots), len(ball)))
    for _ in range(6):
        glow = cells.to_ball @ (ball * (on_ball + below))
        below = cells.to_plate @ (plate * (on_plate + glow))
    return PlateExchange(
        ReflectionTable(below.reshape(*cells.of_ball, -1)),
        ReflectionTable(np.pad(glow.reshape(*cells.of_plate, -1), ((0, cells.beyond), (0, 0), (0, 0)))),
    )


class ExchangeCells(NamedTuple):
    """The cells of a ball and of its plate, and the form factors between them."""

    normals: Array  # (belts sectors, 3) of the ball's cells
    spots: Array  # (rings sectors, 3) of the plate's cells
    to_plate: Array  # form factors from the ball's cells to the plate's
    to_ball: Array  # the reverse
    of_ball: tuple[int, int]  # belts, sectors
    of_plate: tuple[int, int]  # rings, sectors
    beyond: int  # rows of zeros from the last ring to r/(1 + r) = 1


@lru_cache(maxsize=1)
def _divide_ball_and_plate() -> ExchangeCells:
    """Divide a ball and its plate into cells: they are the same for all, in radii of the ball."""
    rings_of_plate, belts_of_ball, sectors = 48, 24, 32  # cells of the tables
    turn = (np.arange(sectors) + 0.5) / sectors * 2 * np.pi
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    normals = _divide_ball(belts_of_ball, sectors)
    plate_radius = 200.0  # of the rings, in radii of the ball
    edges = np.arange(rings_of_plate + 1) / rings_of_plate * plate_radius / (1 + plate_radius)
    edges, middle = edges / (1 - edges), (edges[1:] + edges[:-1]) / 2
    middle = middle / (1 - middle)
    spots = np.pad((middle[:, None, None] * ring).reshape(-1, 2), ((0, 0), (0, 1)))
    areas = np.repeat(np.pi * np.diff(edges**2) / sectors, sectors)
    # Form factors between the middles of cells, scaled so that each sum is that of the closed form.
    way = spots[None] - (normals + UP)[:, None]
    square = dot(way, way)
    kernel = np.maximum(dot(normals[:, None], way), 0) * (normals[:, 2] + 1)[:, None] / (np.pi * square * square)
    to_plate, to_ball = kernel * areas, kernel.T * (4 * np.pi / len(normals))
    to_plate *= ((1 - normals[:, 2]) / 2 / np.maximum(to_plate.sum(1), 1e-30))[:, None]
    seen = compute_form_factor(np.broadcast_to(UP, spots.shape), UP - spots, 1.0)
    to_ball *= (seen / np.maximum(to_ball.sum(1), 1e-30))[:, None]
    of_ball, of_plate = (belts_of_ball, sectors), (rings_of_plate, sectors)
    beyond = max(1, round(rings_of_plate / plate_radius))
    return ExchangeCells(normals, spots, to_plate, to_ball, of_ball, of_plate, beyond)


ExchangeTable = tuple[Array, ReflectionTable]  # axes (3, 3), and light over angle and azimuth


@dataclass(frozen=True)
class LightExchange:
    """Light that balls exchange, by receiver: a table for each sender."""

    tables: dict[int, list[ExchangeTable]]

    def on_ball(self, ball: int, normals: Array) -> Array:
        """Net light (n, c) that a ball receives from all others, at unit vectors (n, 3) from its centre."""
        total = np.zeros((len(normals), 1))
        for axes, table in self.tables.get(ball, ()):
            x, y, z = (normals @ axes).T
            angle = np.arccos(np.clip(z, -1, 1))
            light = table.at(np.sqrt(angle / EXCHANGE_ANGLE), np.arctan2(y, x))
            total = total + light * (angle < EXCHANGE_ANGLE)[:, None]
        return total


def sample_facing_side(offset: Array) -> tuple[Array, Array]:
    """Sample the side of a ball that exchanges light with another: axes (3, 3), and unit vectors (cells, 3)."""
    third = offset / np.linalg.norm(offset)
    first = np.cross([0.0, 0.0, 1.0] if abs(third[2]) < 0.9 else [1.0, 0.0, 0.0], third)
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(third, first), third], axis=1)
    rings, sectors = EXCHANGE_CELLS
    angle = ((np.arange(rings) + 0.5) / rings) ** 2 * EXCHANGE_ANGLE
    turn = (np.arange(sectors) + 0.5) / sectors * 2 * np.pi
    a, t = (x.ravel() for x in np.meshgrid(angle, turn, indexing="ij"))
    local = np.stack([np.sin(a) * np.cos(t), np.sin(a) * np.sin(t), np.cos(a)], axis=1)
    return axes, local @ axes.T


def sample_directions_to_ball(points: Array, normals: Array, centre: Array, radius: float) -> tuple[Array, Array]:
    """Sample directions (n, rays, 3) of light from points to a ball, with weights by cosine, of sum 1."""
    rays = 14
    offset = centre - points
    far = np.maximum(np.sqrt(dot(offset, offset)), radius * (1 + 1e-9))
    lowest = np.sqrt(1 - (radius / far) ** 2)
    k = np.arange(rays) + 0.5
    cosine = 1 - k / rays * (1 - lowest[:, None])
    sine, turn = np.sqrt(np.maximum(1 - cosine**2, 0)), k * np.pi * (3 - np.sqrt(5))
    axis = offset / far[:, None]
    first = np.cross(axis, np.where(np.abs(axis[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    first /= np.sqrt(dot(first, first))[:, None]
    second = np.cross(axis, first)
    local = (sine * np.cos(turn))[..., None] * first[:, None] + (sine * np.sin(turn))[..., None] * second[:, None]
    ways = cosine[..., None] * axis[:, None] + local
    weights = np.maximum(dot(ways, normals[:, None]), 0)
    return ways, weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)
