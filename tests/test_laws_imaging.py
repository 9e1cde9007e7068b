"""The laws of the picture against OpenCV and scipy, and the trackers' defects against what they stand for."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from synthcam.model import Model
from synthcam.optics import Camera

SIZE, SCALE, HEIGHT, R = (640, 480), 1.6e-4, 0.5, Model().ball.radius
FILE = Camera.overhead(SIZE, SCALE, HEIGHT, ball_radius=R, fps=250, exposure=5e-4, psf_sigma_px=1.0)
POINTS = np.array([[x, y, z] for x in (-0.04, 0.0, 0.05) for y in (-0.03, 0.02) for z in (0.0, R)])


def seen(K, dist, turn, t):
    """Where OpenCV projects POINTS."""
    return cv2.projectPoints(POINTS, Rotation.from_matrix(turn).as_rotvec(), t, K, dist)[0][:, 0]


def bent(name, **values):
    """The camera as it is."""
    model = Model().replace({f"{name}.{key}": value for key, value in values.items()})
    return model.laws("camera", FILE, {})


def test_camera_tilt_turns_the_camera_by_scipys_rotation():
    """About the world's fixed axes, first x, then y; the camera stays where it is, the origin where it was seen."""
    x, y = 5e-3, -3e-3
    turned = Rotation.from_euler("xy", [x, y]).as_matrix()  # lower case: fixed axes, in this order
    axes = turned @ FILE.R.T  # the camera's own axes in the world, as columns
    t = -axes.T @ np.array([0, 0, HEIGHT])
    (origin,) = cv2.projectPoints(np.zeros((1, 3)), Rotation.from_matrix(axes.T).as_rotvec(), t, FILE.K, FILE.dist)[0]
    shifted = FILE.K.copy()
    shifted[:2, 2] += FILE.project(np.zeros(3)) - origin[0]
    there = seen(shifted, FILE.dist, axes.T, t)
    np.testing.assert_allclose(bent("camera_tilt", x=x, y=y).project(POINTS), there, rtol=0, atol=1e-9)
    assert np.abs(there - FILE.project(POINTS)).max() > 0.1


@pytest.mark.parametrize("k1", [0.7, -0.4])
def test_lens_distortion_is_opencvs_k1(k1):
    there = seen(FILE.K, np.array([k1, 0, 0, 0, 0]), FILE.R, FILE.t)
    np.testing.assert_allclose(bent("lens_distortion", k1=k1).project(POINTS), there, rtol=0, atol=1e-9)
    assert np.abs(there - FILE.project(POINTS)).max() > 0.1
