"""Spin transfer that depends on the speed of the impact."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class SpinTransferVelocity(Effect):
    """C(v) = C [1 + c (v/v_ref - 1)], with the speed of approach v and v_ref = 0.3 m/s; from 0 to 5/7.

    There is no published law: this is the first term of any.
    """

    c: float = parameter(
        "1",
        typical=0.1,
        low=-0.9,
        high=0.9,
        meaning=("more spin is transferred at high speed", "less spin is transferred at high speed"),
    )

    def spin_transfer(self, c: Any, approach_speed: Any) -> Any:
        return c * (1 + self.c * (approach_speed / 0.3 - 1))
