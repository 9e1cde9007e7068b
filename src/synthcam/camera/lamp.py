"""A lamp: a flat disc, ring or bar of uniform radiance, which is cut into cells that look small."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from synthcam_shared.arrays import Array

LampShape = Literal["disc", "ring", "bar"]


@dataclass(frozen=True)
class Flicker:
    """Light 1 + depth cos(2 pi frequency t + phase). Mains light has twice the mains' frequency, Hz; phase: rad."""

    depth: float = 0.0
    frequency: float = 100.0
    phase: float = 0.0

    def mean(self, start: Array, end: Array) -> Array:
        """Mean light between two times, s; if they are equal, the light at that time."""
        rate = np.pi * self.frequency
        middle = np.cos(rate * (start + end) + self.phase)
        return np.asarray(1 + self.depth * np.sinc(self.frequency * (end - start)) * middle)


@dataclass(frozen=True)
class LampCells:
    """Cells of a lamp."""

    positions: Array  # centroids (C, 3), m
    areas: Array  # (C,), m^2
    spread: Array  # second moments uu, vv, uv in the lamp's plane about the centroids (C, 3), m^2


@dataclass(frozen=True)
class Lamp:
    """A flat lamp of uniform radiance that shines to one side. Raises ValueError if it has no area.

    It is a disc of `radius`, a ring between `inner` and `radius`, or a bar of `length` by `width`. The bar is turned by
    `angle`, rad, from the world's x axis. Lengths are in m.
    """

    position: Array  # of its centre (3,)
    radius: float
    shape: LampShape = "disc"
    inner: float = 0.0
    length: float = 0.0
    width: float = 0.0
    angle: float = 0.0
    towards: Array | None = None  # the point (3,) that it faces; None: it faces straight down
    radiance: float = 1.0  # relative to that of the first lamp
    flicker: Flicker = Flicker()
    second: "Lamp | None" = None  # a further lamp

    def __post_init__(self) -> None:
        if self.shape == "ring" and not 0 < self.inner < self.radius:
            raise ValueError(f"lamp inner: expected more than 0 and less than the radius, got {self.inner}")
        if self.shape == "bar" and not (self.length > 0 and self.width > 0):
            raise ValueError(f"lamp length, width: expected more than 0, got {self.length}, {self.width}")

    @property
    def all(self) -> "tuple[Lamp, ...]":
        """This lamp and the further ones."""
        return (self, *(self.second.all if self.second else ()))

    @property
    def half_width(self) -> float:
        """Half of its largest side, or its radius, m."""
        return max(self.radius, self.length / 2) if self.shape == "bar" else self.radius

    def light(self, times: Array) -> Array:
        """Brightness at times, s, relative to its mean."""
        return self.flicker.mean(times, times)

    @property
    def axes(self) -> Array:
        """(3, 3): columns u and v in the lamp's plane, and the direction in which it shines."""
        shine = np.array([0.0, 0.0, -1.0])
        if self.towards is not None:
            shine = np.asarray(self.towards, float) - self.position
            shine = shine / np.linalg.norm(shine)
        u = np.eye(3)[0 if abs(shine[0]) < 0.9 else 1]
        u = u - (u @ shine) * shine
        u /= np.linalg.norm(u)
        return np.stack([u, np.cross(u, shine), shine], axis=1)

    def cells(self, largest: float) -> LampCells:
        """Cut the lamp into cells of half-width `largest`/2, m, unless its own half-width is `largest` or less.

        The cells are half as wide because the edge of a lamp shows where its middle would not.
        """
        if self.shape == "bar":
            at, areas, spread = _bar(self.length, self.width, self.angle, largest)
        else:
            at, areas, spread = _disc(self.radius, self.inner if self.shape == "ring" else 0.0, largest)
        return LampCells(self.position + at @ self.axes[:, :2].T, areas, spread)


def _disc(radius: float, inner: float, largest: float) -> tuple[Array, Array, Array]:
    """Cut a disc or ring into sectors of annuli: centroids (C, 2), areas (C,), second moments (C, 3)."""
    if radius <= largest:
        square = (radius**2 + inner**2) / 4
        return np.zeros((1, 2)), np.array([np.pi * (radius**2 - inner**2)]), np.array([[square, square, 0]])
    largest /= 2
    edges = np.linspace(inner, radius, int(np.ceil((radius - inner) / (2 * largest))) + 1)
    at, areas, spread = [], [], []
    for low, high in pairwise(edges.tolist()):
        count = 1 if high <= largest else max(3, int(np.ceil(np.pi * high / largest)))
        opening = 2 * np.pi / count
        area = opening / 2 * (high**2 - low**2)
        mean = 2 / 3 * (high**3 - low**3) / (high**2 - low**2) * np.sinc(opening / (2 * np.pi))
        square, lobe = (low**2 + high**2) / 2, np.sin(opening) / opening
        along, across = square * (1 + lobe) / 2 - mean**2, square * (1 - lobe) / 2
        turn = np.asarray(opening * np.arange(count), float)
        at.append(mean * np.stack([np.cos(turn), np.sin(turn)], axis=1))
        areas.append(np.full(count, area))
        spread.append(_turn_moments(along, across, turn))
    return np.concatenate(at), np.concatenate(areas), np.concatenate(spread)


def _bar(length: float, width: float, angle: float, largest: float) -> tuple[Array, Array, Array]:
    """Cut a bar into rectangles: centroids (C, 2), areas (C,), second moments (C, 3)."""
    n, m = (int(np.ceil(side / largest)) if side > 2 * largest else 1 for side in (length, width))
    x = ((np.arange(n) + 0.5) / n - 0.5) * length
    y = ((np.arange(m) + 0.5) / m - 0.5) * width
    c, s = np.cos(angle), np.sin(angle)
    flat = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) @ np.array([[c, s], [-s, c]])
    moments = _turn_moments((length / n) ** 2 / 12, (width / m) ** 2 / 12, np.full(n * m, angle))
    return flat, np.full(n * m, length * width / (n * m)), moments


def _turn_moments(along: float, across: float, turn: Array) -> Array:
    """Second moments uu, vv, uv (n, 3) of cells with moments `along` and `across` their axes at `turn`, rad."""
    c, s = np.cos(turn), np.sin(turn)
    return np.stack([along * c * c + across * s * s, along * s * s + across * c * c, (along - across) * c * s], axis=1)
