"""The closed forms of light against sums over many directions."""

import numpy as np
import pytest

from synthcam.camera.room.view_factors import compute_form_factor, mean_cosine_above_horizon, visible_fraction

MANY = 200_000


def random_ways(rng, normal):
    """Directions about a normal, as likely as their cosine is large."""
    sphere = rng.standard_normal((MANY, 3))
    ways = normal + sphere / np.linalg.norm(sphere, axis=1, keepdims=True)
    return ways / np.linalg.norm(ways, axis=1, keepdims=True)


@pytest.mark.parametrize("seed", range(12))
def test_share_of_a_hemisphere_that_a_ball_takes(seed):
    rng = np.random.default_rng(seed)
    normal, offset = rng.standard_normal((2, 3))
    normal, offset = normal / np.linalg.norm(normal), offset / np.linalg.norm(offset) * (1.001 + rng.exponential(0.6))
    ways = random_ways(rng, normal)
    along = ways @ offset
    hit = (along > 0) & (along**2 - offset @ offset + 1 > 0)
    assert compute_form_factor(normal[None], offset[None], 1.0)[0] == pytest.approx(hit.mean(), abs=5e-3)


def test_a_ball_on_the_plate():
    """Known: a sphere that touches the element's plane r from it takes (1 + r^2)^(-3/2)."""
    r = np.linspace(0.01, 5, 30)
    offset = np.stack([r, 0 * r, 1 + 0 * r], axis=1)
    found = compute_form_factor(np.broadcast_to([0.0, 0.0, 1.0], offset.shape), offset, 1.0)
    np.testing.assert_allclose(found, (1 + r * r) ** -1.5, rtol=1e-6)


@pytest.mark.parametrize(("cosine", "sine"), [(0.5, 0.1), (0.05, 0.1), (0.0, 0.2), (-0.07, 0.1), (-0.2, 0.1)])
def test_a_disc_that_sets(cosine, sine):
    x, y = np.meshgrid(*[np.linspace(-1, 1, 1501)] * 2)
    inside = x[x * x + y * y < 1]
    expected = np.maximum(cosine + sine * inside, 0).mean()
    assert mean_cosine_above_horizon(np.array(cosine), np.array(sine)) == pytest.approx(expected, abs=2e-4)


@pytest.mark.parametrize("a", [0.02, 0.3])
@pytest.mark.parametrize("apart", [0.0, 0.1, 0.29, 0.31, 0.45, 0.9])
def test_what_one_disc_leaves_of_another(a, apart):
    b = 0.3
    x, y = a * np.array(np.meshgrid(*[np.linspace(-1, 1, 1501)] * 2))
    inside = x * x + y * y < a * a
    left = (np.hypot(x - apart, y) > b) & inside
    assert visible_fraction(np.array([a]), np.array([b]), np.array([apart]))[0] == pytest.approx(
        left.sum() / inside.sum(), abs=2e-3
    )


def test_a_small_disc_before_a_large_one():
    assert visible_fraction(np.array([0.2]), np.array([0.1]), np.array([0.05]))[0] == pytest.approx(0.75)
