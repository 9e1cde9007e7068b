"""Information and bound against sums over all counts, a closed form, and what is known of motion blur."""

import math

import numpy as np
import pytest
from scipy.stats import norm
from tracker_film import CAMERA, spot

from tracker.camera.camera import Camera, SensorSpec
from tracker.detection.likelihood.cramer_rao import compute_glint_shape, compute_pixel_information, localisation_bound

SENSOR = SensorSpec(bits=8, gain=20, read_noise=20, prnu=0.005, dsnu=4, full_well=6000, black_level=8)


def by_counts(mean, sensor):
    """Fisher information from the probabilities of all counts, without a formula for it."""
    counts = np.arange(2**sensor.bits)

    def logs(m):
        # Rounding is in the variance as 1/12 already (Sheppard): a density, but for the clipped tail.
        deviation = math.sqrt(sensor.variance(np.array([m]))[0])
        tail = norm.logsf(counts[-1] - 0.5, m, deviation)
        return np.append(norm.logpdf(counts[:-1], m, deviation), tail)

    step = 1e-3
    score = (logs(mean + step) - logs(mean - step)) / (2 * step)
    chance = np.exp(logs(mean))
    return float(np.sum(chance * score**2) / np.sum(chance))


@pytest.mark.parametrize("mean", [9.0, 30.0, 120.0, 230.0, 250.0, 254.0, 256.0, 262.0])
def test_information_is_that_of_the_counts(mean):
    assert compute_pixel_information(np.array([mean]), SENSOR)[0] == pytest.approx(by_counts(mean, SENSOR), rel=0.01)


def test_clipping_costs_information():
    wide = SensorSpec(bits=12, gain=20, read_noise=20, full_well=80000, black_level=8)
    narrow = SensorSpec(bits=8, gain=20, read_noise=20, full_well=80000, black_level=8)
    mean = np.array([200.0, 254.5, 300.0])
    ratio = compute_pixel_information(mean, narrow) / compute_pixel_information(mean, wide)
    assert ratio[0] == pytest.approx(1, abs=1e-6)
    assert 0.7 < ratio[1] < 0.9  # half the counts lie at the ceiling; Mills ratio: 1/2 + 1/pi = .82
    assert ratio[2] < 1e-6


def test_full_well_below_the_converter_is_the_ceiling():
    shallow = SensorSpec(bits=12, gain=20, read_noise=20, full_well=6000, black_level=8)
    assert shallow.ceiling == 304
    assert SensorSpec(bits=8, gain=20, full_well=6000, black_level=8).ceiling == 255


@pytest.mark.parametrize("blur", [(0.0, 0.0), (3.0, -2.0), (0.3, 0.1), (11.0, 4.0)])
def test_shape_is_the_integrated_spot(blur):
    half = 12
    made = compute_glint_shape(np.array([[0.3, -0.2]]), np.array([blur]), 1.1, half)
    want = spot((25, 25), half + 0.3, half - 0.2, 1.1, blur, steps=2000)
    assert np.abs(made.value[0] - want).max() < 3e-4 * want.max()
    nudge = 1e-4
    for axis, slope in ((0, made.by_x), (1, made.by_y)):
        step = np.eye(2)[axis] * nudge
        ends = [spot((25, 25), half + 0.3 + s * step[0], half - 0.2 + s * step[1], 1.1, blur, 2000) for s in (1, -1)]
        want_slope = (ends[0] - ends[1]) / (2 * nudge)
        assert np.abs(slope[0] - want_slope).max() < 3e-3 * np.abs(want_slope).max()


def test_bound_in_plain_noise_has_its_closed_form():
    """Var x = 8 pi s^4 v / F^2 for a broad Gaussian in uniform noise v, s^2 with the pixel's own 1/12."""
    data = {
        **CAMERA,
        "psf": {"sigma_px": 3.0},
        "sensor": {"bits": 16, "gain": 1e5, "read_noise": 2e5, "full_well": 1e11, "black_level": 0},
    }
    camera = Camera.from_dict(data)
    cov = localisation_bound(camera, [500.0], [[50.2, 60.4]])[0]
    variance = 4.0 + 1 / 12
    assert cov[0, 0] == pytest.approx(8 * math.pi * (9 + 1 / 12) ** 2 * variance / 500**2, rel=1e-3)
    assert abs(cov[0, 1]) < 1e-3 * cov[0, 0]


def test_bounds_of_the_published_table():
    """Peaks 700 (clipped) ... 12 counts, sigma 1.2 px, 20 e-/count, read noise 20 e-, on a profile of 20 counts."""
    data = {**CAMERA, "psf": {"sigma_px": 1.2}}
    camera = Camera.from_dict(data)
    rng = np.random.default_rng(0)
    xy = rng.uniform(40, 41, (200, 2))
    for peak, want in ((700, 0.0055), (200, 0.0099), (100, 0.0167), (50, 0.0294), (25, 0.0543), (12, 0.107)):
        flux = np.full(200, peak * 2 * math.pi * 1.2**2)
        cov = localisation_bound(camera, flux, xy, background=28.0)
        assert math.sqrt(np.trace(cov, axis1=1, axis2=2).mean() / 2) == pytest.approx(want, rel=0.02)


def test_motion_blur_of_twelve_pixels_triples_the_bound_along_it():
    camera = Camera.from_dict(CAMERA)
    flux = [200 * 2 * math.pi] * 2
    still, drawn = localisation_bound(camera, flux, [[50.1, 50.3]] * 2, [[0, 0], [12, 0]])
    assert 2.2 < math.sqrt(drawn[0, 0] / still[0, 0]) < 4
    assert math.sqrt(drawn[1, 1] / still[1, 1]) < math.sqrt(drawn[0, 0] / still[0, 0])


def test_bound_needs_a_width():
    data = {k: v for k, v in CAMERA.items() if k != "psf"}
    with pytest.raises(ValueError, match="psf"):
        localisation_bound(Camera.from_dict(data), [100.0], [[1.0, 1.0]])
