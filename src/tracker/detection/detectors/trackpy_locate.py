"""trackpy's own detector (Crocker & Grier 1996), tuned to glints, or to balls seen whole. Needs the extra ``peers``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracker.detection.glints import Glints, View
from tracker.detection.trackpy_features import import_trackpy, locate_features, odd_diameter

BRIGHT = 80.0  # noise deviations, of a glint's peak, over which a wide mask is the better one
MASK = {False: (4.0, 68.0), True: (5.0, 107.0)}  # mask's half width over the glint's, and a mass that noise stays under
BRIGHTEST = 99.9  # percentile of the pixels that may hold a feature: two balls, and not the thousand of the defaults
BALLS = 2  # features, of balls seen whole


class TrackpyLocate:
    """``trackpy.locate`` with the feature's size, separation and least mass taken from the clip."""

    point = "either"

    def __init__(self, view: View) -> None:
        self.trackpy: Any = import_trackpy("trackpy_locate")
        self.view = view
        self.apart = 0.8 * view.camera.diameter_px

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Glints of one frame; trackpy's static error for covariance, .1 px where it gives none."""
        if self.view.takes is not None:
            diameter = odd_diameter(self.view.camera.diameter_px)
            return locate_features(self.trackpy, frame, diameter, self.view, separation=self.apart, topn=BALLS)
        wide, least = MASK[float(np.max(frame)) - float(np.median(frame)) > BRIGHT * self.view.plate.noise]
        diameter = 2 * max(2, round(wide * self.view.sigma)) + 1
        apart = max(self.apart, diameter + 1.0)
        limits = {"minmass": least * self.view.plate.noise, "percentile": BRIGHTEST}
        return locate_features(self.trackpy, frame, diameter, self.view, separation=apart, **limits)
