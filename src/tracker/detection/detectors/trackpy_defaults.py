"""trackpy's detector with its default settings; only the feature's size is given. Needs the extra ``peers``."""

from typing import Any

from numpy.typing import NDArray

from tracker.detection.glints import Glints
from tracker.detection.trackpy_features import TrackpyDetector, round_to_odd_diameter


class TrackpyDefaults(TrackpyDetector):
    """``trackpy.locate(frame, diameter)``."""

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """All features of one frame, each of 8 widths of a glint, or of a ball."""
        view = self.view
        return self.locate(
            frame, round_to_odd_diameter(8.0 * view.sigma if view.takes is None else view.camera.diameter_px)
        )
