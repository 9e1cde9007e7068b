"""A tracker that draws positions to the middles of pixels."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class PixelLocking(Effect):
    """Each coordinate is off by -amplitude sin(2 pi x), x in px; a positive amplitude draws to the middles of pixels.

    A defect of the tracker: a scene cannot have it. Positions rounded to whole pixels have the amplitude 1/pi in their
    first harmonic.
    """

    amplitude: float = parameter(
        "px",
        typical=0.02,
        low=-0.35,
        high=0.35,
        meaning=(
            "positions are drawn by up to {} to the middles of pixels",
            "positions are drawn by up to {} to the edges of pixels",
        ),
    )

    def measure(self, pixels: Any) -> Any:
        return pixels - self.amplitude * np.sin(2 * np.pi * pixels)
