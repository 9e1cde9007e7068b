"""A sensor that is read row by row."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class RollingShutter(Effect):
    """Row y of the picture is exposed line * y seconds later than row 0. The row of its centre times a ball."""

    line: float = parameter(
        "s",
        typical=5e-6,
        low=-5e-5,
        high=5e-5,
        meaning=("each row is exposed {} after the row above it", "each row is exposed {} before the row above it"),
    )

    def clock(self, t: Any, row: Any) -> Any:
        return t + self.line * row
