"""OpenCV's connected components with a weighted centroid: the usual short script, for comparison."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Flags
from tracker.detection.detector import View
from tracker.detection.glints import Glints


class OpencvComponents:
    """Connected regions of pixels that are brighter than the plate; their centres of brightness."""

    def __init__(self, view: View) -> None:
        self.view = view
        self.step = max(2.0, 4.0 * view.plate.noise)

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Glints of one frame; covariance from the noise of the pixels that were summed."""
        risen = cv2.subtract(frame, self.view.plate.level)
        mask = (risen > self.step).view(np.uint8)
        count, labels, boxes, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
        rows = []
        for label in range(1, count):
            left, top, width, height, area = boxes[label].tolist()
            if area >= 3:  # pixels
                part = slice(top, top + height), slice(left, left + width)
                rows.append((left, top, *self._centre(risen[part], labels[part] == label, frame[part])))
        if not rows:
            return Glints.none()
        left, top, x, y, xx, yy, mass, full = np.array(rows, dtype=np.float64).T
        cov = np.zeros((len(rows), 2, 2))
        cov[:, 0, 0], cov[:, 1, 1] = xx, yy
        return Glints.at(left + x, top + y, cov, mass, full > 0)

    def _centre(self, risen: NDArray[Any], own: Flags, counts: NDArray[Any]) -> tuple[float, ...]:
        """Position from the box's corner, its variances, flux, and whether a pixel is clipped."""
        sensor = self.view.camera.sensor
        weight = np.where(own, risen, 0).astype(np.float64)
        noise = np.where(own, sensor.variance(counts.astype(np.float64)), 0.0)
        mass = float(weight.sum())
        rows, columns = (np.arange(size, dtype=np.float64) for size in weight.shape)
        x, y = float(weight.sum(axis=0) @ columns) / mass, float(weight.sum(axis=1) @ rows) / mass
        xx = float(noise.sum(axis=0) @ (columns - x) ** 2) / mass**2
        yy = float(noise.sum(axis=1) @ (rows - y) ** 2) / mass**2
        return x, y, xx + 1e-6, yy + 1e-6, mass, float((counts[own] >= sensor.ceiling).any())
