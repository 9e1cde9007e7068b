"""Spin about the vertical, which oblique hits give, weakens sliding friction and dies by its own torque."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.effect import Effect, parameter

SPREAD = 8 / (3 * np.pi)


@dataclass(frozen=True)
class DrillingSpin(Effect):
    """mu(u, w) = mu u / (u + 8/(3 pi) a |w|), a the radius of contact, w the spin about the vertical.

    Contensou 1963 in Zhuravlev's form, J. Appl. Math. Mech. 62 (1998) 705. The torque that stops the spin is
    mu N a w a/(a |w| + u 16/(3 pi)) of the same theory, so R^2 dw/dt = -(5/2) mu g a^2 w / (a |w| + 16/(3 pi) u).
    """

    a: float = parameter("m", scale=2e-5, low=0, high=2e-4)

    def friction(self, mu: Any, slip_speed: Any, spin: Any) -> Any:
        return mu * slip_speed / (slip_speed + SPREAD * self.a * np.abs(spin) + 1e-300)

    def drilling(self, twist: Any, spin: Any, slip_speed: Any, friction: Any, gravity: float, radius: Any) -> Any:
        whole = friction * (slip_speed + SPREAD * self.a * np.abs(spin)) / np.maximum(slip_speed, 1e-300)
        lever = self.a**2 * spin / (self.a * np.abs(spin) + 2 * SPREAD * slip_speed)
        return twist - 2.5 * whole * gravity * lever / radius**2
