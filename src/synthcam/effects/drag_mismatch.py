"""A drag in proportion to the speed, on one ball or another on each."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class DragMismatch(Effect):
    """Force over mass -a v on ball a, -b v on ball b: in full on a sliding or flying ball, by 5/7 on a rolling one.

    A magnetised ball over a plate that conducts: a dipole that moves at v much slower than 2/(mu0 sigma thickness) is
    held back in proportion to v, Reitz, J. Appl. Phys. 41 (1970) 2067. It acts while the ball slides too, unlike a
    mismatch in rolling.
    """

    a: float = parameter("1/s", typical=0.01, low=-1, high=10)
    b: float = parameter("1/s", typical=0.01, low=-1, high=10)

    def push(self, acceleration: Any, velocity: Any, of_a: Any) -> NDArray[np.float64]:
        rate = self.b + (self.a - self.b) * (of_a + 0 * velocity[..., 0])
        return np.asarray(acceleration - rate[..., None] * velocity)
