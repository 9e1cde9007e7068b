"""The drag of air."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class AirDrag(Effect):
    """The drag of air slows a ball: a = share (3/8) (rho_air/rho) Cd v^2 / R.

    Far from walls share = 1. A sphere has Cd = (24/Re)(1 + 0.15 Re^0.687) with Re = 2 R v / nu, valid to Re = 800
    (Schiller & Naumann, VDI-Zeitschrift 77 (1933) 318). The drag acts in full on a sliding or flying ball, by 5/7 on a
    rolling one. Air at 20 C: 1.204 kg/m^3, nu = 1.516e-5 m^2/s.
    """

    share: float = parameter("1", typical=1.0, low=0, high=10, default=1.0)

    def push(self, acceleration: Any, velocity: Any, radius: Any, mass: Any) -> NDArray[np.float64]:
        speed = np.hypot(velocity[..., 0], velocity[..., 1])
        density, viscosity = 1.204, 1.516e-5  # kg/m^3; kinematic, m^2/s; of dry air at 20 C
        reynolds = np.maximum(2 * radius * speed / viscosity, 1e-6)  # a ball at rest has no drag
        drag = 24 / reynolds * (1 + 0.15 * reynolds**0.687)
        rate = 0.5 * density * np.pi * radius**2 * drag * speed / mass
        return np.asarray(acceleration - self.share * rate[..., None] * velocity)
