"""A tracker that takes the glint for the centre of the ball."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class GlintParallax(Effect):
    """Positions are off by `share` times the glint's offset, R [(x_lamp - x)/h_lamp - (x_camera - x)/h_camera]/2.

    A defect of the tracker: a scene cannot have it.
    """

    share: float = parameter("1", typical=1.0, low=-2, high=2)

    def measure(self, pixels: Any, glint: Any) -> Any:
        return pixels + self.share * (glint(pixels) - pixels)
