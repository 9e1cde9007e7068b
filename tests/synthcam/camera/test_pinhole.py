"""The camera against OpenCV, the glint against a first-order formula and a brute search."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from synthcam.camera import reflections
from synthcam.camera.pinhole import Lamp, PinholeCamera, locate_glint, project_glint

RADIUS = 1.19e-3
LAMP = Lamp(np.array([0.05, 0.0, 0.45]), 0.01)


def overhead(**changes):
    settings = {"size": (640, 480), "scale": 1.6e-4, "height": 0.5, "ball_radius": RADIUS}
    return PinholeCamera.overhead(**settings | {"fps": 250, "exposure": 5e-4, "psf_sigma_px": 1.0} | changes)


def test_the_contract_of_the_overhead_camera():
    camera = overhead()
    scale = 1.6e-4
    points = np.array([[0, 0, 0], [0, 0, RADIUS], [10 * scale, 0, RADIUS], [0, 10 * scale, RADIUS]])
    expected = [[319.5, 239.5], [319.5, 239.5], [329.5, 239.5], [319.5, 229.5]]
    np.testing.assert_allclose(camera.project(points), expected, atol=1e-9)
    np.testing.assert_allclose(camera.centre, [0, 0, 0.5], atol=1e-15)


@given(st.tuples(*[st.floats(-0.3, 0.3)] * 2), st.tuples(*[st.floats(-0.05, 0.05)] * 2))
def test_a_tilted_camera_still_looks_at_the_origin(tilt, position):
    camera = overhead(tilt=tilt)
    np.testing.assert_allclose(camera.project([0, 0, 0]), [319.5, 239.5], atol=1e-9)
    assert np.linalg.norm(camera.centre) == pytest.approx(0.5)
    np.testing.assert_allclose(camera.R @ camera.R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(camera.R) == pytest.approx(1)
    a, b = tilt
    expected = 0.5 * np.array([np.sin(b) * np.cos(a), -np.sin(a), np.cos(a) * np.cos(b)])
    np.testing.assert_allclose(camera.centre, expected, atol=1e-12)


@given(st.tuples(*[st.floats(-0.2, 0.2)] * 5), st.tuples(*[st.floats(-0.05, 0.05)] * 2))
def test_projection_is_opencvs(distortion, position):
    camera = overhead(tilt=(0.02, -0.03), distortion=distortion)
    point = np.array([*position, RADIUS])
    expected = cv2.projectPoints(point, cv2.Rodrigues(camera.R)[0], camera.t, camera.K, camera.dist)[0]
    np.testing.assert_allclose(camera.project(point), expected[0, 0], atol=1e-7)
    slope = camera.project_with_slope(point)[1]
    for axis in np.eye(3):
        ahead, behind = camera.project(point + 1e-6 * axis), camera.project(point - 1e-6 * axis)
        np.testing.assert_allclose(slope @ axis, (ahead - behind) / 2e-6, atol=1e-2)


def test_a_point_behind_the_camera_is_nowhere():
    assert np.isnan(overhead().project([0, 0, 0.6])).all()


def test_a_camera_inside_the_ball_is_refused():
    with pytest.raises(ValueError, match="camera height"):
        overhead(height=1e-3)


@given(st.tuples(*[st.floats(-0.05, 0.05)] * 2))
def test_glint_agrees_with_the_first_order_formula(position):
    """R [(x_lamp - x)/h_lamp - (x_camera - x)/h_camera]/2: half the lamp's tilt, less the parallax."""
    camera = overhead()
    centre = np.array([*position, RADIUS])
    to_lamp, to_camera = LAMP.position - centre, camera.centre - centre
    offset = (project_glint(camera, LAMP, centre, RADIUS) - camera.project(centre)) * [1, -1]
    formula = RADIUS / 2 * (to_lamp / to_lamp[2] - to_camera / to_camera[2])[:2] / camera.scale
    np.testing.assert_allclose(offset, formula, atol=0.015)  # what second order leaves in the corners


def test_the_glint_is_where_the_path_is_shortest():
    camera = overhead(tilt=(0.05, 0.1))
    centre = np.array([0.03, -0.02, RADIUS])

    def length(angles):
        x, y = np.sin(angles)
        point = centre + RADIUS * np.array([x, y, np.sqrt(1 - x * x - y * y)])
        return 1e4 * (np.linalg.norm(point - LAMP.position) + np.linalg.norm(point - camera.centre))

    best = np.sin(minimize(length, [0, 0], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-13}).x)
    found = (locate_glint(camera, LAMP, centre, RADIUS) - centre)[:2] / RADIUS
    np.testing.assert_allclose(found, best, atol=2e-5)  # fatol in rounding: sqrt(1e-16 x .95 m / R)


@given(
    st.integers(1, 9),
    st.floats(2.0, 12),
    st.floats(0, 6.3),
    st.floats(-0.05, 0.05),
    st.floats(-0.3, 0.3),
)
def test_every_bounce_keeps_the_law_of_reflection(order, gap, heading, x, tilt):
    """Checked vector by vector, and the transfer matrix by moving the lamp: nothing of Newton's is used."""
    eye = overhead(tilt=(tilt, 0)).centre
    first = np.array([x, 0.01, RADIUS])
    other = first + gap * RADIUS * np.array([np.cos(heading), np.sin(heading), 0])
    centres = np.array([[first, other][k % 2] for k in range(order)])[None]
    radii = np.full((1, order), RADIUS)
    paths = reflections.reflect(LAMP.position, eye, centres, radii)
    assert paths.exists.all()
    points = np.vstack([LAMP.position, paths.points[0], eye])
    for k in range(1, order + 1):
        normal = (points[k] - centres[0, k - 1]) / RADIUS
        assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-12)
        into = (points[k] - points[k - 1]) / np.linalg.norm(points[k] - points[k - 1])
        out = (points[k + 1] - points[k]) / np.linalg.norm(points[k + 1] - points[k])
        np.testing.assert_allclose(into - 2 * (into @ normal) * normal, out, atol=1e-9)
        assert out @ normal > 0
    h = 1e-4
    for axis in range(2):
        move = h * np.eye(3)[axis]
        ahead = reflections.reflect(LAMP.position + move, eye, centres, radii).points[0, -1]
        behind = reflections.reflect(LAMP.position - move, eye, centres, radii).points[0, -1]
        np.testing.assert_allclose(paths.transfer[0, :, axis], (ahead - behind) / (2 * h), atol=1e-8)


def test_a_line_straight_through_a_ball_reflects_nothing():
    eye, lamp = np.array([0, 0, 0.5]), np.array([0, 0, -0.5])
    paths = reflections.reflect(lamp, eye, np.zeros((1, 1, 3)), np.full((1, 1), RADIUS))
    assert not paths.exists.any()


def test_a_third_ball_in_the_way_hides_the_glint():
    eye, lamp = np.array([0, 0, 0.5]), np.array([0.5, 0, 0.5])
    centres = np.array([[[0, 0, RADIUS], [3 * RADIUS, 0, 3.5 * RADIUS]], [[0, 0, RADIUS], [0.1, 0, RADIUS]]])
    radii = np.full(2, RADIUS)
    paths = reflections.reflect(lamp, eye, centres[:, :1], np.full((2, 1), RADIUS))
    near = reflections.find_neighbours(centres, reflections.find_blocking_distance(lamp, eye, centres, radii, 0.0))
    hidden = reflections.find_blocked_paths(lamp, eye, paths, np.zeros((2, 1), int), centres, radii, np.arange(2), near)
    np.testing.assert_array_equal(hidden, [True, False])
