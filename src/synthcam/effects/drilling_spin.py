"""Sliding friction of a ball that spins about the vertical: sliding and drilling share one contact."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class DrillingSpin(Effect):
    """A spin w about the vertical weakens sliding friction: the force is mu N F u/h, with h^2 = u^2 + (a w)^2.

    Its torque is mu N a M a w/h: Coulomb friction over a Hertz contact of radius a. F and M are polynomials in
    y = (a w/h)^2. They are within 1 % of the integrals of friction over the contact, and exact at both ends:

    - fast slides: mu N (1 - (a w/u)^2/10) and mu N a (a w/u)/5
    - drilling: (3 pi/8) mu N u/(a w) and (3 pi/16) mu N a

    Contensou (1963); Zhuravlev, J. Appl. Math. Mech. 62 (1998) 705. Zhuravlev's simpler u/(u + 8/(3 pi) a w) is up to
    39 % too low between the ends, and his torque up to 48 %.

    For a steel ball of 2.38 mm on aluminium, under its weight, the radius a is 2 um (Hertz). On a soft plate it is
    tenths of a millimetre. The spin that a ball loses while it rolls is neglected.
    """

    a: float = parameter("m", typical=2e-6, low=0, high=2e-4)

    def friction(self, mu: Any, slip_speed: Any, spin: Any) -> Any:
        return mu * self._force(slip_speed, spin)

    def drilling(self, twist: Any, spin: Any, slip_speed: Any, friction: Any, load: Any, radius: Any) -> Any:
        force = self._force(slip_speed, spin)
        whole = friction / np.where(force > 0, force, 1.0)  # mu with all other effects on it
        turning, y = self._shares(spin * self.a, slip_speed, spin)
        # M in rising powers of y; sum 3 pi/16
        series = (0.2, 0.01, 2.003, -10.752, 25.74, -25.326, 3 * np.pi / 16 + 8.125)
        return twist - 2.5 * whole * load * self.a / radius**2 * turning * _sum_series(series, y)

    def _force(self, slip_speed: Any, spin: Any) -> Any:
        sliding, y = self._shares(slip_speed, slip_speed, spin)
        series = (1.0, 0.4, 0.105, 1.844, -4.654, 3 * np.pi / 8 + 1.305)  # F in rising powers of y; sum 3 pi/8
        return sliding * _sum_series(series, y)

    def _shares(self, part: Any, slip_speed: Any, spin: Any) -> tuple[Any, Any]:
        """Return part/h, and y."""
        square = (self.a * spin) ** 2
        h = np.maximum(slip_speed**2 + square, 1e-300)
        return part / np.sqrt(h), square / h


def _sum_series(coefficients: tuple[float, ...], y: Any) -> Any:
    out = coefficients[-1]
    for c in coefficients[-2::-1]:
        out = out * y + c
    return out
