"""Balls that spin about the vertical slide more easily: sliding and drilling share the friction of one contact."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.effect import Effect, parameter

FORCE = (1.0, 0.4, 0.105, 1.844, -4.654, 3 * np.pi / 8 + 1.305)  # F in the rising powers of y; sum 3 pi/8
TORQUE = (0.2, 0.01, 2.003, -10.752, 25.74, -25.326, 3 * np.pi / 16 + 8.125)  # M likewise; sum 3 pi/16
TINY = 1e-300


@dataclass(frozen=True)
class DrillingSpin(Effect):
    """Coulomb friction over a Hertz contact of radius a: force mu N F u/h for the slip u, torque mu N a M a w/h for w.

    w is the spin about the vertical, h^2 = u^2 + (a w)^2; F, M are polynomials in y = (a w/h)^2, within 1 % of the
    integrals of friction over the contact, and exact at both ends: mu N (1 - (a w/u)^2/10) and mu N a (a w/u)/5 in fast
    slides, (3 pi/8) mu N u/(a w) and (3 pi/16) mu N a in drilling. Contensou 1963; Zhuravlev, J. Appl. Math. Mech. 62
    (1998) 705, whose simpler u/(u + 8/(3 pi) a w) is up to 39 % too low between the ends, and his torque 48 %.

    a: 2 um for 2.38 mm of steel on aluminium under its weight (Hertz); tenths of a millimetre on a soft plate. The spin
    that a ball would lose while it rolls is left out.
    """

    a: float = parameter("m", typical=2e-6, low=0, high=2e-4)

    def friction(self, mu: Any, slip_speed: Any, spin: Any) -> Any:
        return mu * self._force(slip_speed, spin)

    def drilling(self, twist: Any, spin: Any, slip_speed: Any, friction: Any, load: Any, radius: Any) -> Any:
        force = self._force(slip_speed, spin)
        whole = friction / np.where(force > 0, force, 1.0)  # mu, with all else that bends it
        turning, y = self._shares(spin * self.a, slip_speed, spin)
        return twist - 2.5 * whole * load * self.a / radius**2 * turning * _series(TORQUE, y)

    def _force(self, slip_speed: Any, spin: Any) -> Any:
        sliding, y = self._shares(slip_speed, slip_speed, spin)
        return sliding * _series(FORCE, y)

    def _shares(self, part: Any, slip_speed: Any, spin: Any) -> tuple[Any, Any]:
        """Part/h, and y."""
        square = (self.a * spin) ** 2
        h = np.maximum(slip_speed**2 + square, TINY)
        return part / np.sqrt(h), square / h


def _series(coefficients: tuple[float, ...], y: Any) -> Any:
    out = coefficients[-1]
    for c in coefficients[-2::-1]:
        out = out * y + c
    return out
