"""Balls that leave the plate when they hit."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class Hop(Effect):
    """The vertical part of the ball-ball impulse, 0.4 m C v0 head-on, lifts the striker and presses the target down.

    share: of that impulse which the plate does not hold back, 0 (absent) to 1. bounce: the plate's restitution; every
    landing brings its own friction impulse, mu (1 + bounce) |vz|. In flight nothing rubs. The plate of Painter &
    Behringer, PRE 62 (2000) 2380, holds all of the impulse back.
    """

    share: float = parameter("1", typical=1.0, low=0, high=1, default=1.0)
    bounce: float = parameter("1", typical=0.4, low=0, high=0.9, fixed=True)

    def loft(self, share: Any) -> Any:
        return share + self.share

    def rebound(self, restitution: Any) -> Any:
        return restitution + self.bounce
