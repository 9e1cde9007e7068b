"""A ball whose centre of mass is not at its centre."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class EccentricMass(Effect):
    """Rolling of ball a ripples: a = (5/7)(g + v^2/R)[c cos(s/R) + d sin(s/R)]/R, with the path s along its heading.

    c and d are the offsets of the centre of mass, ahead of the middle and above it where s = 0. The law follows from
    the Lagrangian of a sphere. Its inertia about the contact is m R^2 (7/5 + 2 up/R), with the height `up` of its mass
    over the middle. The term v^2/R, from the change of the inertia, exceeds gravity above 0.11 m/s. First order in
    offset/R, without the rolling loss, which is a hundredth of gravity. An offset of 1 um at 0.1 m/s makes the speed
    ripple by 0.13 mm/s with the period 2 pi R.

    The change of the load while sliding, offset times w^2, is neglected. The phase depends on the position on the
    plate. A ball that is placed at random has another phase in each clip, which one c and d cannot describe.
    """

    c: float = parameter("m", typical=1e-6, low=-5e-6, high=5e-6)
    d: float = parameter("m", typical=1e-6, low=-5e-6, high=5e-6)

    def rolling(
        self, loss: Any, speed: Any, position: Any, velocity: Any, gravity: float, radius: Any, of_a: Any
    ) -> Any:
        path = position[..., 0] * velocity[..., 0] + position[..., 1] * velocity[..., 1]
        angle = path / np.maximum(speed, 1e-300) / radius - np.arctan2(self.d, self.c)  # one cosine suffices
        half = np.tan(angle / 2)  # numpy computes tangents faster than cosines
        ripple = np.hypot(self.c, self.d) * (2 / (1 + half * half) - 1)
        return loss - of_a * 5 / 7 * (gravity + speed * speed / radius) / radius * ripple
