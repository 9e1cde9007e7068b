"""trackpy's detector with its default settings; only the feature's size is given. Needs the extra ``peers``."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from tracker.detection.detector import View
from tracker.detection.glints import Glints
from tracker.detection.trackpy_features import import_trackpy, locate_features, odd_diameter


class TrackpyDefaults:
    """``trackpy.locate(frame, diameter)``."""

    point = "either"

    def __init__(self, view: View) -> None:
        self.trackpy: Any = import_trackpy("trackpy_defaults")
        self.view = view
        # a feature spans 8 widths of a glint, or a ball
        self.diameter = odd_diameter(8.0 * view.sigma if view.takes is None else view.camera.diameter_px)

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """All features of one frame."""
        return locate_features(self.trackpy, frame, self.diameter, self.view)
