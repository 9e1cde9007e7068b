"""Lens distortion that camera.json does not contain."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class LensDistortion(Effect):
    """OpenCV's k1 differs from the file's by k1: r' = r (1 + k1 r^2), with r over the focal length."""

    k1: float = parameter(
        "1",
        typical=0.05,
        low=-5,
        high=5,
        meaning=(
            "points appear further from the middle than camera.json says",
            "points appear closer to the middle than camera.json says",
        ),
    )

    def camera(self, camera: Any) -> Any:
        return replace(camera, dist=camera.dist + self.k1 * np.array([1.0, 0, 0, 0, 0]))
