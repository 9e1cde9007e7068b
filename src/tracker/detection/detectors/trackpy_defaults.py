"""trackpy's detector with nothing chosen but the feature's size, which it asks for. Needs the extra ``peers``."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from tracker.detection.glints import Glints, View
from tracker.detection.trackpy_features import import_trackpy, locate_features, odd_diameter

WIDTHS = 8.0  # of a glint, that its feature spans


class TrackpyDefaults:
    """``trackpy.locate(frame, diameter)``."""

    point = "either"

    def __init__(self, view: View) -> None:
        self.trackpy: Any = import_trackpy("trackpy_defaults")
        self.view = view
        self.diameter = odd_diameter(WIDTHS * view.sigma if view.takes is None else view.camera.diameter_px)

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """All features of one frame."""
        return locate_features(self.trackpy, frame, self.diameter, self.view)
