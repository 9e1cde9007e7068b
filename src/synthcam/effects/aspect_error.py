"""Pixels that are not square."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class AspectError(Effect):
    """The picture is wider by the fraction e/2, and lower by e/2, than camera.json says."""

    e: float = parameter(
        "1",
        typical=1e-3,
        low=-0.3,
        high=0.3,
        meaning=(
            "width over height in the picture is larger by the fraction {} than camera.json says",
            "width over height in the picture is smaller by the fraction {} than camera.json says",
        ),
    )

    def camera(self, camera: Any) -> Any:
        matrix = camera.K.copy()
        matrix[:2, :2] = matrix[:2, :2] * np.array([[1 + self.e / 2], [1 - self.e / 2]])
        return replace(camera, K=matrix)
