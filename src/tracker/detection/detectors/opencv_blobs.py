"""OpenCV's SimpleBlobDetector, for comparison: bright spots of a glint's size, or of a ball's."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.detection.detector import View
from tracker.detection.glints import Glints


class OpencvBlobs:
    """``SimpleBlobDetector`` with thresholds, areas and distances taken from the clip; any shape counts."""

    point = "either"

    def __init__(self, view: View) -> None:
        self.view = view
        ball = np.pi / 4 * view.camera.diameter_px**2
        opencv: Any = cv2  # its stubs lack SimpleBlobDetector_Params
        options = opencv.SimpleBlobDetector_Params()
        options.filterByColor, options.blobColor, options.filterByArea = True, 255, True
        options.filterByCircularity = options.filterByConvexity = options.filterByInertia = False
        options.minDistBetweenBlobs = float(0.8 * view.camera.diameter_px)
        self.area = float(ball)
        if view.takes is None:
            self.deep = view.plate.level.dtype.itemsize > 1
            low = float(np.median(view.plate.level)) + max(2.0, 4.0 * view.plate.noise)
            options.minArea, options.maxArea = 3.0, float(np.pi * (30.0 * view.sigma) ** 2)  # px
        else:
            self.deep = np.asarray(view.frames[0]).dtype.itemsize > 1
            low = float(np.median(view.frames[0])) + max(2.0, 4.0 * view.takes.noise)
            options.minArea, options.maxArea = float(0.25 * ball), float(2.0 * ball)
        full = view.camera.sensor.ceiling
        self.scale = 255.0 / full if self.deep else 1.0
        options.minThreshold, options.maxThreshold = low * self.scale, 255.0
        options.thresholdStep = max((255.0 - options.minThreshold) / 12, 1.0)
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
        return Glints.at(x, y, 0.1, flux)  # px; OpenCV gives no errors
