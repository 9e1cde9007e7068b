"""A tracker that takes the glint for the centre of the ball, because camera.json has no lamp."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class UnknownLamp(Effect):
    """Positions are off by the share `share` of the distance from the centre to the glint of an unknown lamp.

    The lamp is at x, y, height. A small share of a distant lamp looks like all of a near one, so few tracks determine
    the share, which is 1. A defect of the tracker: a scene cannot have it. It does nothing where camera.json has a
    lamp: see `glint_parallax`.
    """

    share: float = parameter("1", typical=1.0, low=0, high=1)
    x: float = parameter("m", typical=0.1, low=-1, high=1, fixed=True, tries=(-0.1, 0, 0.1))
    y: float = parameter("m", typical=0.1, low=-1, high=1, fixed=True, tries=(-0.1, 0, 0.1))
    height: float = parameter("m", typical=0.4, low=0.05, high=10, fixed=True, tries=(0.4, 0.6, 1.5))

    def measure(self, pixels: Any, mirrored: Any) -> Any:
        return pixels + self.share * (mirrored(pixels, (self.x, self.y, self.height)) - pixels)
