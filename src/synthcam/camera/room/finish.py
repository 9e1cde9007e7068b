"""Finish of matte surfaces: the colours and patterns of balls, the plate and its texture, ambient light."""

from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np

from synthcam_shared.arrays import Array

Colour = tuple[float, ...]  # reflectance of each channel: three, or one for a grey camera
Pattern = Literal["plain", "half", "stripe", "spots"]
PlateTexture = Literal["plain", "cloth", "wood", "paper"]

STRIPE_HALF_WIDTH = 0.5  # over the radius
SPOT_COSINE = np.cos(0.36)  # of the angular radius of a spot
SPOT_CENTRES = np.concatenate([np.eye(3), -np.eye(3), np.array([*product((-1, 1), repeat=3)]) / np.sqrt(3)])
GREY_WEIGHTS = np.array([0.299, 0.587, 0.114])  # of red, green and blue in a grey camera: ITU-R BT.601


@dataclass(frozen=True)
class BallFinish:
    """The surface of a ball, with a pattern that rotates with it."""

    colour: Colour  # Lambert's reflectance
    second: Colour  # the other colour of the pattern
    pattern: Pattern = "plain"  # or "half" and half, a "stripe" around the equator, 14 "spots"

    @property
    def mean(self) -> Array:
        """Reflectance of the ball as a whole."""
        spots = len(SPOT_CENTRES) * (1 - SPOT_COSINE) / 2
        share = {"plain": 0.0, "half": 0.5, "stripe": STRIPE_HALF_WIDTH, "spots": spots}[self.pattern]
        return np.asarray((1 - share) * np.array(self.colour) + share * np.array(self.second))

    def paint(self, normals: Array, sharp: float) -> Array:
        """Reflectance (n, c) at unit vectors (n, 3) from the centre, on the ball's own axes.

        sharp: width, over the radius, of the transition between the colours.
        """
        first, second = np.array(self.colour), np.array(self.second)
        if self.pattern == "plain":
            return np.broadcast_to(first, (len(normals), len(first)))
        if self.pattern == "half":
            over = normals[:, 2]
        elif self.pattern == "stripe":
            over = STRIPE_HALF_WIDTH - np.abs(normals[:, 2])
        else:
            over = ((normals @ SPOT_CENTRES.T).max(axis=1) - SPOT_COSINE) / np.sqrt(1 - SPOT_COSINE * SPOT_COSINE)
        share = np.clip(over / sharp + 0.5, 0, 1)[:, None]
        return np.asarray(first + share * (second - first))


@dataclass(frozen=True)
class SurfaceFinish:
    """Finish of balls and plate for a camera of one channel or three."""

    balls: tuple[BallFinish, ...]
    plate: Colour  # reflectance
    texture: PlateTexture = "plain"
    contrast: float = 1.0  # factor on the texture's relief
    seed: int = 0  # of the texture's random numbers
    ambient: float = 0.3  # share of the light at the world's origin that comes uniformly from the sky, not the lamps

    @property
    def channels(self) -> int:
        return len(self.plate)

    @property
    def shows_rotation(self) -> bool:
        """True if a pattern shows the orientation of a ball."""
        return any(ball.pattern != "plain" for ball in self.balls)
