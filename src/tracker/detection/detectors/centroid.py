"""Centre of brightness of the pixels above the plate: simple, fast, and the method of most programs."""

from typing import Any

from numpy.typing import NDArray

from tracker.detection.detector import View
from tracker.detection.glints import Glints
from tracker.detection.spot_centroids import SpotCentroids


class Centroid:
    """Weighted centroid of the pixels of a window that are brighter than its rim."""

    def __init__(self, view: View) -> None:
        self.find = SpotCentroids(view)

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Glints of one frame; covariance from the noise of the pixels that were summed."""
        return self.find(frame)
