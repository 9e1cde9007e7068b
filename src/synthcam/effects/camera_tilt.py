"""A camera that does not look straight down, which its file does not say."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class CameraTilt(Effect):
    """The camera stays in place, turned about the world's x axis by x, then about its y axis by y, and is re-aimed.

    Right-handed, as `camera.tilt` of a scene: the axes of the camera become Ry Rx times what they were. Re-aiming
    shifts the picture so that the middle of the plate appears where the file says; the keystone distortion remains.
    """

    x: float = parameter(
        "rad",
        typical=5e-3,
        low=-0.3,
        high=0.3,
        meaning=("the camera is turned by {} about +x", "the camera is turned by {} about -x"),
    )
    y: float = parameter(
        "rad",
        typical=5e-3,
        low=-0.3,
        high=0.3,
        meaning=("the camera is turned by {} about +y", "the camera is turned by {} about -y"),
    )

    def camera(self, camera: Any) -> Any:
        (sx, sy), (cx, cy) = np.sin([self.x, self.y]), np.cos([self.x, self.y])
        about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
        about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        turned = camera.R @ (about_y @ about_x).T
        tilted = replace(camera, R=turned, t=turned @ camera.R.T @ camera.t)
        matrix = camera.K.copy()
        matrix[:2, 2] += (camera.project(np.zeros(3)) - tilted.project(np.zeros(3))).ravel()
        return replace(tilted, K=matrix)
