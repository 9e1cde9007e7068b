"""Finds the neighbours of glints in their frames, and the secondary glints that neighbouring balls make on each other.

A secondary glint is the lamp as one ball shows it after a reflection at the other. It is refused as a glint of its own
by the distance of candidates (`CandidateSearch`) and fitted together with the primary one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tracker.camera.camera import Camera
from tracker.camera.lens import Array
from tracker.camera.mirror_images import locate_secondary_glints, secondary_flux_ratio
from tracker.detection.glints import Glints

Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Neighbours:
    """The nearest other ball of each glint, and the secondary glint that it makes.

    Attributes
    ----------
    is_near : ndarray of bool, shape (n,)
        Whether the other ball is so near, 1.5 diameters between the glints, that it alters the profile of a glint.
    secondary : ndarray of shape (n, 3)
        Position of the secondary glint, px, and 1; or zeros.
    flux_ratio : ndarray of shape (n,)
        Its flux over that of the primary one, except for a factor of the balls' reflectance. Zero where it is too faint
        to show that reflectance.
    """

    is_near: NDArray[np.bool_]
    secondary: Array
    flux_ratio: Array


def find_neighbours(glints: Glints, good: NDArray[np.bool_], camera: Camera, *, max_balls: int = 12) -> Neighbours:
    """Find the neighbours of the good glints (n,) among `max_balls` in their frames."""
    nearest = np.full(len(glints), np.inf)
    other = np.zeros((len(glints), 2))
    rows = np.flatnonzero(good)
    order = rows[np.argsort(glints.frame[rows], kind="stable")]
    frame, xy = glints.frame[order], glints.xy[order]
    for lag in range(1, min(len(order), max_balls)):
        pairs = np.flatnonzero(frame[lag:] == frame[:-lag])
        if len(pairs) == 0:
            break
        gap = np.hypot(*(xy[pairs + lag] - xy[pairs]).T)
        for one, two in ((pairs, pairs + lag), (pairs + lag, pairs)):
            closer = gap < nearest[order[one]]
            nearest[order[one[closer]]] = gap[closer]
            other[order[one[closer]]] = xy[two[closer]]
    diameter = camera.diameter_px
    secondary, flux_ratio = np.zeros((len(glints), 3)), np.zeros(len(glints))
    shows = nearest < 5.0 * diameter  # a ball shows its neighbour's glint
    if camera.corrects_glint and shows.any():
        secondary[shows, :2] = locate_secondary_glints(camera, glints.xy[shows], other[shows])
        secondary[shows, 2] = 1.0
    bright = nearest < 2.5 * diameter  # bright enough to show the balls' reflectance
    if camera.corrects_glint and bright.any():
        flux_ratio[bright] = secondary_flux_ratio(camera, glints.xy[bright], other[bright])
    return Neighbours(nearest < 1.5 * diameter, secondary, flux_ratio)


def find_isolated(frame: Ints, position: Array, distance: float, *, max_balls: int = 12) -> NDArray[np.bool_]:
    """Which detections (n,), sorted by frame, have no other within a distance, px, in their frame."""
    alone = np.ones(len(frame), dtype=bool)
    for lag in range(1, min(len(frame), max_balls)):
        same = np.flatnonzero(frame[lag:] == frame[:-lag])
        if len(same) == 0:
            break
        close = same[np.hypot(*(position[same + lag] - position[same]).T) < distance]
        alone[close] = alone[close + lag] = False
    return alone
