"""Expected errors of positions, against closed forms."""

import math

import numpy as np
import pytest

from discrepancy.planning.experiment import PredictedGlintErrors, StatedErrors
from tracker.camera.camera import Camera

READ_NOISE = 60.0
CAMERA = Camera.from_dict(
    {"scale": 1.6e-4, "size": [640, 480], "fps": 250.0, "ball_diameter": 2.38e-3, "psf": {"sigma_px": 3.0}}
    | {"sensor": {"bits": 16, "gain": 1.0, "read_noise": READ_NOISE, "prnu": 0.0, "dsnu": 0.0}}
)
GLINTS = np.array([[100.2, 200.4], [301.0, 50.5]])


def test_a_dim_glint_of_a_wide_lens_follows_the_law_of_background_noise():
    """std = s^2 sqrt(8 pi v) / flux for a spot of width s on pixels of variance v (Thompson, Larson & Webb 2002)."""
    covariance, fixed = PredictedGlintErrors(peak=2.0).covariances(CAMERA, GLINTS, 0 * GLINTS)
    std = math.sqrt(8 * math.pi * (READ_NOISE**2 + 1 / 12)) / (2 * math.pi * 2.0)
    assert np.sqrt(covariance[:, [0, 1], [0, 1]]) == pytest.approx(std, rel=0.02)
    assert np.all(fixed == 0)


def test_twice_the_light_halves_the_errors_of_dim_glints():
    one, two = (
        e.covariances(CAMERA, GLINTS, 0 * GLINTS)[0]
        for e in (PredictedGlintErrors(2.0), PredictedGlintErrors(2.0).brighter(2))
    )
    assert one == pytest.approx(4 * two, rel=0.02)


def test_a_glint_drawn_out_is_placed_worse_along_its_way():
    blur = np.array([[9.0, 0.0]] * 2)
    still, drawn = (PredictedGlintErrors(100.0).covariances(CAMERA, GLINTS, b)[0] for b in (0 * blur, blur))
    assert np.all(drawn[:, 0, 0] > 1.2 * still[:, 0, 0])
    assert np.all(drawn[:, 0, 0] > 1.05 * drawn[:, 1, 1])


def test_stated_errors_are_as_stated_and_say_nothing_of_light():
    covariance, fixed = StatedErrors(0.03).covariances(CAMERA, GLINTS, GLINTS)
    assert covariance[1] == pytest.approx(9e-4 * np.eye(2))
    assert np.all(fixed == 0)
    assert StatedErrors(0.03).brighter(2.0) is None
