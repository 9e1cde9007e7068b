"""A lamp: a flat disc, ring or bar of uniform radiance, which is cut into cells that look small."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
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
    """Cells of a lamp.

    positions: centroids (C, 3), m. areas: (C,), m^2. spread: second moments uu, vv, uv in the lamp's plane about the
    centroids, (C, 3), m^2.
    """

    positions: Array
    areas: Array
    spread: Array


@dataclass(frozen=True)
class Lamp:
    """A flat lamp of uniform radiance that shines to one side.

    Attributes
    ----------
    position : ndarray of shape (3,)
        Centre, m.
    radius, shape, inner, length, width, angle
        A disc of `radius`; a ring between `inner` and `radius`; or a bar of `length` by `width`, turned by `angle` rad
        from the world's x axis; m.
    towards : ndarray of shape (3,) or None
        The point that it faces, m; None: it faces straight down.
    radiance : float
        Relative to that of the first lamp.
    flicker : Flicker
    second : Lamp or None
        A further lamp.

    Raises
    ------
    ValueError
        If the lamp has no area.
    """

    position: Array
    radius: float
    shape: LampShape = "disc"
    inner: float = 0.0
    length: float = 0.0
    width: float = 0.0
    angle: float = 0.0
    towards: Array | None = None
    radiance: float = 1.0
    flicker: Flicker = Flicker()
    second: "Lamp | None" = None

    def __post_init__(self) -> None:
        if self.shape == "ring" and not 0 < self.inner < self.radius:
            raise ValueError(f"lamp inner: expected more than 0 and less than the radius, got {self.inner}")
        if self.shape == "bar" and not (self.length > 0 and self.width > 0):
            raise ValueError(f"lamp length, width: expected more than 0, got {self.length}, {self.width}")

    @property
    def all(self) -> "tuple[Lamp, ...]":
        """This lamp and the further ones."""
        return (self, *(self.second.all if self.second else ()))

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
        turn = opening * np.arange(count)
        c, s = np.cos(turn), np.sin(turn)
        at.append(mean * np.stack([c, s], axis=1))
        areas.append(np.full(count, area))
        moments = [along * c * c + across * s * s, along * s * s + across * c * c, (along - across) * c * s]
        spread.append(np.stack(moments, axis=1))
    return np.concatenate(at), np.concatenate(areas), np.concatenate(spread)


def _bar(length: float, width: float, angle: float, largest: float) -> tuple[Array, Array, Array]:
    """Cut a bar into rectangles: centroids (C, 2), areas (C,), second moments (C, 3)."""
    n, m = (int(np.ceil(side / largest)) if side > 2 * largest else 1 for side in (length, width))
    x = ((np.arange(n) + 0.5) / n - 0.5) * length
    y = ((np.arange(m) + 0.5) / m - 0.5) * width
    c, s = np.cos(angle), np.sin(angle)
    flat = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2) @ np.array([[c, s], [-s, c]])
    along, across = (length / n) ** 2 / 12, (width / m) ** 2 / 12
    moments = [along * c * c + across * s * s, along * s * s + across * c * c, (along - across) * c * s]
    return flat, np.full(n * m, length * width / (n * m)), np.tile(moments, (n * m, 1))
