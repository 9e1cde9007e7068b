"""A scale that was measured wrong."""

from dataclasses import dataclass, replace
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class ScaleError(Effect):
    """The camera magnifies more than camera.json says, by the fraction e."""

    e: float = parameter(
        "1",
        typical=1e-3,
        low=-0.3,
        high=0.3,
        meaning=(
            "the camera magnifies more than camera.json says, by the fraction {}",
            "the camera magnifies less than camera.json says, by the fraction {}",
        ),
    )

    def camera(self, camera: Any) -> Any:
        matrix = camera.K.copy()
        matrix[:2, :2] *= 1 + self.e
        return replace(camera, K=matrix, scale=camera.scale / (1 + self.e))
