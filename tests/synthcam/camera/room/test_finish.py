"""Patterns and textures."""

import numpy as np
import pytest

from synthcam.camera.room.finish import BallFinish, SurfaceFinish
from synthcam.camera.room.texture import compute_texture

PATTERNS = ("plain", "half", "stripe", "spots")


@pytest.mark.parametrize("pattern", PATTERNS)
def test_the_mean_is_that_of_the_whole_ball(pattern):
    rng = np.random.default_rng(3)
    ways = rng.standard_normal((200_000, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    finish = BallFinish((0.2, 0.4, 0.8), (0.9, 0.1, 0.3), pattern)
    np.testing.assert_allclose(finish.paint(ways, 1e-3).mean(axis=0), finish.mean, atol=5e-3)


def test_half_is_on_the_balls_own_axis():
    finish = BallFinish((0.1,), (0.9,), "half")
    painted = finish.paint(np.array([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0]]), 0.01)
    assert painted[:, 0].tolist() == [pytest.approx(0.9), pytest.approx(0.1), pytest.approx(0.5)]


@pytest.mark.parametrize("texture", ["cloth", "wood", "paper"])
def test_textures_are_still_even_on_the_whole_and_differ_by_seed(texture):
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.5, 0.5, (100_000, 2))
    look = SurfaceFinish((), (0.5, 0.4, 0.3), texture)
    found = compute_texture(look, points)
    np.testing.assert_array_equal(found, compute_texture(look, points))
    assert found.mean() == pytest.approx(1, abs=0.06)
    assert 0.01 < found[:, 0].std() < 0.3
    assert found.min() > 0
    assert not np.array_equal(found, compute_texture(SurfaceFinish((), (0.5, 0.4, 0.3), texture, seed=1), points))
    assert np.all(compute_texture(SurfaceFinish((), (0.5,), texture, contrast=0.0), points) == 1)
