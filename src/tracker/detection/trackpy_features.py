"""Converts trackpy's features to glints, for the detectors that call it. Needs the extra ``peers``."""

from __future__ import annotations

import importlib
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.errors import InputError
from tracker.detection.detector import View
from tracker.detection.glints import Glints


def import_trackpy(detector: str) -> Any:
    """The package trackpy. Raises InputError where it is not installed."""
    try:
        return importlib.import_module("trackpy")
    except ImportError:
        raise InputError(
            f"detector {detector}: trackpy is not installed, expected pip install synthcam[peers]"
        ) from None


def odd_diameter(width: float) -> int:
    """The odd number of pixels, 5 or more, nearest to a width: trackpy takes no other diameters."""
    return 2 * max(2, round((width - 1.0) / 2.0)) + 1


def locate_features(
    trackpy: Any, frame: NDArray[Any], diameter: int, view: View, *, unknown_error_px: float = 0.1, **options: Any
) -> Glints:
    """``trackpy.locate`` with its static error as standard error, or `unknown_error_px` where it gives none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of features it drops, and of what pandas will drop
        found = trackpy.locate(frame, diameter, **options)
    if len(found) == 0:
        return Glints.none()
    x, y, mass, error = (found[name].to_numpy(np.float64) for name in ("x", "y", "mass", "ep"))
    error = np.where(np.isfinite(error) & (error > 0), error, unknown_error_px)
    row = np.clip(np.rint(y).astype(np.int64), 0, frame.shape[0] - 1)
    column = np.clip(np.rint(x).astype(np.int64), 0, frame.shape[1] - 1)
    full = frame[row, column] >= view.camera.sensor.ceiling
    area = np.pi / 4 * view.camera.diameter_px**2  # by which the tracker links outlines
    return Glints.at(x, y, error, mass if view.takes is None else area, full)
