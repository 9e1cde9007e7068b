"""Rays meet a disc where its surface is."""

import numpy as np
import pytest

from synthcam.camera.disc import Disc

DISC, EYE = Disc(0.03, 0.012), np.array([0.1, -0.2, 1.5])


@pytest.mark.parametrize("centre", [[0.0, 0.0, 0.006], [0.4, 0.1, 0.006], [-0.3, -0.5, 0.006]])
def test_rays_to_points_of_the_surface_meet_them(centre):
    """Points of the top, and of the half of the side that looks at the eye."""
    centre, rng = np.array(centre), np.random.default_rng(1)
    radius, turn = DISC.radius * np.sqrt(rng.random(200)) * 0.999, rng.uniform(0, 2 * np.pi, 200)
    top = centre + np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(200, 0.006)])
    out = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(200)])
    side = centre + DISC.radius * out + np.outer(rng.uniform(-0.0059, 0.0059, 200), [0, 0, 1])
    side = side[np.einsum("nk,nk->n", out, EYE - side) > 0.05]
    for points in (top, side):
        far = np.linalg.norm(points - EYE, axis=1)
        ways = (points - EYE) / far[:, None]
        met, distance = DISC.meet(EYE, ways, centre)
        np.testing.assert_allclose(met, points, atol=1e-12)
        np.testing.assert_allclose(distance, far, rtol=1e-12)
        assert (DISC.find_miss(EYE, ways, centre)[0] <= DISC.radius * (1 + 1e-9)).all()
    beside = centre + 1.001 * DISC.radius * out + [0, 0, -0.006]
    outward = np.einsum("nk,nk->n", out, EYE - beside) > 0.05  # seen past the disc, not behind it
    ways = beside[outward] - EYE
    assert (DISC.find_miss(EYE, ways, centre)[0] > DISC.radius).all()
