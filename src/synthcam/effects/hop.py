"""Balls that leave the plate when they collide."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class Hop(Effect):
    """The vertical part of the impulse between the balls, 0.4 m C v0 head-on, lifts the striker off the plate.

    It presses the target down by as much.

    - share: the part of that impulse which the plate does not hold back, 0 (absent) to 1.
    - bounce: the restitution of the plate. Every landing brings a friction impulse of mu (1 + bounce) |vz|.

    In flight there is no friction. The plate of Painter & Behringer, PRE 62 (2000) 2380, holds all of the impulse back.
    """

    share: float = parameter("1", typical=1.0, low=0, high=1, default=1.0)
    bounce: float = parameter("1", typical=0.4, low=0, high=0.9, fixed=True)

    def loft(self, share: Any) -> Any:
        return share + self.share

    def rebound(self, restitution: Any) -> Any:
        return restitution + self.bounce
