"""A rolling loss that grows as the square of the speed."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class RollingQuadratic(Effect):
    """The rolling loss has a quadratic term: a = -(drag v + decel + K v^2).

    It does not act while sliding, which distinguishes it from the drag of air. There is no published law: it is the
    next term after those of Painter & Behringer, PRE 62 (2000) 2380.
    """

    K: float = parameter(
        "1/m",
        typical=0.1,
        low=-0.1,
        high=10,
        meaning=("the loss is larger at high speed", "the loss is smaller at high speed"),
    )

    def rolling(self, loss: Any, speed: Any) -> Any:
        return loss + self.K * speed**2
