"""The drag of air."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.effect import Effect, parameter

DENSITY = 1.204  # kg/m^3, dry air at 20 C
VISCOSITY = 1.516e-5  # m^2/s, likewise
SLOW = 1e-6  # of the Reynolds number


@dataclass(frozen=True)
class AirDrag(Effect):
    """a = share (3/8) (rho_air/rho) Cd(Re) v^2 / R with Cd = (24/Re)(1 + 0.15 Re^0.687), Re = 2 R v / nu, to Re = 800.

    Schiller & Naumann 1933, of a sphere far from walls; share 1. It acts on sliding balls and flying ones in full, on
    rolling ones by 5/7.
    """

    share: float = parameter("1", typical=1.0, low=0, high=10, default=1.0)

    def push(self, acceleration: Any, velocity: Any, radius: Any, mass: Any) -> NDArray[np.float64]:
        speed = np.hypot(velocity[..., 0], velocity[..., 1])
        reynolds = np.maximum(2 * radius * speed / VISCOSITY, SLOW)
        drag = 24 / reynolds * (1 + 0.15 * reynolds**0.687)
        rate = 0.5 * DENSITY * np.pi * radius**2 * drag * speed / mass
        return np.asarray(acceleration - self.share * rate[..., None] * velocity)
