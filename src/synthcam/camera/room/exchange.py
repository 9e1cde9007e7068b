"""Two balls that see each other: where on one to ask, in which directions, and what was found as tables."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from synthcam.camera.room.radiosity import ReflectionTable
from synthcam.camera.room.view_factors import dot

Array = NDArray[np.float64]

NEARS, TURNS = 14, 12  # places on a ball: out from the line of centres, and about it
WIDEST = 2.2  # rad from it: a large ball is seen from behind the equator too
RAYS = 14  # to the other ball from each


@dataclass(frozen=True)
class BallExchange:
    """Light that balls trade, by pair of who gets and who gives: axes (3, 3), and a table over angle and turn."""

    pairs: dict[tuple[int, int], tuple[Array, ReflectionTable]]

    def on_ball(self, ball: int, normals: Array) -> Array:
        """Net light (n, c) that a ball has from all others, at unit vectors (n, 3) from its centre."""
        total = np.zeros((len(normals), 1))
        for (own, _), (axes, table) in self.pairs.items():
            if own == ball:
                x, y, z = (normals @ axes).T
                angle = np.arccos(np.clip(z, -1, 1))
                total = total + table.at(np.sqrt(angle / WIDEST), np.arctan2(y, x)) * (angle < WIDEST)[:, None]
        return total


def sample_facing_side(offset: Array) -> tuple[Array, Array]:
    """Axes (3, 3) whose third points along an offset, and unit vectors (NEARS TURNS, 3) about it, closest first."""
    third = offset / np.linalg.norm(offset)
    first = np.cross([0.0, 0.0, 1.0] if abs(third[2]) < 0.9 else [1.0, 0.0, 0.0], third)
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(third, first), third], axis=1)
    angle = ((np.arange(NEARS) + 0.5) / NEARS) ** 2 * WIDEST
    turn = (np.arange(TURNS) + 0.5) / TURNS * 2 * np.pi
    a, t = (x.ravel() for x in np.meshgrid(angle, turn, indexing="ij"))
    local = np.stack([np.sin(a) * np.cos(t), np.sin(a) * np.sin(t), np.cos(a)], axis=1)
    return axes, local @ axes.T


def sample_directions(points: Array, normals: Array, centre: Array, radius: float) -> tuple[Array, Array]:
    """Ways (n, RAYS, 3) from points to a ball, even in solid angle; weights (n, RAYS) by their cosines, 1 in all."""
    offset = centre - points
    far = np.maximum(np.sqrt(dot(offset, offset)), radius * (1 + 1e-9))
    lowest = np.sqrt(1 - (radius / far) ** 2)
    k = np.arange(RAYS) + 0.5
    cosine = 1 - k / RAYS * (1 - lowest[:, None])
    sine, turn = np.sqrt(np.maximum(1 - cosine**2, 0)), k * np.pi * (3 - np.sqrt(5))
    axis = offset / far[:, None]
    first = np.cross(axis, np.where(np.abs(axis[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    first /= np.sqrt(dot(first, first))[:, None]
    second = np.cross(axis, first)
    local = (sine * np.cos(turn))[..., None] * first[:, None] + (sine * np.sin(turn))[..., None] * second[:, None]
    ways = cosine[..., None] * axis[:, None] + local
    weights = np.maximum(dot(ways, normals[:, None]), 0)
    return ways, weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)
