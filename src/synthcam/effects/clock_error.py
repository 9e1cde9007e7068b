"""A frame rate that differs from what the camera says."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class ClockError(Effect):
    """Frame k is taken at (1 + e) k/fps.

    Tracks cannot show it: v0 and rolling_drag scaled by f, mu_k and rolling_decel by f^2, absorb it exactly. It is
    meant for scenes.
    """

    e: float = parameter(
        "1",
        typical=1e-3,
        low=-0.3,
        high=0.3,
        meaning=(
            "frames are further apart by the fraction {} than camera.json says",
            "frames are closer together by the fraction {} than camera.json says",
        ),
    )

    def clock(self, t: Any) -> Any:
        return t * (1 + self.e)
