"""The ball profile: learnt from a clip as it is drawn, and worth what it costs."""

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from tracker_film import disc, expose, spot

from tracker.camera.sensor import SensorSpec
from tracker.detection.likelihood.ball_profile import BallProfile
from tracker.detection.likelihood.cramer_rao import compute_fisher_information, compute_pixel_information
from tracker.detection.likelihood.glint_fit import GlintWindows, fit_glints, learn_profile

SENSOR = SensorSpec(bits=8, gain=20.0, read_noise=20.0, black_level=8.0)
HALF, RADIUS = 5, 7.44
BODY = BallProfile(0.9 * RADIUS, np.array([3.0, 8.0, -2.0]))


def windows(rng, n, peak=200.0, profile=14.0, reach=0.68):
    """Clipped or open glints on a blurred disc whose middle stands off by half a pixel, and their positions."""
    positions, counts = rng.uniform(-0.5, 0.5, (n, 2)), []
    away = np.array([0.5, -0.3])
    for x, y in positions:
        wide = HALF + 8
        picture = gaussian_filter(profile * disc((2 * wide + 1,) * 2, x + wide + 0.5, y + wide - 0.3, RADIUS), 1.0)
        picture += 0.5 + peak * 2 * math.pi * spot(picture.shape, x + wide, y + wide, 1.0)
        counts.append(expose(rng, picture)[8:-8, 8:-8])
    nothing = np.zeros((n, 2))
    middle, offsets = positions + away, np.arange(-HALF, HALF + 1.0)
    square = (offsets[:, None] - middle[:, None, 1:]) ** 2 + (offsets - middle[:, None, :1]) ** 2
    used = (square < (reach * RADIUS) ** 2).astype(float)
    shown = GlintWindows(
        np.array(counts, float), used, positions.round(1), nothing, nothing + away, np.zeros((n, 0, 3))
    )
    return shown, positions


@pytest.mark.parametrize("blur", [(0.0, 0.0), (1.5, -0.7)])
def test_slopes_are_those_of_the_heights(blur):
    middle, way, step = np.array([[0.31, -0.42]]), np.array([blur]), 1e-5
    _, *slopes = BODY.height(middle, way, HALF)
    for axis, slope in enumerate(slopes):
        shift = step * np.eye(2)[axis]
        ahead, behind = (BODY.height(middle + s * shift, way, HALF)[0] for s in (1, -1))
        assert np.allclose(slope, (ahead - behind) / (2 * step), atol=1e-6)


def test_motion_blur_is_the_mean_over_its_way():
    middle, way = np.array([[0.2, 0.1]]), np.array([[1.8, -0.6]])
    mean = np.mean(
        [BODY.height(middle + s * way, 0 * way, HALF)[0] for s in (np.arange(400) + 0.5) / 400 - 0.5], axis=0
    )
    assert np.abs(BODY.height(middle, way, HALF)[0] - mean).max() < 0.01
    assert np.abs(BODY.height(middle, 0 * way, HALF)[0] - mean).max() > 0.05


def test_the_profile_is_learnt_as_it_is_drawn():
    shown, positions = windows(np.random.default_rng(0), 128)
    profile, found = learn_profile(shown, 1.0, SENSOR, 0.9 * RADIUS)
    assert np.std(found - positions) < 0.02  # px
    distance = np.linspace(0, 4.5, 10)
    drawn = gaussian_filter(14.0 * disc((41, 41), 20, 20, RADIUS), 1.0)[20]
    true = np.interp(distance, np.arange(21), drawn[20:])
    learnt = np.array([profile.height(np.array([[d, 0.0]]), np.zeros((1, 2)), 0)[0][0, 0, 0] for d in distance])
    off = learnt - true
    assert np.ptp(off) < 1.5  # counts, of 14; the level is each window's own
    assert np.ptp(true) > 8


def test_a_known_profile_is_worth_more_than_a_bowl_of_ones_own():
    """Clipped glints, whose flanks lie on the profile: nearer to the truth, and by what the covariances say."""
    errors, claims = [], []
    for reach, known in ((0.55, False), (0.68, True)):  # a bowl of its own holds less far out
        shown, positions = windows(np.random.default_rng(1), 400, peak=700.0, reach=reach)
        profile = learn_profile(shown.take(np.arange(128)), 1.0, SENSOR, 0.9 * RADIUS)[0] if known else None
        result = fit_glints(shown, 1.0, SENSOR, profile)
        miss = result.xy - positions
        z = np.linalg.solve(np.linalg.cholesky(result.cov), miss[..., None])
        assert abs(z.std() - 1) < 4 / math.sqrt(2 * z.size)
        errors.append(math.sqrt(np.mean(miss**2)))
        claims.append(math.sqrt(np.trace(result.cov, axis1=1, axis2=2).mean() / 2))
    assert errors[1] < errors[0]
    assert claims[1] < 0.96 * claims[0]


def test_a_profile_holds_information_on_the_position():
    """With the glint's own light gone, the information left is the profile's."""
    middle, still = np.zeros((1, 2)), np.zeros((1, 2))
    value, by_x, by_y = BODY.height(middle, still, HALF)
    told = compute_fisher_information(compute_pixel_information(8.0 + value, SENSOR), np.stack([by_x, by_y], axis=1))[0]
    assert told[0, 0] == pytest.approx(told[1, 1])
    assert 1 / math.sqrt(told[0, 0]) < 0.2  # px
