"""What matte things are made of: a ball's colours and their pattern, its varnish; the plate; how it is lit."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Colour = tuple[float, ...]  # reflectance of each channel: three, or one for a grey camera
Pattern = Literal["plain", "half", "stripe", "spots"]
PlateTexture = Literal["plain", "cloth", "wood", "paper"]

STRIPE = 0.5  # half the stripe's width, over the radius
SPOT = np.cos(0.36)  # cosine of a spot's angular radius
GREY = np.array([0.299, 0.587, 0.114])  # of red, green and blue in a grey camera: ITU-R BT.601
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3)
SPOTS = np.concatenate([np.eye(3), -np.eye(3), CORNERS])


@dataclass(frozen=True)
class BallFinish:
    """A ball's surface. colour: Lambert's reflectance; second: the pattern's other colour.

    pattern: "half" and half; a "stripe" round the equator; 14 "spots". It turns with the ball.
    """

    colour: Colour
    second: Colour
    pattern: Pattern = "plain"

    @property
    def mean(self) -> Array:
        """Reflectance of the ball as a whole."""
        share = {
            "plain": 0.0,
            "half": 0.5,
            "stripe": STRIPE,
            "spots": len(SPOTS) * (1 - SPOT) / 2,
        }[self.pattern]
        return np.asarray((1 - share) * np.array(self.colour) + share * np.array(self.second))

    def paint(self, normals: Array, sharp: float) -> Array:
        """Reflectance (n, c) at unit vectors (n, 3) from the centre, on the ball's own axes.

        sharp: width over the radius in which one colour gives way to the other.
        """
        first, second = np.array(self.colour), np.array(self.second)
        if self.pattern == "plain":
            return np.broadcast_to(first, (len(normals), len(first)))
        if self.pattern == "half":
            over = normals[:, 2]
        elif self.pattern == "stripe":
            over = STRIPE - np.abs(normals[:, 2])
        else:
            over = ((normals @ SPOTS.T).max(axis=1) - SPOT) / np.sqrt(1 - SPOT * SPOT)
        share = np.clip(over / sharp + 0.5, 0, 1)[:, None]
        return np.asarray(first + share * (second - first))


@dataclass(frozen=True)
class SurfaceFinish:
    """Balls and plate as a camera of one channel or three sees them.

    balls: one each. plate: reflectance; texture and, over that of such a plate, its contrast; seed of the texture.
    ambient: share of the light at the world's origin that comes from the whole sky alike, the rest is the lamps'.
    """

    balls: tuple[BallFinish, ...]
    plate: Colour
    texture: PlateTexture = "plain"
    contrast: float = 1.0
    seed: int = 0
    ambient: float = 0.3

    @property
    def channels(self) -> int:
        return len(self.plate)

    @property
    def shows_rotation(self) -> bool:
        """Whether it can be seen how a ball is turned."""
        return any(ball.pattern != "plain" for ball in self.balls)
