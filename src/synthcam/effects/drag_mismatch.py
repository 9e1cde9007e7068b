"""A drag proportional to the speed, with its own rate for each ball."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class DragMismatch(Effect):
    """A force over mass of -a v acts on ball a, of -b v on ball b.

    It acts in full on a sliding or flying ball, by 5/7 on a rolling one. Example: a magnetised ball over a conducting
    plate. A dipole much slower than 2/(mu0 sigma thickness) is held back in proportion to its speed (Reitz, J. Appl.
    Phys. 41 (1970) 2067). Unlike `rolling_mismatch`, it acts while the ball slides, too.
    """

    a: float = parameter("1/s", typical=0.01, low=-1, high=10, meaning=("a drag slows ball a", "ball a gains speed"))
    b: float = parameter("1/s", typical=0.01, low=-1, high=10, meaning=("a drag slows ball b", "ball b gains speed"))

    def push(self, acceleration: Any, velocity: Any, of_a: Any) -> NDArray[np.float64]:
        rate = self.b + (self.a - self.b) * (of_a + 0 * velocity[..., 0])
        return np.asarray(acceleration - rate[..., None] * velocity)
