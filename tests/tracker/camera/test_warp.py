"""The warp of a camera file: splines against a polynomial, the way back, and what is refused."""

import numpy as np
import pytest
from tracker_film import CAMERA

import tracker
from synthcam_shared.errors import InputError
from tracker.camera.warp import Warp

ERROR = {"std": 1e-4, "length": 0.1}
KNOTS = {"x": [0, 1, 2, 3], "y": [0, 1, 2, 3], "dx": [[0] * 4] * 4, "dy": [[0] * 4] * 4}
X, Y = np.linspace(-0.016, 0.016, 7), np.linspace(-0.012, 0.012, 5)


def cubic(x, y):
    """Displacements that splines of third order hold exactly, m."""
    return 3e-4 * (x / 0.016) ** 2 * (y / 0.012), 2e-4 * (y / 0.012) ** 3 - 1e-4 * x / 0.016


def make_warp():
    across, down = np.meshgrid(X, Y)
    return Warp(X, Y, *cubic(across, down))


@pytest.fixture
def camera():
    return tracker.Camera.from_dict(CAMERA | {"warp": make_warp().to_dict()})


def test_the_splines_hold_a_cubic_and_its_slope():
    at = np.random.default_rng(1).uniform((X[0], Y[0]), (X[-1], Y[-1]), (50, 2))
    shift, slope = make_warp().displace(at)
    np.testing.assert_allclose(shift, np.column_stack(cubic(*at.T)), atol=1e-12)
    for axis in (0, 1):
        step = 1e-7 * np.eye(2)[axis]
        ends = [np.column_stack(cubic(*(at + sign * step).T)) for sign in (1, -1)]
        np.testing.assert_allclose(slope[..., axis], (ends[0] - ends[1]) / 2e-7, atol=1e-7)


def test_beyond_the_knots_the_displacement_stays():
    (corner,), (beyond,) = (make_warp().displace(np.array([at]))[0] for at in ((X[-1], Y[-1]), (1.0, 2.0)))
    np.testing.assert_array_equal(beyond, corner)
    assert not make_warp().displace(np.array([[1.0, 2.0]]))[1].any()


def test_a_camera_projects_back_what_it_sees(camera):
    pixels = np.random.default_rng(2).uniform((5, 10), (194, 149), (40, 2))
    position, slope = camera.unproject(pixels)
    plain = tracker.Camera.from_dict(CAMERA).unproject(pixels)[0]
    np.testing.assert_allclose(position - plain, np.column_stack(cubic(*plain.T)), atol=1e-12)
    level = np.full((40, 1), camera.centre_height)
    np.testing.assert_allclose(camera.project(np.concatenate([position, level], axis=1)), pixels, atol=1e-7)
    for axis in (0, 1):
        step = 1e-3 * np.eye(2)[axis]
        numeric = (camera.unproject(pixels + step)[0] - camera.unproject(pixels - step)[0]) / 2e-3
        np.testing.assert_allclose(slope[..., axis], numeric, rtol=1e-5, atol=1e-9)
    again = tracker.Camera.from_dict(camera.to_dict())
    np.testing.assert_array_equal(again.unproject(pixels)[0], position)


def test_maps_of_errors_are_read_and_displace_as_a_warp_does():
    maps = [make_warp(), Warp(X, Y, *(0.1 * shift for shift in cubic(*np.meshgrid(X, Y))))]
    given = (
        make_warp().to_dict() | ERROR | {"errors": [{key: one.to_dict()[key] for key in ("dx", "dy")} for one in maps]}
    )
    read = Warp.of(given)
    assert read.to_dict() == given
    at = np.random.default_rng(3).uniform((X[0], Y[0]), (X[-1], Y[-1]), (20, 2))
    for one, expected in zip(read.error_maps, maps, strict=True):
        np.testing.assert_array_equal(one.displace(at)[0], expected.displace(at)[0])


def test_a_table_in_metres_is_corrected(camera):
    """Its positions are those of another map: the warp displaces them too."""
    import pandas as pd

    rows = pd.DataFrame({"frame": np.arange(30), "particle": 0, "x": np.linspace(-0.01, 0.01, 30), "y": 0.003})
    moved = tracker.measure(rows, camera, unit="m")
    stayed = tracker.measure(rows, CAMERA, unit="m")
    found = camera.unproject(moved.tracks[["x", "y"]].to_numpy())[0]
    plain = stayed.camera.unproject(stayed.tracks[["x", "y"]].to_numpy())[0]
    np.testing.assert_allclose(found - plain, np.column_stack(cubic(*plain.T)), atol=1e-9)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ([1, 2], "warp: expected a table with x, y, dx and dy"),
        ({"x": [0, 1]}, "a table with x, y, dx and dy"),
        ({"x": ["a"], "y": [0, 1], "dx": [], "dy": []}, "numbers in x, y, dx and dy"),
        (KNOTS | {"x": [1, 0, 2, 3]}, "4 to 64 knots x in increasing order"),
        (KNOTS | {"dx": [[0] * 4]}, "dx and dy of 4 rows of 4 numbers"),
        (KNOTS | {"dx": [[0, 0, np.nan, 0]] * 4}, "dx and dy of 4 rows"),
        (KNOTS | {"std": 1e-4}, "std and length above 0, m, or none of them"),
        (KNOTS | {"std": -1e-4, "length": 0.1}, "std and length above 0"),
        (KNOTS | {"dx": [[0, 0, 0.5, 0]] * 4}, "change by less than 0.2 m over a"),
        (KNOTS | {"errors": []}, "std and length above 0"),
        (KNOTS | ERROR | {"errors": {}}, "errors that are a list of at most 16 tables, each with dx and dy"),
        (KNOTS | ERROR | {"errors": [{"dx": [[0] * 4] * 4}]}, "errors that are a list of at most 16 tables"),
        (
            KNOTS | ERROR | {"errors": [{"dx": [[0] * 4] * 4, "dy": [[0] * 3] * 4}]},
            "dx and dy of 4 rows of 4 numbers in",
        ),
    ],
)
def test_nonsense_is_refused(given, expected):
    with pytest.raises(InputError) as refused:
        tracker.Camera.from_dict(CAMERA | {"warp": given})
    assert expected in str(refused.value)
