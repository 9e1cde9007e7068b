"""A ball that loses more in rolling than the other."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class RollingMismatch(Effect):
    """Ball a loses more in rolling: (rolling_drag + drag) v + rolling_decel + decel; ball b keeps the model's loss.

    Negative values where ball a loses less. The rolling loss is hysteresis where ball and plate deform (Tabor, Proc. R.
    Soc. A 229 (1955) 198); a dented, soft or dirty ball has its own. Unlike `drag_mismatch`, it does not act while the
    ball slides.
    """

    drag: float = parameter(
        "1/s", typical=0.01, low=-0.1, high=10, meaning=("ball a loses more in rolling", "ball a loses less in rolling")
    )
    decel: float = parameter(
        "m/s^2",
        typical=1e-3,
        low=-0.01,
        high=1,
        meaning=("ball a loses more in rolling", "ball a loses less in rolling"),
    )

    def rolling(self, loss: Any, speed: Any, of_a: Any) -> Any:
        return loss + of_a * (self.drag * speed + self.decel)
