"""The blur by its band against the whole product; pieces and moments of an exposure against integrals."""

import os
import subprocess
import sys

import numpy as np
import pytest

from synthcam.camera.exposure import blur_matrix, blur_tiles, place_sub_exposures, split_at_breaks


@pytest.mark.parametrize("width", [24, 48, 130])
@pytest.mark.parametrize("steps", [1, 2])
def test_the_blur_by_its_band_is_the_whole_product(width, steps):
    blur = blur_matrix(width, 6, 3, 1.2, steps)
    tiles = np.random.default_rng(0).random((3, blur.shape[1], blur.shape[1]), np.float32)
    expected = blur.astype(float) @ tiles.astype(float) @ blur.T.astype(float)
    np.testing.assert_allclose(blur_tiles(tiles, blur), expected, atol=3e-6)
    whole = blur[width * steps // 2].sum()
    assert whole == pytest.approx(1, abs=1e-5)


def test_the_last_bit_does_not_depend_on_the_number_of_threads():
    code = (
        "import hashlib, numpy as np\n"
        "from synthcam.camera.pinhole import PinholeCamera, Lamp\n"
        "from synthcam.camera.render import MirrorRenderer\n"
        "camera = PinholeCamera.overhead(\n"
        "    (320, 240), 4e-5, .5, ball_radius=1.19e-3, fps=250, exposure=0, psf_sigma_px=1.0)\n"
        "film = MirrorRenderer(camera, Lamp(np.array([.05, 0, .45]), .004), [1.19e-3], .2)\n"
        "position = np.array([[[1e-4, 0, 1.19e-3]]])\n"
        "(picture,) = film.frames(lambda t: np.repeat(position, len(t), 0), [[0, 0]])\n"
        "print(hashlib.sha256(picture.image.tobytes()).hexdigest())\n"
    )
    seen = set()
    for threads in "12":
        environment = os.environ | {"OPENBLAS_NUM_THREADS": threads}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        seen.add(done.stdout)
    assert len(seen) == 1


def test_an_exposure_is_cut_where_a_velocity_jumps():
    bounds, weights, frames = split_at_breaks(
        np.array([[0.0, 1.0], [2.0, 2.0], [3.0, 4.0]]), np.array([0.25, 3.5, 9.0])
    )
    np.testing.assert_array_equal(bounds, [[0, 0.25], [0.25, 1], [2, 2], [3, 3.5], [3.5, 4]])
    np.testing.assert_array_equal(frames, [0, 0, 1, 2, 2])
    np.testing.assert_allclose(weights, [0.25, 0.75, 1, 0.5, 0.5])


@pytest.mark.parametrize("travel", [0.0, 0.3, 4.0])
def test_moments_integrate_motion_and_light(travel):
    bounds, weights, frames = split_at_breaks(np.array([[1.0, 3.0]]), np.array([2.2]))
    turn = 3.0  # rad a second
    moments = place_sub_exposures(bounds, weights, frames, np.full(2, travel), turn * np.diff(bounds, axis=1)[:, 0])
    light = np.cos(turn * moments.times)
    expected = (np.sin(3 * turn) - np.sin(turn)) / (2 * turn)
    assert moments.weights @ light == pytest.approx(expected, abs=2e-3)
    assert moments.weights @ moments.times == pytest.approx(2, abs=1e-12)
    assert len(place_sub_exposures(bounds, weights, frames, np.zeros(2)).times) == 2
