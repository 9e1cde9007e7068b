"""A ball whose centre of mass is off its centre."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class EccentricMass(Effect):
    """A ripple on the rolling of ball a: a = (5/7)(g + v^2/R)[c cos(s/R) + d sin(s/R)]/R, s the path along its heading.

    c, d: how far the centre of mass lies ahead of the middle and above it where s = 0. From the Lagrangian of a sphere
    whose inertia about the contact is m R^2 (7/5 + 2 up/R), up being the height of its mass over the middle: v^2/R, of
    the inertia's change, outweighs gravity above 0.11 m/s. First order in the offset over R, without the rolling loss,
    which is a hundredth of gravity; of 1 um at 0.1 m/s the speed ripples by 0.13 mm/s with the period 2 pi R.

    Sliding is unmoved: the load's change there, offset times w^2, is left out. The phase is that of the position on the
    plate; a ball laid down anyhow has another in each clip, which one c and d cannot hold.
    """

    c: float = parameter("m", typical=1e-6, low=-5e-6, high=5e-6)
    d: float = parameter("m", typical=1e-6, low=-5e-6, high=5e-6)

    def rolling(
        self, loss: Any, speed: Any, position: Any, velocity: Any, gravity: float, radius: Any, of_a: Any
    ) -> Any:
        way = position[..., 0] * velocity[..., 0] + position[..., 1] * velocity[..., 1]
        angle = way / np.maximum(speed, 1e-300) / radius - np.arctan2(self.d, self.c)  # one cosine will do
        half = np.tan(angle / 2)  # where numpy is quick at tangents, it is not at cosines
        ripple = np.hypot(self.c, self.d) * (2 / (1 + half * half) - 1)
        return loss - of_a * 5 / 7 * (gravity + speed * speed / radius) / radius * ripple
