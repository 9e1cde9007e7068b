"""Restitution that falls with the speed of impact."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class VelocityRestitution(Effect):
    """1 - r(v) = (1 - r) [1 + 5 e ((v/v_ref)^(1/5) - 1)], with the normal speed of approach v and v_ref = 0.3 m/s.

    r never exceeds 1, which e = 1 would reach under 0.1 m/s. e = 0.2 is the viscoelastic sphere, 1 - r ~ v^(1/5):
    Ramirez, Poeschel, Brilliantov & Schwager, PRE 60 (1999) 4465.
    """

    e: float = parameter(
        "1",
        typical=0.2,
        low=-1,
        high=1,
        meaning=("the restitution falls with the speed", "the restitution rises with the speed"),
    )

    def restitution(self, r: Any, normal_speed: Any) -> Any:
        power = 1 / 5
        return 1 - (1 - r) * (1 + self.e * ((normal_speed / 0.3) ** power - 1) / power)
