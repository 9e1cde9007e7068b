"""trackpy, tuned, its positions within pixels made even by SPIFF. Needs the extra ``peers``.

Burov et al. 2017, PNAS 114, 221: where a ball moves over many pixels, its places within them are even. The
distribution of those found, taken as a map of the pixel onto itself, then takes each find to where it belongs. trackpy
has this since its pull request 799; here it is written after the paper, for releases without it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracker.detection.glints import Glints, View
from tracker.detection.trackpy_features import import_trackpy, locate_features, odd_diameter

Floats = NDArray[np.float64]
WIDTHS, BRIGHTEST, LEAST = 8.0, 99.9, 68.0  # as for trackpy_locate of dim glints
BALLS = 2
STILL = 0.05  # px; finds no further from one another than this are those of a ball at rest, and count once
FEWEST = 20  # finds from which a distribution can be read


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
            return locate_features(self.trackpy, frame, diameter, self.view, separation=apart, topn=BALLS)
        diameter = odd_diameter(WIDTHS * self.view.sigma)
        limits = {"minmass": LEAST * self.view.plate.noise, "percentile": BRIGHTEST}
        return locate_features(
            self.trackpy, frame, diameter, self.view, separation=max(apart, diameter + 1.0), **limits
        )

    def many(self, frames: Iterable[tuple[int, NDArray[Any]]]) -> Glints:
        """Glints of a whole clip."""
        parts = []
        for number, frame in frames:
            one = self(frame)
            parts.append(replace(one, frame=np.full(len(one), number, dtype=np.int64)))
        found = Glints.join(parts)
        return replace(found, x=flatten_subpixel_distribution(found.x), y=flatten_subpixel_distribution(found.y))


def flatten_subpixel_distribution(place: Floats) -> Floats:
    """Places along one axis, px, such that their parts within the pixel are evenly spread."""
    pixel = np.rint(place)
    order = np.sort(place)
    moving = order[np.concatenate([[True], np.diff(order) > STILL])] if len(order) else order
    if len(moving) < FEWEST:
        return place
    inside = np.sort(moving - np.rint(moving))
    share = (np.arange(len(inside)) + 0.5) / len(inside)
    edges = np.concatenate([[-0.5], inside, [0.5]])
    mapped = np.interp(place - pixel, edges, np.concatenate([[0.0], share, [1.0]])) - 0.5
    return np.asarray(pixel + mapped, dtype=np.float64)
