"""trackpy's features as glints, for the detectors that call it. Needs the extra ``peers``."""

from __future__ import annotations

import importlib
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.errors import InputError
from tracker.detection.glints import Glints, View

UNKNOWN = 0.1  # px, where trackpy gives no error


def import_trackpy(detector: str) -> Any:
    """The package. Raises InputError where it is not installed."""
    try:
        return importlib.import_module("trackpy")
    except ImportError:
        raise InputError(
            f"detector {detector}: trackpy is not installed, expected pip install synthcam[peers]"
        ) from None


def odd_diameter(width: float) -> int:
    """The odd number of pixels, 5 or more, that is next to a width: what trackpy takes as a diameter."""
    return 2 * max(2, round((width - 1.0) / 2.0)) + 1


def locate_features(trackpy: Any, frame: NDArray[Any], diameter: int, view: View, **options: Any) -> Glints:
    """``trackpy.locate`` with its static error for standard error, UNKNOWN where it gives none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of features it drops, and of what pandas will drop
        found = trackpy.locate(frame, diameter, **options)
    if len(found) == 0:
        return Glints.none()
    x, y, mass, error = (found[name].to_numpy(np.float64) for name in ("x", "y", "mass", "ep"))
    error = np.where(np.isfinite(error) & (error > 0), error, UNKNOWN)
    row = np.clip(np.rint(y).astype(np.int64), 0, frame.shape[0] - 1)
    column = np.clip(np.rint(x).astype(np.int64), 0, frame.shape[1] - 1)
    full = frame[row, column] >= view.camera.sensor.ceiling
    area = np.pi / 4 * view.camera.diameter_px**2  # by which outlines are linked
    return Glints.at(x, y, error, mass if view.takes is None else area, full)
