"""OpenCV's SimpleBlobDetector, for comparison: bright spots of a glint's size, or of a ball's."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.detection.glints import Glints, View

HIGH = 4.0  # noise deviations over the plate, of the lowest threshold
STEPS = 12  # thresholds up to full scale
UNSAID = 0.1  # px; OpenCV gives no errors
SIZES = 0.25, 2.0  # least and greatest area, over a ball's
GLINT = 3.0, 30.0  # least area of a glint, px; greatest radius, over its width


class OpencvBlobs:
    """``SimpleBlobDetector`` with thresholds, areas and distances taken from the clip; shape is not asked for."""

    point = "either"

    def __init__(self, view: View) -> None:
        self.view = view
        ball = np.pi / 4 * view.camera.diameter_px**2
        opencv: Any = cv2  # whose stubs lack this
        options = opencv.SimpleBlobDetector_Params()
        options.filterByColor, options.blobColor, options.filterByArea = True, 255, True
        options.filterByCircularity = options.filterByConvexity = options.filterByInertia = False
        options.minDistBetweenBlobs = float(0.8 * view.camera.diameter_px)
        self.area = float(ball)
        if view.takes is None:
            self.deep = view.plate.level.dtype.itemsize > 1
            low = float(np.median(view.plate.level)) + max(2.0, HIGH * view.plate.noise)
            options.minArea, options.maxArea = GLINT[0], float(np.pi * (GLINT[1] * view.sigma) ** 2)
        else:
            self.deep = np.asarray(view.frames[0]).dtype.itemsize > 1
            low = float(np.median(view.frames[0])) + max(2.0, HIGH * view.takes.noise)
            options.minArea, options.maxArea = (float(size * ball) for size in SIZES)
        full = view.camera.sensor.ceiling
        self.scale = 255.0 / full if self.deep else 1.0
        options.minThreshold, options.maxThreshold = low * self.scale, 255.0
        options.thresholdStep = max((255.0 - options.minThreshold) / STEPS, 1.0)
        options.minRepeatability = 1
        self.finder = opencv.SimpleBlobDetector_create(options)

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Blobs of one frame."""
        picture = np.rint(frame * self.scale).clip(0, 255).astype(np.uint8) if self.deep else np.asarray(frame)
        found = self.finder.detect(np.ascontiguousarray(picture))
        if not found:
            return Glints.none()
        x, y = np.array([blob.pt for blob in found], dtype=np.float64).T
        size = np.array([blob.size for blob in found], dtype=np.float64)
        flux = np.pi / 4 * np.maximum(size, 1.0) ** 2 if self.view.takes is None else self.area
        return Glints.at(x, y, UNSAID, flux)
