"""A tracker that takes the glint for the ball's centre."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class GlintParallax(Effect):
    """The share `share` of the way from the centre to the glint, R [(x_lamp - x)/h_lamp - (x_camera - x)/h_camera]/2.

    A defect of the tracker: no scene may have it.
    """

    share: float = parameter("1", typical=1.0, low=-2, high=2)

    def measure(self, pixels: Any, glint: Any) -> Any:
        return pixels + self.share * (glint(pixels) - pixels)
