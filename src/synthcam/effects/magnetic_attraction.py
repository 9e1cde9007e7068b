"""Magnetised balls, their moments upright: they attract or repel each other."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.effect import Effect, parameter

NEAREST = 0.8  # diameters: no two centres are nearer but in a path that is only tried


@dataclass(frozen=True)
class MagneticAttraction(Effect):
    """An acceleration of `pull` (2R/r)^4 towards the other ball, r the distance of the centres; pull < 0 repels.

    3 mu0 m^2 / (2 pi r^4) of two aligned dipoles: Jackson, Classical Electrodynamics (1999), ch. 5. A ball at rest
    stays while 5/7 of it is under `rolling_decel`. So the target of a pair (Launch.pair, and every scene) is pulled off
    before it is hit, and comes to meet the striker.
    """

    pull: float = parameter("m/s^2", scale=0.1, low=-0.5, high=0.5)

    def push(self, acceleration: Any, other: Any, radius: Any) -> NDArray[np.float64]:
        x, y = other[..., 0], other[..., 1]
        size = 4 * radius * radius
        square = np.maximum(x * x + y * y, NEAREST * NEAREST * size)  # infinite where there is no other
        strength = size / square
        strength *= strength
        strength /= np.sqrt(square)
        strength *= self.pull
        if not np.all(strength):
            other = np.where(np.isfinite(other), other, 0.0)
        return np.asarray(acceleration + strength[..., None] * other)
