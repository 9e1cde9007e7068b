"""Projection against OpenCV, glints against the shortest path of light, and what a camera file may be."""

import copy
import dataclasses
import json

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from tracker_film import CAMERA

from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.camera.mirror_images import locate_secondary_glints, locate_zenith_point
from tracker.camera.views import find_first_difference


def bent_camera(tilt=(0.05, -0.03), dist=(-0.2, 0.1, 1e-3, -2e-3, 0.05)):
    data = copy.deepcopy(CAMERA)
    turn, _ = cv2.Rodrigues(np.array([tilt[0], tilt[1], 0.02]))
    data["R"] = (np.diag([1.0, -1, -1]) @ turn).tolist()
    data["dist"] = list(dist)
    return Camera.from_dict(data)


def opencv(camera, points):
    rotation, _ = cv2.Rodrigues(camera.R)
    return cv2.projectPoints(points, rotation, camera.t, camera.K, camera.dist)[0][:, 0]


def test_projection_is_opencvs():
    camera, rng = bent_camera(), np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.02, 0.02, (50, 2)), rng.uniform(0, 0.01, 50)])
    assert np.allclose(camera.project(points), opencv(camera, points), atol=1e-9)
    straight = Camera.from_dict(CAMERA)
    assert np.abs(straight.project(points) - opencv(camera, points)).max() > 1  # the lens and tilt do matter


@settings(max_examples=25, deadline=None)
@given(st.floats(-0.015, 0.015), st.floats(-0.012, 0.012), st.floats(-0.1, 0.1), st.floats(-0.3, 0.3))
def test_unproject_undoes_project(x, y, tilt, k1):
    camera = bent_camera((tilt, -tilt), (k1, 0.0, 1e-3, 0.0, 0.0))
    pixel = camera.project(np.array([[x, y, camera.radius]]))
    position, jacobian = camera.unproject(pixel)
    assert np.allclose(position, [[x, y]], atol=1e-12)
    nudge = 1e-3
    for axis in range(2):
        step = np.eye(2)[axis] * nudge
        slope = (camera.unproject(pixel + step)[0] - camera.unproject(pixel - step)[0]) / (2 * nudge)
        assert np.allclose(slope, jacobian[:, :, axis], rtol=1e-5, atol=1e-10)


def test_scale_holds_at_the_balls_centres():
    camera = Camera.from_dict(CAMERA)
    position, jacobian = camera.unproject(np.array([[99.5, 79.5], [109.5, 79.5]]))
    assert np.allclose(position, [[0, 0], [1.6e-3, 0]], atol=1e-15)
    assert np.allclose(jacobian[0], np.diag([1.6e-4, -1.6e-4]))


def shortest_path(camera, centre):
    """Find where light of the lamp reaches the camera by the sphere: the least length over its upper half (Fermat)."""
    lamp, eye = np.array(camera.lamp.position), camera.position

    def point(flat):
        return centre + camera.radius * np.array([*flat, np.sqrt(1 - flat @ flat)])

    def length(flat):
        p = point(flat)
        return 1e6 * (np.linalg.norm(p - lamp) + np.linalg.norm(p - eye) - 0.9)

    best = minimize(length, [0.01, 0.02], method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-13})
    return camera.project(point(best.x))


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.06, -0.04)])
def test_glint_is_the_shortest_path(tilt):
    camera = bent_camera(tilt)
    for x, y in [(0.0, 0.0), (0.012, -0.009), (-0.011, 0.01)]:
        want = shortest_path(camera, np.array([x, y, camera.radius]))
        assert np.allclose(camera.glint_of_centre([[x, y]])[0], want, atol=1e-4)


def test_glint_stands_where_physics_says():
    """R [(x_lamp - x)/h_lamp - (x_camera - x)/h_camera]/2, to first order."""
    camera = Camera.from_dict(CAMERA)
    x = 0.01
    offset = (camera.glint_of_centre([[x, 0.0]])[0, 0] - camera.project([x, 0, camera.radius])[0]) * camera.scale
    assert offset == pytest.approx(camera.radius * ((0.05 - x) / 0.45 + x / 0.5) / 2, rel=0.02)
    assert offset > 0.3 * camera.scale  # and it is not small: three tenths of a pixel


