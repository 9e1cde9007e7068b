"""Sliding friction that grows in proportion to the slip speed, as with a film of oil."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class ViscousFriction(Effect):
    """mu(u) = mu (1 + k u): friction grows in proportion to the slip speed u.

    Armstrong-Helouvry, Dupont & Canudas de Wit, Automatica 30 (1994) 1083.
    """

    k: float = parameter(
        "s/m",
        typical=0.2,
        low=-0.5,
        high=10,
        meaning=("friction grows with the slip speed", "friction falls with the slip speed"),
    )

    def friction(self, mu: Any, slip_speed: Any) -> Any:
        return mu * (1 + self.k * slip_speed)
