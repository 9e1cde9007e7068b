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

    3 mu0 m^2 / (2 pi r^4) of two aligned dipoles. A ball at rest stays while 5/7 of it is under `rolling_decel`. The
    target of a pair (Launch.pair, and every scene) is held where it rests until the contact, as in a dimple, and is
    free from then on; of states given at the start of a run both are free.
    """

    pull: float = parameter("m/s^2", scale=0.1, low=-0.5, high=0.5)

    def push(self, acceleration: Any, other: Any, radius: Any) -> NDArray[np.float64]:
        r = np.hypot(other[..., 0], other[..., 1])  # infinite where there is no other
        r = np.maximum(r, NEAREST * 2 * radius)
        towards = np.where(np.isfinite(other), other, 1.0) / r[..., None]
        return np.asarray(acceleration + (self.pull * (2 * radius / r) ** 4)[..., None] * towards)
