"""trackpy's own detector (Crocker & Grier 1996), tuned to glints, or to balls seen whole. Needs the extra ``peers``."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracker.detection.glints import Glints
from tracker.detection.trackpy_features import TrackpyDetector


class TrackpyLocate(TrackpyDetector):
    """``trackpy.locate`` with the feature's size, separation and least mass taken from the clip."""

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Glints of one frame; the covariance is trackpy's static error, or .1 px where it gives none."""
        if self.view.takes is not None:
            return self.locate_balls(frame)
        # Half width of the mask over the glint's, and a mass that noise stays below. A wide mask is better for bright
        # glints, whose peak is more than 80 standard deviations of the noise.
        bright = float(np.max(frame)) - float(np.median(frame)) > 80.0 * self.view.plate.noise
        wide, least = (5.0, 107.0) if bright else (4.0, 68.0)
        return self.locate_glints(frame, 2 * max(2, round(wide * self.view.sigma)) + 1, least)
