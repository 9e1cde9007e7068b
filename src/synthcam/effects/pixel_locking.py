"""A tracker drawn to the middles of pixels."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class PixelLocking(Effect):
    """Each coordinate is off by -amplitude sin(2 pi x), x in px: amplitude > 0 draws to the middles.

    A defect of the tracker: no scene may have it. Positions rounded to whole px have amplitude 1/pi, their first
    harmonic.
    """

    amplitude: float = parameter("px", typical=0.02, low=-0.35, high=0.35)

    def measure(self, pixels: Any) -> Any:
        return pixels - self.amplitude * np.sin(2 * np.pi * pixels)
