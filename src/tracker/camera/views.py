"""Compares the views of two cameras, changes a view by its standard errors, and gives its scale."""

from collections.abc import Collection
from dataclasses import replace

import cv2
import numpy as np

from synthcam_shared.arrays import Array
from tracker.camera.camera import Camera


def perturb_view(camera: Camera, change: Array) -> Camera:
    """The camera with focal length, lens and pose changed by a row (11,) of ``view_errors``."""
    matrix = camera.K.copy()
    matrix[:2, :2] *= 1 + change[0]
    matrix[:2, 2] += change[1:3]
    dist = camera.dist + np.array([change[3], change[4], 0.0, 0.0, 0.0])
    turned = cv2.Rodrigues(change[5:8])[0] @ camera.R
    return replace(camera, K=matrix, dist=dist, R=turned, t=camera.t + change[8:])


def scale_at(camera: Camera) -> float:
    """Compute the scale of a camera's view: m/px in the picture's middle, at the height of the balls' centres."""
    middle = (np.array(camera.size) - 1) / 2
    return float(np.sqrt(np.abs(np.linalg.det(camera.unproject(middle)[1]))))


def find_first_difference(camera: Camera, other: Camera, besides: Collection[str] = ()) -> str:
    """Compare two cameras: the first key of camera.json by which they see the same balls at other pixels, or "".

    They may differ in what each clip measures again (exposure from the blur, width of the glints), and in `besides`.
    Numbers that agree to a millionth are equal.
    """
    keys = ("K", "dist", "R", "t", "size", "fps", "exposure", "line_time", "ball_diameter", "lamp", "warp")
    for key in (k for k in keys if k not in besides):
        one, two = (getattr(c, key) for c in (camera, other))
        if key == "lamp":
            one, two = (lamp.position if lamp else () for lamp in (one, two))
        if key == "warp":
            one, two = (np.concatenate([w.x, w.y, w.dx.ravel(), w.dy.ravel()]) if w else () for w in (one, two))
        if np.shape(one) != np.shape(two) or not np.allclose(one, two, 1e-6, 1e-12, equal_nan=True):
            return key
    return ""