def test_centre_of_glint_undoes_glint_of_centre():
    camera = bent_camera()
    positions = np.random.default_rng(1).uniform(-0.012, 0.012, (40, 2))
    seen = camera.glint_of_centre(positions)
    centre, jacobian = camera.centre_of_glint(seen)
    want = camera.project(np.column_stack([positions, np.full(40, camera.radius)]))
    assert np.allclose(centre, want, atol=1e-9)
    moved = camera.centre_of_glint(seen + np.array([0.1, 0.0]))[0] - centre
    assert np.allclose(moved, 0.1 * jacobian[:, :, 0], atol=1e-7)


def test_rings_of_the_mirrored_sky_stand_between_zenith_and_centre():
    """Points of the ball that mirror the sky 60 degrees from the zenith, by the law of reflection."""
    camera, position = Camera.from_dict(CAMERA), np.array([[0.05, -0.04]])
    glint, middle = camera.glint_of_centre(position), np.array([*position[0], camera.radius])
    turn, lean = np.meshgrid(np.arange(0, 2 * np.pi, np.pi / 18), np.radians(np.linspace(25, 35, 2001)), indexing="ij")
    normal = np.stack([np.cos(turn) * np.sin(lean), np.sin(turn) * np.sin(lean), np.cos(lean)], axis=-1)
    way = middle + camera.radius * normal - camera.position
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    up = (way - 2 * np.sum(way * normal, axis=-1, keepdims=True) * normal)[..., 2]
    each, ring = np.arange(len(up)), np.argmin(np.abs(up - 0.5), axis=1)
    seen = camera.project(middle + camera.radius * normal[each, ring])
    rows = np.column_stack([2 * seen, np.ones(len(seen))])
    circle = np.linalg.lstsq(rows, np.sum(seen**2, axis=1), rcond=None)[0][:2]
    assert np.abs(locate_zenith_point(camera, glint, np.cos(np.pi / 6))[0] - circle).max() < 0.003
    assert np.abs(locate_zenith_point(camera, glint, 1.0)[0] - circle).max() > 0.04


@pytest.mark.parametrize("missing", ["lamp", "ball_diameter"])
def test_no_correction_without_what_it_needs(missing):
    data = {k: v for k, v in CAMERA.items() if k != missing}
    camera = Camera.from_dict(data)
    seen = np.array([[50.0, 60.0]])
    assert not camera.corrects_glint
    assert missing in camera.assumed
    assert np.array_equal(camera.centre_of_glint(seen)[0], seen)


def test_secondary_glint_is_the_shortest_path_by_two_balls():
    camera = Camera.from_dict(CAMERA)
    one, two = np.array([0.001, 0.002]), np.array([0.001, 0.002]) + camera.ball_diameter * np.array([0.8, 0.6]) * 1.02
    first, last = (np.array([*p, camera.radius]) for p in (two, one))
    lamp, eye = np.array(camera.lamp.position), camera.position

    def corner(centre, flat):
        return centre + camera.radius * np.array([*flat, np.sqrt(max(1e-12, 1 - flat @ flat))])

    def length(q):
        a, b = corner(first, q[:2]), corner(last, q[2:])
        legs = np.linalg.norm(a - lamp) + np.linalg.norm(b - a) + np.linalg.norm(eye - b)
        return 1e6 * (legs - 0.9)

    start = 0.7 * np.array([-0.8, -0.6, 0.8, 0.6])
    best = minimize(
        length, start, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12, "maxiter": 20000, "maxfev": 20000}
    )
    seen = locate_secondary_glints(camera, camera.glint_of_centre([one]), camera.glint_of_centre([two]))
    assert np.allclose(seen[0], camera.project(corner(last, best.x[2:])), atol=2e-3)


def test_least_camera_file():
    camera = Camera.from_dict({"scale": 1e-4, "size": [64, 48], "fps": 100})
    assert {"height", "lamp", "psf.sigma_px", "sensor.gain", "ball_diameter", "exposure"} <= set(camera.assumed)
    position, _ = camera.unproject(np.array([[41.5, 23.5]]))
    assert np.allclose(position, [[1e-3, 0]], atol=1e-12)
    given = Camera.from_dict(
        {
            "K": [[2000, 0, 31.5], [0, 2000, 23.5], [0, 0, 1]],
            "t": [0, 0, 0.4],
            "size": [64, 48],
            "fps": 100,
            "ball_diameter": 2e-3,
        }
    )
    assert given.scale == pytest.approx((0.4 - 1e-3) / 2000)


