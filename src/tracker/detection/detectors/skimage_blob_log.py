"""scikit-image's Laplacian of Gaussian (``blob_log``), for comparison: its positions are whole pixels."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from skimage.feature import blob_log

from synthcam_shared.arrays import Array, Ints
from tracker.detection.detector import View
from tracker.detection.glints import Glints


class SkimageBlobLog:
    """``blob_log`` about the width of a resting glint; its strongest blobs, no two on one ball."""

    def __init__(self, view: View) -> None:
        self.view = view
        self.level = view.plate.level.astype(np.float64)

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Glints of one frame; the covariance is that of rounding."""
        risen = np.maximum(frame - self.level, 0.0)
        found = blob_log(
            risen,
            min_sigma=0.8 * self.view.sigma,
            max_sigma=1.6 * self.view.sigma,
            num_sigma=3,
            threshold=4.0 * self.view.plate.noise,
            overlap=0.0,
        )
        row, column = found[:, 0].astype(np.int64), found[:, 1].astype(np.int64)
        kept = self._one_a_ball(column, row, risen[row, column])
        row, column = row[kept], column[kept]
        full = frame[row, column] >= self.view.camera.sensor.ceiling
        flux = risen[row, column] * 2.0 * np.pi * self.view.sigma**2
        cov = np.tile(np.eye(2) / 12.0, (len(row), 1, 1))  # px^2, of rounding to whole pixels
        return Glints.at(column, row, cov, flux, full)

    def _one_a_ball(self, x: Ints, y: Ints, height: Array) -> list[int]:
        """The blobs, strongest first, that are further than .8 of a ball from every stronger one."""
        kept: list[int] = []
        for k in np.argsort(-height, kind="stable").tolist():
            if all(np.hypot(x[k] - x[j], y[k] - y[j]) > 0.8 * self.view.camera.diameter_px for j in kept):
                kept.append(k)
        return kept
