"""trackpy, tuned, with SPIFF, which removes the bias of positions within pixels. Needs the extra ``peers``.

Burov et al. 2017, PNAS 114, 221: where a ball moves over many pixels, its true positions within a pixel are uniformly
distributed. The distribution of the measured ones, as a map of the pixel onto itself, then corrects each. trackpy has
this since its pull request 799; here it is written after the paper, for releases without it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracker.detection.detector import Detections, View
from tracker.detection.glints import Glints
from tracker.detection.trackpy_features import import_trackpy, locate_features, odd_diameter

Floats = NDArray[np.float64]


class TrackpySpiff:
    """``trackpy.locate`` of all frames, then SPIFF along each axis over the whole clip."""

    point = "either"

    def __init__(self, view: View) -> None:
        self.trackpy: Any = import_trackpy("trackpy_spiff")
        self.view = view

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Glints of one frame, before SPIFF."""
        apart = 0.8 * self.view.camera.diameter_px
        if self.view.takes is not None:
            diameter = odd_diameter(self.view.camera.diameter_px)
            return locate_features(self.trackpy, frame, diameter, self.view, separation=apart, topn=2)
        diameter = odd_diameter(8.0 * self.view.sigma)  # this and the next as trackpy_locate for dim glints
        limits = {"minmass": 68.0 * self.view.plate.noise, "percentile": 99.9}
        return locate_features(
            self.trackpy, frame, diameter, self.view, separation=max(apart, diameter + 1.0), **limits
        )

    def detect(self, frames: Iterable[tuple[int, NDArray[Any]]]) -> Detections:
        """Glints of a whole clip."""
        parts = []
        for number, frame in frames:
            one = self(frame)
            parts.append(replace(one, frame=np.full(len(one), number, dtype=np.int64)))
        found = Glints.join(parts)
        x, y = (flatten_subpixel_distribution(at) for at in (found.x, found.y))
        return Detections(replace(found, x=x, y=y))


def flatten_subpixel_distribution(positions: Floats, *, min_step_px: float = 0.05, min_count: int = 20) -> Floats:
    """Positions along one axis, px, corrected so that their parts within the pixel are uniformly distributed.

    Positions within `min_step_px` of one another are those of a ball at rest and count once. With fewer than
    `min_count` there is no distribution to correct by.
    """
    pixel = np.rint(positions)
    order = np.sort(positions)
    moving = order[np.concatenate([[True], np.diff(order) > min_step_px])] if len(order) else order
    if len(moving) < min_count:
        return positions
    inside = np.sort(moving - np.rint(moving))
    share = (np.arange(len(inside)) + 0.5) / len(inside)
    edges = np.concatenate([[-0.5], inside, [0.5]])
    mapped = np.interp(positions - pixel, edges, np.concatenate([[0.0], share, [1.0]])) - 0.5
    return np.asarray(pixel + mapped, dtype=np.float64)
