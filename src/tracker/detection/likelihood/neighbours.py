"""Finds neighbouring glints, and the secondary glints that two balls make on each other.

A secondary glint is the lamp as one ball shows it after a reflection at the other. It is refused as a glint of its own
by the distance of candidates (`CandidateSearch`) and fitted together with the primary one.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.camera.camera import Camera
from tracker.camera.mirror_images import locate_secondary_glints, secondary_flux_ratio
from tracker.detection.glints import Glints, PositionFlag, RowArrays

FRAME_STEP_PX = 1e6  # distance of two frames, beyond any in a picture


@dataclass(frozen=True, eq=False)
class Neighbours(RowArrays):
    """The nearest other ball of each of n glints, and the secondary glint that it makes."""

    is_near: Flags  # the other ball is so near, 1.5 diameters, that it alters the profile of the glint
    secondary: Array  # (n, 3): position of the secondary glint, px, and 1; or zeros
    flux_ratio: Array
    """Flux of the secondary glint over that of the primary one, except for a factor of the balls' reflectance. Zero
    where it is too faint to show that reflectance."""


def find_neighbouring_glints(glints: Glints, good: Flags, camera: Camera) -> Neighbours:
    """Find the neighbours of the good ones of the glints (n,) in their frames."""
    distance, other = np.full(len(glints), np.inf), np.zeros((len(glints), 2))
    rows = np.flatnonzero(good)
    order = rows[np.argsort(glints.frame[rows], kind="stable")]
    xy = glints.xy
    distance[order], nearest = _find_nearest(glints.frame[order], xy[order])
    other[order] = np.where(nearest[:, None] >= 0, xy[order][nearest], 0.0)
    diameter = camera.diameter_px
    secondary, flux_ratio = np.zeros((len(glints), 3)), np.zeros(len(glints))
    shows = distance < 5.0 * diameter  # a ball shows its neighbour's glint
    if camera.corrects_glint and shows.any():
        secondary[shows, :2] = locate_secondary_glints(camera, xy[shows], other[shows])
        secondary[shows, 2] = 1.0
    bright = distance < 2.5 * diameter  # bright enough to show the balls' reflectance
    if camera.corrects_glint and bright.any():
        flux_ratio[bright] = secondary_flux_ratio(camera, xy[bright], other[bright])
    return Neighbours(distance < 1.5 * diameter, secondary, flux_ratio)


def find_isolated(frame: Ints, position: Array, distance: float) -> Flags:
    """Find the detections (n,), sorted by frame, that have no neighbour within a distance, px, in their frame."""
    return _find_nearest(frame, position)[0] >= distance


def find_repeated(glints: Glints, distance: float) -> Flags:
    """Find the glints (n,) that are nearer than a distance, px, to a better one of their frame: both are of one ball.

    The better one describes its pixels, or has the smaller errors.
    """
    repeated = np.zeros(len(glints), dtype=np.bool_)
    if len(glints) < 2:
        return repeated
    places = np.column_stack([glints.xy, glints.frame * FRAME_STEP_PX])
    rank = np.lexsort((np.linalg.det(glints.cov), (glints.flags & PositionFlag.MISFIT) > 0))
    for better, worse in sorted(cKDTree(places[rank]).query_pairs(distance)):
        repeated[rank[worse]] |= not repeated[rank[better]]
    return repeated


def _find_nearest(frame: Ints, xy: Array) -> tuple[Array, Ints]:
    """Distance (n,), px, of the nearest other detection in the frame, and its row; infinity and -1 without one."""
    if len(frame) < 2:
        return np.full(len(frame), np.inf), np.full(len(frame), -1)
    each, places = np.arange(len(frame)), np.column_stack([xy, frame * FRAME_STEP_PX])
    distance, row = (np.asarray(values) for values in cKDTree(places).query(places, k=2))
    other = (row[:, 0] == each).astype(np.int64)  # of two at one place either may come first
    distance, row = distance[each, other], row[each, other]
    alone = distance > FRAME_STEP_PX / 2
    return np.where(alone, np.inf, distance), np.where(alone, -1, row).astype(np.int64)
