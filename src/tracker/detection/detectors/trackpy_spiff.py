"""trackpy, tuned, with SPIFF, which removes the bias of positions within pixels. Needs the extra ``peers``.

Burov et al. 2017, PNAS 114, 221: where a ball moves over many pixels, its true positions within a pixel are uniformly
distributed. The distribution of the measured ones, as a map of the pixel onto itself, then corrects each. trackpy has
this since its pull request 799. The code here follows the paper, for releases without it.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array
from tracker.detection.detector import Detections
from tracker.detection.glints import Glints
from tracker.detection.trackpy_features import TrackpyDetector, round_to_odd_diameter


class TrackpySpiff(TrackpyDetector):
    """``trackpy.locate`` of all frames, then SPIFF along each axis over the whole clip."""

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Glints of one frame, before SPIFF; the settings are those of trackpy_locate for dim glints."""
        if self.view.takes is not None:
            return self.locate_balls(frame)
        return self.locate_glints(frame, round_to_odd_diameter(8.0 * self.view.sigma), 68.0)

    def detect(self, frames: Iterable[tuple[int, NDArray[Any]]]) -> Detections:
        """Glints of a whole clip."""
        parts = [Glints.none()]
        for number, frame in frames:
            one = self(frame)
            parts.append(replace(one, frame=np.full(len(one), number, dtype=np.int64)))
        found = Glints.join(parts)
        x, y = (flatten_subpixel_distribution(at) for at in (found.x, found.y))
        return Detections(replace(found, x=x, y=y))


def flatten_subpixel_distribution(positions: Array) -> Array:
    """Positions along one axis, px, corrected so that their parts within the pixel are uniformly distributed.

    Positions within .05 px of one another are those of a ball at rest and count once. With fewer than 20 there is no
    distribution to correct by.
    """
    pixel = np.rint(positions)
    order = np.sort(positions)
    moving = order[np.concatenate([[True], np.diff(order) > 0.05])] if len(order) else order
    if len(moving) < 20:
        return positions
    inside = np.sort(moving - np.rint(moving))
    share = (np.arange(len(inside)) + 0.5) / len(inside)
    edges = np.concatenate([[-0.5], inside, [0.5]])
    mapped = np.interp(positions - pixel, edges, np.concatenate([[0.0], share, [1.0]])) - 0.5
    return np.asarray(pixel + mapped, dtype=np.float64)
