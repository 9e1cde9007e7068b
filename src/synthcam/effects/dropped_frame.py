"""Frames that the camera lost and did not count."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class DroppedFrame(Effect):
    """From frame `frame` on, pictures are `lost` frames later than their number says."""

    lost: float = parameter(
        "1", typical=1.0, low=-5, high=5, meaning=("{} frames are missing", "{} frames are counted too often")
    )
    frame: float = parameter("1", typical=40.0, low=0, high=1e6, fixed=True, tries=range(1, 500))

    def clock(self, t: Any, fps: Any) -> Any:
        edge = 0.02  # frames: the step is smooth, so that a fit can find its position
        late = 0.5 * (1 + np.tanh((t * fps - self.frame + 0.5) / edge))
        return t + self.lost / fps * late
