"""The laws of the picture against OpenCV and scipy, and the trackers' defects against what they stand for."""

import dataclasses

import cv2
import numpy as np
import pytest
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

from synthcam.camera.pinhole import Lamp, PinholeCamera, project_glint
from synthcam.dynamics.launch import Launch
from synthcam.model import Model
from synthcam.scene.film_time import FilmedMotion

SIZE, SCALE, HEIGHT, R = (640, 480), 1.6e-4, 0.5, Model().ball.radius
FILE = PinholeCamera.overhead(SIZE, SCALE, HEIGHT, ball_radius=R, fps=250, exposure=5e-4, psf_sigma_px=1.0)
POINTS = np.array([[x, y, z] for x in (-0.04, 0.0, 0.05) for y in (-0.03, 0.02) for z in (0.0, R)])


def seen(K, dist, turn, t):
    """Project POINTS with OpenCV."""
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


@pytest.mark.parametrize(("name", "stretch"), [("scale_error", (1.01, 1.01)), ("aspect_error", (1.005, 0.995))])
def test_scale_and_aspect_are_other_focal_lengths(name, stretch):
    lens = FILE.K * np.array([[stretch[0], 1, 1], [1, stretch[1], 1], [1, 1, 1]])
    there = seen(lens, FILE.dist, FILE.R, FILE.t)
    camera = bent(name, e=0.01)
    np.testing.assert_allclose(camera.project(POINTS), there, rtol=0, atol=1e-9)
    if name == "scale_error":  # metres a pixel at the balls' height, seen in OpenCV's own picture
        line = np.array([[0.0, 0.0, R], [0.01, 0.0, R]])
        ends = cv2.projectPoints(line, Rotation.from_matrix(FILE.R).as_rotvec(), FILE.t, lens, FILE.dist)[0][:, 0]
        assert camera.scale == pytest.approx(0.01 / np.ptp(ends[:, 0]), rel=1e-12)


SETUP = {"time": 0.1, "v0": 0.4, "b": 0.3, "heading": 0.7, "contact": (0.003, -0.001)}


def filmed(model, frames=60, camera=FILE):
    """Film the collision of a model; `at` gives positions of the balls, `mean` their means over exposures."""
    return FilmedMotion.solve(model, Launch.pair(model.bodies("ab"), **SETUP), camera, frames)


def test_clock_error_is_a_plate_and_a_launch_of_other_numbers():
    """A clock that is fast by e shows, frame by frame, what a right one shows of v0 (1 + e), mu (1 + e)^2 and so on."""
    e, film = 0.02, np.arange(60) / 250
    fast = filmed(Model().replace({"clock_error.e": e})).at(film)
    base, f = Model(), 1 + e
    twin = base.replace(
        {
            "sliding_friction": base.sliding_friction * f**2,
            "rolling_drag": base.rolling_drag * f,
            "rolling_decel": base.rolling_decel * f**2,
        }
    )
    launch = Launch.pair(twin.bodies("ab"), **SETUP | {"time": 0.1 / f, "v0": 0.4 * f})
    np.testing.assert_allclose(
        fast[..., :3], FilmedMotion.solve(twin, launch, FILE, 60).at(film)[..., :3], rtol=0, atol=1e-12
    )


def test_clock_drift_is_a_frame_rate_that_falls_by_2_e_a_second():
    e, t = 0.05, np.arange(200) / 250
    when = Model().replace({"clock_drift.e": e}).laws("clock", t, {"fps": 250, "row": 0.0})
    rate = 1 / np.diff(when)  # frames a second, between frames
    slope = np.gradient(rate / 250, (when[1:] + when[:-1]) / 2)
    assert when[0] == 0
    assert slope[:3] == pytest.approx(-2 * e, rel=0.01)


