"""A ball that slides with another friction than the other."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class FrictionMismatch(Effect):
    """Ball a slides with (1 + excess) mu, ball b with mu; on landings too.

    A ball that is oiled, rusty or worn: sliding friction is that of the two surfaces which touch. Where every slide of
    ball a begins at other speeds than ball b's it is like a friction that depends on the slip's speed: balls exchanged
    in half the clips separate the two.
    """

    excess: float = parameter("1", typical=0.01, low=-0.9, high=10)

    def friction(self, mu: Any, of_a: Any) -> Any:
        return mu * (1 + self.excess * of_a)
