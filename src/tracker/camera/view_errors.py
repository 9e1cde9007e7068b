"""Perturbs a camera by the standard errors of its focal length, lens and pose."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from tracker.camera.camera import Camera
from tracker.camera.lens import Array


def perturb_view(camera: Camera, change: Array) -> Camera:
    """The camera with focal length, lens and pose changed by a row (11,) of ``view_errors``."""
    matrix = camera.K.copy()
    matrix[:2, :2] *= 1 + change[0]
    matrix[:2, 2] += change[1:3]
    dist = camera.dist + np.array([change[3], change[4], 0.0, 0.0, 0.0])
    turned = cv2.Rodrigues(change[5:8])[0] @ camera.R
    return replace(camera, K=matrix, dist=dist, R=turned, t=camera.t + change[8:])


def scale_at(camera: Camera) -> float:
    """m/px in the picture's middle, at the height of the balls' centres."""
    middle = (np.array(camera.size) - 1) / 2
    return float(np.sqrt(np.abs(np.linalg.det(camera.unproject(middle)[1]))))