def test_camera_survives_its_file(tmp_path):
    camera = bent_camera()
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(camera.to_dict()))
    again = Camera.read(path)
    assert again.to_dict() == camera.to_dict()


@pytest.mark.parametrize(
    ("key", "value", "word"),
    [
        ("fps", 0, "fps"),
        ("fps", float("nan"), "fps"),
        ("fps", "fast", "fps"),
        ("size", [640], "size"),
        ("size", [640.5, 480], "size"),
        ("K", [[1, 2], [3, 4]], "K"),
        ("K", [[-3000, 0, 1], [0, 3000, 1], [0, 0, 1]], "K"),
        ("R", [[2, 0, 0], [0, 1, 0], [0, 0, 1]], "R"),
        ("t", [0, 0, None], "t"),
        ("exposure", 0.1, "exposure"),
        ("ball_diameter", -1, "ball_diameter"),
        ("striker", "c", "striker"),
        ("lamp", [1, 2, 3], "lamp"),
        ("lamp", {"position": [0, 0]}, "lamp.position"),
        ("psf", {"sigma_px": 0}, "psf.sigma_px"),
        ("sensor", {"bits": 8.5}, "sensor.bits"),
        ("sensor", {"gain": True}, "sensor.gain"),
    ],
)
def test_bad_camera_file_is_named_with_its_key(tmp_path, key, value, word):
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({**CAMERA, key: value}))
    with pytest.raises(InputError) as error:
        Camera.read(path)
    text = str(error.value)
    assert text.startswith(f"{path}: {word}: expected")
    assert "\n" not in text


@pytest.mark.parametrize("text", ["", "[1, 2]", "{", '{"fps": 250, "size": [64, 48]}'])
def test_what_is_no_camera_file(tmp_path, text):
    path = tmp_path / "camera.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"camera\.json"):
        Camera.read(path)
    with pytest.raises(InputError, match="no such file"):
        Camera.read(tmp_path / "none.json")


@pytest.mark.parametrize(
    ("key", "told"),
    [
        ("K", [[3117.6, 0, 99.5], [0, 3117.5625, 79.5], [0, 0, 1]]),
        ("dist", [1e-4, 0, 0, 0, 0]),
        ("t", [0, 1e-5, 0.5]),
        ("size", [200, 162]),
        ("fps", 260.0),
        ("exposure", 6e-4),
        ("shutter", {"kind": "rolling", "line_time": 1e-6}),
        ("ball_diameter", 2.4e-3),
        ("lamp", {"position": [0.05, 1e-4, 0.45], "radius": 0.0}),
        ("lamp", None),
        ("warp", {"x": [0, 1, 2, 3], "y": [0, 1, 2, 3], "dx": [[1e-5] * 4] * 4, "dy": [[0] * 4] * 4}),
    ],
)
def test_another_camera_differs_in_what_locates_a_ball(key, told):
    other = {k: v for k, v in (CAMERA | {key: told}).items() if v is not None}
    one, two = Camera.from_dict(CAMERA), Camera.from_dict(other)
    named = "line_time" if key == "shutter" else key
    assert find_first_difference(one, two) == find_first_difference(two, one) == named


def test_a_turned_camera_differs():
    straight, turned = bent_camera((0, 0), (0,) * 5), bent_camera((0, 1e-4), (0,) * 5)
    assert find_first_difference(straight, turned) == "R"


def test_a_camera_differs_from_none_that_locates_a_ball_alike():
    anew = {"psf": {"sigma_px": 1.2}, "sensor": CAMERA["sensor"] | {"gain": 21}, "fps": 250.0 * (1 + 1e-9)}
    one, two = Camera.from_dict(CAMERA), Camera.from_dict(CAMERA | anew)
    assert find_first_difference(one, dataclasses.replace(two, exposure_from_blur=6e-4, striker="a")) == ""
