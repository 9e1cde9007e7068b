"""A frame rate that is not what the camera says."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class ClockError(Effect):
    """Frame k is taken at (1 + e) k/fps.

    Tracks cannot show it: v0 and drag times f, mu and decel times f^2 absorb it exactly. For scenes.
    """

    e: float = parameter("1", typical=1e-3, low=-0.3, high=0.3)

    def clock(self, t: Any) -> Any:
        return t * (1 + self.e)
