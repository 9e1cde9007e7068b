"""A plate that is not flat."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class PlateWaviness(Effect):
    """Height a cos(k s) + b sin(k s), k = 2 pi / wavelength, s along the direction `angle` from x: a push of -g h'.

    Gravity along the slope, to its first order: in full on a sliding ball, 5/7 of it on a rolling one. A ball at rest
    is held while 5/7 of it is under `rolling_decel`.
    """

    a: float = parameter("m", scale=2e-6, low=-5e-5, high=5e-5)
    b: float = parameter("m", scale=2e-6, low=-5e-5, high=5e-5)
    wavelength: float = parameter("m", scale=0.02, low=0.003, high=1, fixed=True, tries=np.geomspace(0.006, 0.08, 12))
    angle: float = parameter("rad", scale=0.0, low=-4, high=4, fixed=True, tries=np.pi / 12 * np.arange(12))

    def push(self, acceleration: Any, position: Any, gravity: float) -> NDArray[np.float64]:
        k, x, y = 2 * np.pi / self.wavelength, np.cos(self.angle), np.sin(self.angle)
        phase = k * (x * position[..., 0] + y * position[..., 1]) + np.arctan2(self.a, self.b)  # one cosine will do
        half = np.tan(phase / 2)  # where numpy is quick at tangents, it is not at cosines
        fall = gravity * k * np.hypot(self.a, self.b) * (2 / (1 + half * half) - 1)
        return np.asarray(acceleration - np.moveaxis(np.stack([x * fall, y * fall]), 0, -1))
