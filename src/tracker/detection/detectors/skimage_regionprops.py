"""scikit-image's labelled regions with a weighted centroid: a usual script, for comparison."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from skimage.measure import label, regionprops_table

from tracker.detection.detector import View
from tracker.detection.glints import Glints


class SkimageRegionprops:
    """Labelled regions of pixels that are brighter than the plate, and ``regionprops``' weighted centroid of each."""

    def __init__(self, view: View) -> None:
        self.view = view
        self.level = view.plate.level.astype(np.float64)
        self.step = max(2.0, 4.0 * view.plate.noise)

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Glints of one frame; covariance from the noise of the pixels that were summed."""
        risen = np.maximum(frame - self.level, 0.0)
        regions = label(risen > self.step, connectivity=1)
        noise = np.sqrt(self.view.camera.sensor.variance(frame.astype(np.float64)))
        found = regionprops_table(
            regions,
            intensity_image=np.stack([risen, frame, noise], axis=-1),
            properties=("area", "centroid_weighted", "intensity_max", "image_intensity", "bbox"),
        )
        rows = np.flatnonzero(found["area"] >= 3)
        if not len(rows):
            return Glints.none()
        x, y = found["centroid_weighted-1-0"][rows], found["centroid_weighted-0-0"][rows]
        cov, flux = np.zeros((len(rows), 2, 2)), np.empty(len(rows))
        for k, row in enumerate(rows.tolist()):
            part = found["image_intensity"][row]
            flux[k] = part[..., 0].sum()
            for axis, name in ((0, "bbox-1"), (1, "bbox-0")):
                position = (x, y)[axis][k] - found[name][row]
                away = np.arange(part.shape[1 - axis]) - position
                summed = (part[..., 2] ** 2).sum(axis=axis)
                cov[k, axis, axis] = summed @ away**2 / flux[k] ** 2 + 1e-6
        full = found["intensity_max-1"][rows] >= self.view.camera.sensor.ceiling
        return Glints.at(x, y, cov, flux, full)
