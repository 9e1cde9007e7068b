"""Balls of unequal mass."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class MassMismatch(Effect):
    """Ball a is heavier by the fraction excess, with the same diameter."""

    excess: float = parameter(
        "1",
        typical=0.01,
        low=-0.5,
        high=1,
        meaning=("ball a is heavier by the fraction {}", "ball a is lighter by the fraction {}"),
    )

    def mass(self, mass: Any) -> Any:
        return mass * (1 + self.excess)
