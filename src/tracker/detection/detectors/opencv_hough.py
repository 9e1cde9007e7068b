"""OpenCV's Hough circles, for comparison: circles of a glint's size, or of a ball's."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.detection.glints import Glints, View

EDGE = 0.5, 12.0  # threshold of edges, over the peak above the plate; least, counts
VOTES, WHOLE = 5.0, 15.0  # for a centre, of a glint and of a ball seen whole
GLINT = 1, 5.0  # least radius of a glint, px; greatest, over its width
BALL = 0.85, 1.15  # of a ball's radius
UNSAID = 0.3  # px; OpenCV gives no errors


class OpencvHough:
    """``HoughCircles``, smoothed as its documentation has it, no two circles on one ball."""

    point = "either"

    def __init__(self, view: View) -> None:
        radius = view.camera.diameter_px / 2
        self.area = float(np.pi * radius**2)
        self.apart = 1.6 * radius
        self.votes = VOTES if view.takes is None else WHOLE
        if view.takes is None:
            self.radii = GLINT[0], round(GLINT[1] * view.sigma)
        else:
            self.radii = int(BALL[0] * radius), round(BALL[1] * radius) + 1
        self.full = view.camera.sensor.ceiling

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Circles of one frame."""
        deep = np.asarray(frame).dtype.itemsize > 1
        picture = np.rint(frame * (255.0 / self.full)).clip(0, 255).astype(np.uint8) if deep else np.asarray(frame)
        smooth = cv2.GaussianBlur(np.ascontiguousarray(picture), (3, 3), 0)
        low, high = self.radii
        edge = max(EDGE[0] * (float(smooth.max()) - float(np.median(smooth))), EDGE[1])
        found = cv2.HoughCircles(
            smooth, cv2.HOUGH_GRADIENT, 1.0, self.apart, param1=edge, param2=self.votes, minRadius=low, maxRadius=high
        )
        if found is None or found.size == 0:
            return Glints.none()
        x, y, _ = found.reshape(-1, 3).astype(np.float64).T
        return Glints.at(x, y, UNSAID, self.area)
