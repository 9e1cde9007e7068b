"""Balls of unequal sliding friction."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class FrictionMismatch(Effect):
    """Ball a slides with (1 + excess) mu, ball b with mu, also when they land.

    Sliding friction belongs to both surfaces that touch, so an oiled, rusty or worn ball has its own. If slides of ball
    a and of ball b begin at different speeds, the effect resembles a friction that depends on the slip speed.
    Exchanging the balls in half of the clips separates the two.
    """

    excess: float = parameter(
        "1",
        typical=0.01,
        low=-0.9,
        high=10,
        meaning=(
            "the sliding friction of ball a is larger by the fraction {}",
            "the sliding friction of ball a is smaller by the fraction {}",
        ),
    )

    def friction(self, mu: Any, of_a: Any) -> Any:
        return mu * (1 + self.excess * of_a)
