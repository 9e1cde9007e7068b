"""Outline, centre and streak in a rendered picture, measured by scikit-image, against closed forms."""

import numpy as np
import pytest
from skimage.measure import CircleModel, centroid, find_contours, inertia_tensor, inertia_tensor_eigvals, ransac

from synthcam.camera.pinhole import Lamp, PinholeCamera
from synthcam.camera.render import MirrorRenderer

R = 1.19e-3
LAMP = Lamp(np.array([0.05, 0.0, 0.45]), 0.01)
FAR = Lamp(np.array([0.05, 0.0, 0.45]), 0.0002)  # a glint so small that it covers little of the body


def overhead(scale, **changes):
    settings = {"size": (200, 160), "scale": scale, "height": 0.5, "ball_radius": R, "fps": 250, "exposure": 0.0}
    return PinholeCamera.overhead(**settings | {"psf_sigma_px": 0.5} | changes)


@pytest.mark.filterwarnings("ignore:.minkowski_distance:DeprecationWarning")  # scikit-image's, beside SciPy 1.18
def test_half_the_profiles_light_lies_within_a_circle_of_half_its_radius():
    """Under a room as bright as the sine of the elevation a mirror ball shows cos 2q = 1 - 2 (r/R)^2 at r = R sin q.

    So it is half as bright as in its middle at r = R/2; Fresnel's reflectance changes that by under a part in 1e3.
    """
    camera = overhead(3e-5)
    film = MirrorRenderer(camera, FAR, [R], room=1.0)
    (picture,) = film.frames(lambda t: np.broadcast_to([[2e-4, 1e-4, R]], (len(t), 1, 3)), [[0.0, 0.0]])
    plate = float(np.median(picture.image))
    middle = camera.project(np.array([2e-4, 1e-4, R])).ravel()
    top = picture.image[round(middle[1]) - 2 : round(middle[1]) + 3, round(middle[0]) - 2 : round(middle[0]) + 3]
    half = plate + 0.5 * (float(np.median(top)) - plate)
    points = np.concatenate(find_contours(picture.image, half))[:, ::-1]
    circle, inliers = ransac(points, CircleModel, min_samples=3, residual_threshold=0.3, max_trials=50, rng=1)
    assert inliers.mean() > 0.7
    assert np.hypot(*(circle.center - middle)) < 0.1
    assert circle.radius == pytest.approx(0.5 * R / 3e-5, rel=0.01)


@pytest.mark.parametrize("heading", [0.0, 0.6, 2.0])
def test_motion_blur_is_as_long_as_the_way_and_lies_along_it(heading):
    """Second moments of a box of length L, blurred: sigma^2 + 1/12 + L^2/12 along it, sigma^2 + 1/12 across."""
    camera = overhead(1e-4, exposure=1e-3, psf_sigma_px=1.2)
    speed, unit = 0.6, np.array([np.cos(heading), np.sin(heading)])

    def rolling(times):
        positions = (np.asarray(times)[:, None] - 5e-4) * speed * unit
        return np.c_[positions, np.full(len(positions), R)][:, None]

    (picture,) = MirrorRenderer(camera, LAMP, [R], room=0.0).frames(rolling, [[0.0, 1e-3]])
    image = picture.image - np.median(picture.image)
    middle = np.rint(centroid(image)).astype(int)
    window = image[middle[0] - 14 : middle[0] + 15, middle[1] - 14 : middle[1] + 15]
    long, short = inertia_tensor_eigvals(window)
    lamp = (R / 2 * LAMP.radius / 0.45 / 1e-4) ** 2 / 4  # the disc lamp's image
    assert short == pytest.approx(1.2**2 + 1 / 12 + lamp, rel=0.01)
    assert long - short == pytest.approx((speed * 1e-3 / 1e-4) ** 2 / 12, rel=0.01)
    (down, both), (_, across) = inertia_tensor(window)  # of a body: the moment about an axis is the other's spread
    seen = 0.5 * np.arctan2(2 * both, down - across)  # the picture's y points down
    assert np.angle(np.exp(2j * (seen - heading))) == pytest.approx(0.0, abs=0.01)
