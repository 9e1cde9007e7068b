"""Finds bright spots by their centroids: the centre of brightness of the pixels of a window above its rim."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Ints
from tracker.detection.candidates import MAX_FOLLOWED, CandidateSearch
from tracker.detection.detector import View
from tracker.detection.glints import Glints


class SpotCentroids:
    """Weighted centroid of the pixels of a window that are brighter than its rim."""

    def __init__(self, view: View) -> None:
        self.view = view
        radius = view.camera.diameter_px / 2.0
        apart = max(1.6 * radius, 4.0 * view.sigma)
        self.search = CandidateSearch(view.plate, view.sigma, apart, view.settings.detection, MAX_FOLLOWED)
        self.half = max(2, round(2.5 * view.sigma))

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Glints of one frame; covariance from the noise of the pixels that were summed."""
        found = self.search(frame)
        h, w = frame.shape
        whole = (found.row >= self.half) & (found.row < h - self.half)
        whole &= (found.column >= self.half) & (found.column < w - self.half)
        return self.measure(frame, found.row[whole], found.column[whole], self.half)

    def measure(self, frame: NDArray[Any], rows: Ints, columns: Ints, half: int) -> Glints:
        """Measure the glints in windows, 2 half + 1 pixels wide, about these pixels (n,) of a frame."""
        n = len(rows)
        if n == 0:
            return Glints.none()
        span = np.arange(-half, half + 1)
        counts = frame[(rows[:, None] + span)[:, :, None], (columns[:, None] + span)[:, None, :]].astype(float)
        ring = np.concatenate([counts[:, 0], counts[:, -1], counts[:, 1:-1, 0], counts[:, 1:-1, -1]], axis=1)
        ground = np.median(ring, axis=1)
        weight = np.maximum(counts - ground[:, None, None] - 2.0 * self.view.plate.noise, 0.0)
        flux = np.maximum(weight.sum(axis=(1, 2)), 1e-9)
        x = (weight.sum(axis=1) * span).sum(axis=1) / flux
        y = (weight.sum(axis=2) * span).sum(axis=1) / flux
        sensor = self.view.camera.sensor
        noise = np.where(weight > 0, sensor.variance(counts), 0.0)
        dx = (span[None, :] - x[:, None])[:, None, :]
        dy = (span[None, :] - y[:, None])[:, :, None]
        cov = np.empty((n, 2, 2))
        cov[:, 0, 0] = (noise * dx * dx).sum(axis=(1, 2)) / flux**2 + 1e-6
        cov[:, 1, 1] = (noise * dy * dy).sum(axis=(1, 2)) / flux**2 + 1e-6
        cov[:, 0, 1] = cov[:, 1, 0] = (noise * dx * dy).sum(axis=(1, 2)) / flux**2
        full = (counts >= sensor.ceiling).any(axis=(1, 2))
        return replace(Glints.at(columns + x, rows + y, cov, flux, full), background=ground)
