"""OpenCV's Hough circles, for comparison: circles of a glint's size, or of a ball's."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.detection.detector import View
from tracker.detection.glints import Glints


class OpencvHough:
    """``HoughCircles``, smoothed as in its documentation; no two circles on one ball."""

    point = "either"

    def __init__(self, view: View) -> None:
        radius = view.camera.diameter_px / 2
        self.area = float(np.pi * radius**2)
        self.apart = 1.6 * radius
        if view.takes is None:
            self.votes = 5.0  # for the centre of a glint
            self.radii = 1, round(5.0 * view.sigma)  # px
        else:
            self.votes = 15.0  # for the centre of a ball that is seen whole
            self.radii = int(0.85 * radius), round(1.15 * radius) + 1
        self.full = view.camera.sensor.ceiling

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Circles of one frame."""
        deep = np.asarray(frame).dtype.itemsize > 1
        picture = np.rint(frame * (255.0 / self.full)).clip(0, 255).astype(np.uint8) if deep else np.asarray(frame)
        smooth = cv2.GaussianBlur(np.ascontiguousarray(picture), (3, 3), 0)
        low, high = self.radii
        edge = max(0.5 * (float(smooth.max()) - float(np.median(smooth))), 12.0)  # counts
        found = cv2.HoughCircles(
            smooth, cv2.HOUGH_GRADIENT, 1.0, self.apart, param1=edge, param2=self.votes, minRadius=low, maxRadius=high
        )
        if found is None or found.size == 0:
            return Glints.none()
        x, y, _ = found.reshape(-1, 3).astype(np.float64).T
        return Glints.at(x, y, 0.3, self.area)  # px; OpenCV gives no errors
