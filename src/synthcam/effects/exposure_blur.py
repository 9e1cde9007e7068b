"""A shutter that stays open longer than camera.json says."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class ExposureBlur(Effect):
    """The exposure is longer by `longer`: moving glints are blurred more, and their middles are later by half of it."""

    longer: float = parameter(
        "s",
        typical=5e-4,
        low=-1e-3,
        high=4e-3,
        meaning=(
            "the exposure is longer by {} than camera.json says",
            "the exposure is shorter by {} than camera.json says",
        ),
    )

    def exposure(self, exposure: Any) -> Any:
        return max(exposure + self.longer, 0.0)
