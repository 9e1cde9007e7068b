"""The blur by its band against the whole product; pieces and moments of an exposure against integrals."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

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
    """Of tiles so large that that of the whole product depends on it."""
    blur, seen = blur_matrix(200, 6, 3, 1.2, 2), set()
    tiles = np.random.default_rng(0).random((2, blur.shape[1], blur.shape[1]), np.float32)
    for threads in (1, 2):
        with threadpool_limits(threads, "blas"):
            assert {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"} == {threads}
            seen.add(blur_tiles(tiles, blur).tobytes())
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
