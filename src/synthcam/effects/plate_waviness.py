"""A plate that is not flat."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class PlateWaviness(Effect):
    """Height a cos(k s) + b sin(k s), k = 2 pi / wavelength, s along the direction `angle` from x: a push of -g h'.

    In full on a sliding ball, 5/7 of it on a rolling one. A ball at rest is held while 5/7 of it is under
    `rolling_decel`.
    """

    a: float = parameter("m", scale=2e-6, low=-5e-5, high=5e-5)
    b: float = parameter("m", scale=2e-6, low=-5e-5, high=5e-5)
    wavelength: float = parameter("m", scale=0.02, low=0.003, high=1, fixed=True)
    angle: float = parameter("rad", scale=0.0, low=-4, high=4, fixed=True)

    def push(self, acceleration: Any, position: Any, gravity: float) -> NDArray[np.float64]:
        k = 2 * np.pi / self.wavelength
        along = np.array([np.cos(self.angle), np.sin(self.angle)])
        s = k * (position @ along)
        slope = k * (self.b * np.cos(s) - self.a * np.sin(s))
        return np.asarray(acceleration - gravity * slope[..., None] * along)
