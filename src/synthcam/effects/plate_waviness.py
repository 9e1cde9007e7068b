"""A plate that is not flat."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class PlateWaviness(Effect):
    """The plate has waves along `angle` of the height h = a cos(k s) + b sin(k s), with k = 2 pi / wavelength.

    The waves push by -g h', in full on a sliding ball, by 5/7 on a rolling one. A ball that slides over them has the
    load g + v_s^2 h'', at least 0. Its friction changes by mu v_s^2 k/g of the push. The law is that of a sphere on a
    curved plate, to first order in h.

    A spin w about the vertical would push a rolling ball across by (2/7) R w v_s h''. This is neglected: it is about
    0.2 of the push after a hit at b = 0.5 and 0.3 m/s on waves of 20 mm. A ball at rest stays while 5/7 of the push is
    under rolling_decel.
    """

    a: float = parameter("m", typical=2e-6, low=-5e-5, high=5e-5)
    b: float = parameter("m", typical=2e-6, low=-5e-5, high=5e-5)
    wavelength: float = parameter("m", typical=0.02, low=3e-3, high=10, fixed=True, tries=np.geomspace(6e-3, 8e-2, 12))
    angle: float = parameter("rad", typical=0.0, low=-4, high=4, fixed=True, tries=np.pi / 12 * np.arange(12))

    def push(self, acceleration: Any, position: Any, gravity: float) -> NDArray[np.float64]:
        x, y, k, _, lean = self._wave(position)
        fall = gravity * k * lean
        return np.asarray(acceleration - np.moveaxis(np.stack([x * fall, y * fall]), 0, -1))

    def normal_load(self, load: Any, position: Any, velocity: Any) -> Any:
        x, y, k, height, _ = self._wave(position)
        along = x * velocity[..., 0] + y * velocity[..., 1]
        return np.maximum(load - along * along * k * k * height, 0.0)

    def _wave(self, position: Any) -> tuple[float, float, float, Any, Any]:
        """Return the direction, k, h and h'/k."""
        k, x, y = 2 * np.pi / self.wavelength, np.cos(self.angle), np.sin(self.angle)
        phase = k * (x * position[..., 0] + y * position[..., 1]) + np.arctan2(self.a, self.b)  # one sine suffices
        half, height = np.tan(phase / 2), np.hypot(self.a, self.b)  # numpy computes tangents faster than sines
        share = height / (1 + half * half)
        return x, y, k, 2 * half * share, 2 * share - height
