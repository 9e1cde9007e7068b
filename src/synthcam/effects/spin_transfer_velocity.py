"""Spin transfer that depends on the speed of the impact."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter

REFERENCE = 0.3  # m/s: there the model's own spin transfer holds


@dataclass(frozen=True)
class SpinTransferVelocity(Effect):
    """C(v) = C [1 + c (v/v_ref - 1)], v the speed of approach, v_ref = 0.3 m/s; never over 5/7, nor under zero.

    No published law: the first term of any.
    """

    c: float = parameter("1", typical=0.1, low=-0.9, high=0.9)

    def spin_transfer(self, c: Any, approach_speed: Any) -> Any:
        return c * (1 + self.c * (approach_speed / REFERENCE - 1))
