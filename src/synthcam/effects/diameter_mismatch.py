"""Balls of unequal diameter."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class DiameterMismatch(Effect):
    """Ball a is larger by the fraction excess; of the same steel, its mass grows as the cube."""

    excess: float = parameter(
        "1",
        typical=1e-3,
        low=-0.2,
        high=0.2,
        meaning=(
            "the diameter of ball a is larger by the fraction {}",
            "the diameter of ball a is smaller by the fraction {}",
        ),
    )

    def radius(self, radius: Any) -> Any:
        return radius * (1 + self.excess)

    def mass(self, mass: Any) -> Any:
        return mass * (1 + self.excess) ** 3
