"""Converts trackpy's features to glints, for the detectors that call it. Needs the extra ``peers``."""

import importlib
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.errors import InputError
from tracker.detection.detector import View
from tracker.detection.glints import Glints


def round_to_odd_diameter(width: float) -> int:
    """The odd number of pixels, 5 or more, nearest to a width: trackpy takes no other diameters."""
    return 2 * max(2, round((width - 1.0) / 2.0)) + 1


class TrackpyDetector:
    """Base of the detectors that call trackpy. Raises InputError where it is not installed."""

    point = "either"

    def __init__(self, view: View) -> None:
        try:
            self.trackpy: Any = importlib.import_module("trackpy")
        except ImportError:
            name = type(self).__module__.rpartition(".")[2]
            raise InputError(
                f"detector {name}: trackpy is not installed, expected pip install synthcam[peers]"
            ) from None
        self.view = view
        self.apart = 0.8 * view.camera.diameter_px  # least distance of two balls, px

    def locate(self, frame: NDArray[Any], diameter: int, **options: Any) -> Glints:
        """``trackpy.locate`` with its static error as standard error."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of features it drops, and of what pandas will drop
            found = self.trackpy.locate(frame, diameter, **options)
        if len(found) == 0:
            return Glints.none()
        x, y, mass, error = (found[name].to_numpy(np.float64) for name in ("x", "y", "mass", "ep"))
        error = np.where(np.isfinite(error) & (error > 0), error, 0.1)  # px, where trackpy gives none
        row, column = (
            np.clip(np.rint(at).astype(np.int64), 0, size - 1) for at, size in zip((y, x), frame.shape, strict=True)
        )
        full = frame[row, column] >= self.view.camera.sensor.ceiling
        area = np.pi / 4 * self.view.camera.diameter_px**2  # by which the tracker links outlines
        return Glints.at(x, y, error, mass if self.view.takes is None else area, full)

    def locate_balls(self, frame: NDArray[Any]) -> Glints:
        """The two strongest features of the size of a ball."""
        return self.locate(frame, round_to_odd_diameter(self.view.camera.diameter_px), separation=self.apart, topn=2)

    def locate_glints(self, frame: NDArray[Any], diameter: int, least: float) -> Glints:
        """Features of this diameter, px, and of a mass of at least `least` standard deviations of the noise."""
        return self.locate(
            frame,
            diameter,
            separation=max(self.apart, diameter + 1.0),
            minmass=least * self.view.plate.noise,
            percentile=99.9,  # pixels of two balls, not the default thousand of features
        )
