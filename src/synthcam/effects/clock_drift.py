"""A frame rate that drifts while the camera warms up."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class ClockDrift(Effect):
    """Frame k is taken at t (1 + e t), t = k/fps: the frame rate falls by the fraction 2 e per second."""

    e: float = parameter(
        "1/s", typical=1e-3, low=-0.2, high=0.2, meaning=("the frame rate falls", "the frame rate rises")
    )

    def clock(self, t: Any) -> Any:
        return t * (1 + self.e * t)
