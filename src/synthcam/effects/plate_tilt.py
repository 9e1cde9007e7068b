"""A plate that is not level."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class PlateTilt(Effect):
    """Gravity pulls along the plate by g sin(x), g sin(y): in full on a sliding ball, by 5/7 on a rolling one.

    x, y: slopes, positive where the plate falls towards +x, +y. The rolling loss holds a ball at rest while
    (5/7) g sin(tilt) is under rolling_decel. The loss of load, 1 - cos(tilt), 5e-7 at 1 mrad, is neglected.
    """

    x: float = parameter(
        "rad",
        typical=1e-3,
        low=-0.1,
        high=0.1,
        meaning=("the plate falls by {} towards +x", "the plate falls by {} towards -x"),
    )
    y: float = parameter(
        "rad",
        typical=1e-3,
        low=-0.1,
        high=0.1,
        meaning=("the plate falls by {} towards +y", "the plate falls by {} towards -y"),
    )

    def push(self, acceleration: Any, gravity: float) -> NDArray[np.float64]:
        return np.asarray(acceleration + gravity * np.sin([self.x, self.y]))