def test_a_dropped_frame_is_a_film_cut_and_joined():
    """The film of all frames without two of them: frame 30 on are the whole film's 32 on."""
    whole, cut = filmed(Model(), 62), filmed(Model().replace({"dropped_frame.lost": 2.0, "dropped_frame.frame": 30.0}))
    kept = np.delete(np.arange(62), [30, 31]) / 250
    np.testing.assert_allclose(cut.at(np.arange(60) / 250)[..., :2], whole.at(kept)[..., :2], rtol=0, atol=1e-12)


def test_exposure_blur_is_the_mean_over_a_longer_exposure():
    """By a thousand instants of the plain motion, from the frame's opening on."""
    model, longer = Model().replace({"exposure_blur.longer": 1e-3}), 1e-3
    exposure = model.laws("exposure", FILE.exposure, {"fps": FILE.fps})
    view = filmed(model, camera=dataclasses.replace(FILE, exposure=float(exposure)))
    seen_at = view.mean(view.spans(60), lambda states: states[..., :2])
    for k in (5, 40):
        instants = k / 250 + (np.arange(1000) + 0.5) / 1000 * (FILE.exposure + longer)
        by_hand = filmed(Model()).at(instants)[..., :2].mean(axis=1)
        np.testing.assert_allclose(seen_at[:, k], by_hand, rtol=0, atol=1e-9)


def test_rolling_shutter_takes_each_row_at_its_own_time():
    """The plain motion is looked through for when the ball stands in the row that is read then."""
    line, plain = 4e-5, filmed(Model())
    frame = 10 / 250
    instants = frame + np.linspace(0, 480 * line, 20001)
    rows = FILE.project(plain.at(instants)[..., :3])[..., 1]
    read = (instants - frame) / line
    view = filmed(Model().replace({"rolling_shutter.line": line}))
    for ball in (0, 1):
        when = instants[np.argmin(np.abs(rows[ball] - read))]
        assert view.times(np.array([frame]))[ball, 0] == pytest.approx(when, abs=2e-6)


@pytest.mark.parametrize("name", ["glint_parallax", "unknown_lamp"])
def test_a_glint_taken_for_the_centre_is_where_a_mirror_ball_shows_the_lamp(name):
    """The point where the angles of incidence and reflection agree, found afresh; the law is linear in its share."""
    lamp, centre = np.array([0.1, -0.05, 0.45]), np.array([0.02, 0.01, R])

    def unequal(slopes):
        n = np.array([*slopes, np.sqrt(1 - slopes @ slopes)])
        to = [(p - centre - R * n) / np.linalg.norm(p - centre - R * n) for p in (lamp, FILE.centre)]
        return (to[0] + to[1])[:2] - ((to[0] + to[1]) @ n) * n[:2]

    n = fsolve(unequal, np.zeros(2), xtol=1e-13)
    glint = FILE.project(centre + R * np.array([*n, np.sqrt(1 - n @ n)]))
    px = FILE.project(centre)
    shapes = {} if name == "glint_parallax" else dict(zip(("x", "y", "height"), lamp, strict=True))
    model = Model().replace({f"{name}.{k}": v for k, v in {"share": 0.4, **shapes}.items()})

    def mirrored(pixels, where=lamp):
        return pixels + project_glint(FILE, Lamp(np.array(where), 0.01), centre, R) - px

    found = model.laws("measure", px, {"glint": mirrored, "mirrored": mirrored})
    np.testing.assert_allclose(found, px + 0.4 * (glint - px), rtol=0, atol=1e-9)
    assert np.hypot(*(glint - px)) > 0.3


def test_pixel_locking_of_whole_pixels_is_the_first_harmonic_of_rounding():
    """Rounding's error is a saw-tooth; its first Fourier term has the amplitude 1/pi that the text tells."""
    x = (np.arange(4096) + 0.5) / 4096
    first = 2 * np.mean((np.round(x) - x) * np.exp(-2j * np.pi * x))
    off = Model().replace({"pixel_locking.amplitude": 1 / np.pi}).laws("measure", x[:, None], {})[:, 0] - x
    np.testing.assert_allclose(off, (first * np.exp(2j * np.pi * x)).real, rtol=0, atol=1e-5)
