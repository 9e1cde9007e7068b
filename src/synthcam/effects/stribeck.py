"""Sliding friction that changes with the slip speed: larger, or smaller, at slow slip."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class Stribeck(Effect):
    """mu(u) = mu [1 + rise exp(-u / slip)]: friction rises, or falls, at slow slip.

    Armstrong-Helouvry, Dupont & Canudas de Wit, Automatica 30 (1994) 1083.
    """

    rise: float = parameter(
        "1",
        typical=0.3,
        low=-0.9,
        high=5,
        meaning=("friction is larger at slow slip", "friction is smaller at slow slip"),
    )
    slip: float = parameter("m/s", typical=0.1, low=0.003, high=3, fixed=True)

    def friction(self, mu: Any, slip_speed: Any) -> Any:
        return mu * (1 + self.rise * np.exp(-slip_speed / self.slip))
