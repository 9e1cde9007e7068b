"""trackpy's own detector (Crocker & Grier 1996), tuned to glints, or to balls seen whole. Needs the extra ``peers``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracker.detection.detector import View
from tracker.detection.glints import Glints
from tracker.detection.trackpy_features import import_trackpy, locate_features, odd_diameter


class TrackpyLocate:
    """``trackpy.locate`` with the feature's size, separation and least mass taken from the clip."""

    point = "either"

    def __init__(self, view: View) -> None:
        self.trackpy: Any = import_trackpy("trackpy_locate")
        self.view = view
        self.apart = 0.8 * view.camera.diameter_px

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Glints of one frame; the covariance is trackpy's static error, or .1 px where it gives none."""
        if self.view.takes is not None:
            diameter = odd_diameter(self.view.camera.diameter_px)
            return locate_features(self.trackpy, frame, diameter, self.view, separation=self.apart, topn=2)
        # Half width of the mask over the glint's, and a mass that noise stays below. A wide mask is better for bright
        # glints, whose peak is more than 80 standard deviations of the noise.
        bright = float(np.max(frame)) - float(np.median(frame)) > 80.0 * self.view.plate.noise
        wide, least = (5.0, 107.0) if bright else (4.0, 68.0)
        diameter = 2 * max(2, round(wide * self.view.sigma)) + 1
        apart = max(self.apart, diameter + 1.0)
        limits = {
            "minmass": least * self.view.plate.noise,
            "percentile": 99.9,
        }  # 99.9: pixels of two balls, not the default thousand of features
        return locate_features(self.trackpy, frame, diameter, self.view, separation=apart, **limits)
