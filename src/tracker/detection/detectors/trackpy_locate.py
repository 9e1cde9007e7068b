"""trackpy's own detector (Crocker & Grier 1996), tuned to glints: for comparison. Needs the extra ``peers``."""

from __future__ import annotations

import importlib
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from commandline.errors import InputError
from tracker.detection.glints import CLIPPED, Glints, View

BRIGHT = 80.0  # noise deviations, of a glint's peak, over which a wide mask is the better one
MASK = {False: (4.0, 68.0), True: (5.0, 107.0)}  # mask's half width over the glint's, and a mass that noise stays under
BRIGHTEST = 99.9  # percentile of the pixels that may hold a feature: two balls, and not the thousand of the defaults


class TrackpyLocate:
    """``trackpy.locate`` with the feature's size, separation and least mass taken from the clip."""

    def __init__(self, view: View) -> None:
        try:
            self.trackpy: Any = importlib.import_module("trackpy")
        except ImportError:
            raise InputError(
                "detector trackpy_locate: trackpy is not installed, expected pip install synthcam[peers]"
            ) from None
        self.view = view
        self.apart = 0.8 * view.camera.diameter_px

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Glints of one frame; trackpy's static error for covariance, .1 px where it gives none."""
        wide, least = MASK[float(np.max(frame)) - float(np.median(frame)) > BRIGHT * self.view.plate.noise]
        diameter = 2 * max(2, round(wide * self.view.sigma)) + 1
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of features it drops, and of what pandas will drop
            found = self.trackpy.locate(
                frame,
                diameter,
                minmass=least * self.view.plate.noise,
                separation=max(self.apart, diameter + 1.0),
                percentile=BRIGHTEST,
            )
        n = len(found)
        if n == 0:
            return Glints.none()
        x, y, mass, error = (found[name].to_numpy(np.float64) for name in ("x", "y", "mass", "ep"))
        error = np.where(np.isfinite(error) & (error > 0), error, 0.1)
        cov = np.zeros((n, 2, 2))
        cov[:, 0, 0] = cov[:, 1, 1] = error**2
        at = (
            np.clip(np.rint(y).astype(np.int64), 0, frame.shape[0] - 1),
            np.clip(np.rint(x).astype(np.int64), 0, frame.shape[1] - 1),
        )
        full = frame[at] >= self.view.camera.sensor.ceiling
        return Glints(np.zeros(n, np.int64), x, y, cov, mass, np.zeros(n), np.where(full, CLIPPED, 0))
