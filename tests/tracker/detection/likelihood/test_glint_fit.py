"""The fit of a glint in a window: its own scatter, its end, and windows without information."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from tracker_film import expose, spot

from tracker.camera.sensor import SensorSpec
from tracker.detection.likelihood import glint_fit
from tracker.detection.likelihood.glint_fit import GlintWindows, fit_glints

SENSOR = SensorSpec(bits=8, gain=20.0, read_noise=20.0, prnu=0.01, dsnu=4.0, black_level=8.0)


def shown(rng, n, peak, half=4):
    """Glints of width one near the middle of their windows, and their positions."""
    positions = rng.uniform(-0.5, 0.5, (n, 2))
    flux = peak * 2 * math.pi
    side = 2 * half + 1
    counts = [expose(rng, 4.0 + flux * spot((side, side), half + x, half + y, 1.0)) for x, y in positions]
    nothing = np.zeros((n, 2))
    start = np.clip(positions + rng.normal(0, 0.2, (n, 2)), -1, 1)
    return GlintWindows(np.array(counts, float), np.ones((n, side, side)), start, nothing, nothing, np.zeros((n, 0, 3)))


def negative_loglik(theta, counts, middle, half=4):
    """Negative log-likelihood of one window with a free bowl about a middle; clipped pixels are censored."""
    x, y, flux, level, bowl = theta
    side = 2 * half + 1
    offsets = np.arange(-half, half + 1.0)
    square = (offsets - middle[0]) ** 2 + (offsets[:, None] - middle[1]) ** 2
    mean = np.exp(flux) * spot((side, side), half + x, half + y, 1.0) + level + bowl * square / half**2
    signal = np.maximum(mean - 8.0, 0)
    variance = (20.0**2 + 4.0**2) / 20.0**2 + 1 / 12 + signal / 20.0 + (0.01 * signal) ** 2
    full = counts >= 255
    open_part = ((counts - mean) ** 2 / variance + np.log(variance))[~full].sum() / 2
    z = (254.5 - mean[full]) / np.sqrt(variance[full])
    return open_part - sum(math.log(max(0.5 * math.erfc(v / math.sqrt(2)), 1e-300)) for v in z)


@pytest.mark.parametrize("peak", [25, 200, 500])
def test_the_fit_ends_at_the_greatest_likelihood(peak):
    """One step after a step of some thousandths of a pixel is enough: another minimiser finds the same position."""
    windows = shown(np.random.default_rng(peak), 4, peak)
    found = fit_glints(windows, 1.0, SENSOR)
    for k in range(4):
        begin = [*found.xy[k], math.log(found.flux[k]), found.background[k], 0.0]
        best = minimize(negative_loglik, begin, args=(windows.counts[k], found.xy[k]), method="BFGS", jac="3-point")
        std = np.sqrt(np.diagonal(found.cov[k]))
        assert np.abs((found.xy[k] - best.x[:2]) / std).max() < 0.03
        assert found.loglik[k] == pytest.approx(-best.fun, abs=0.02)


def test_where_it_starts_does_not_matter():
    windows = shown(np.random.default_rng(1), 40, 120.0)
    one = fit_glints(windows, 1.0, SENSOR)
    other = fit_glints(replace(windows, start=np.zeros((40, 2))), 1.0, SENSOR)
    assert one.converged.all()
    std = np.sqrt(np.diagonal(one.cov, axis1=1, axis2=2))
    assert np.abs((one.xy - other.xy) / std).max() < 0.02
    np.testing.assert_allclose(one.cov, other.cov, rtol=0.01, atol=1e-7)
    np.testing.assert_allclose(one.chi2, other.chi2, atol=0.005)  # of .17 that it scatters by


def test_a_secondary_glint_at_a_known_position_has_its_flux_and_does_not_pull():
    """Without noise. A fit that knows of no secondary glint is pulled by hundredths of a pixel."""
    glint, second, side = np.array([0.2, -0.1]), np.array([2.6, -2.1]), 9
    counts = 10.0 + 1200 * spot((side, side), *(4 + glint), 1.0) + 80 * spot((side, side), *(4 + second), 1.0)
    nothing, place = np.zeros((1, 2)), np.array([[[*second, 1.0]]])
    windows = GlintWindows(counts[None], np.ones((1, side, side)), nothing, nothing, nothing, place)
    found = fit_glints(windows, 1.0, SENSOR, tolerance=1e-6)
    assert found.secondary[0, 0] == pytest.approx(80, rel=1e-3)
    assert np.abs(found.xy[0] - glint).max() < 1e-4
    without = fit_glints(replace(windows, secondaries=np.zeros((1, 0, 3))), 1.0, SENSOR)
    assert np.abs(without.xy[0] - glint).max() > 0.01


def test_a_window_without_a_pixel_has_no_information_and_warns_of_nothing():
    windows = shown(np.random.default_rng(2), 3, 120.0)
    windows.used[1] = 0.0
    found = fit_glints(windows, 1.0, SENSOR)
    assert not found.flux[1] > found.flux_std[1]
    assert (found.flux[[0, 2]] > 20 * found.flux_std[[0, 2]]).all()


def test_what_shows_less_light_than_its_error_is_given_up_and_a_dim_glint_is_not(monkeypatch):
    rng, rounds = np.random.default_rng(3), list[int]()
    dim = fit_glints(shown(rng, 200, 6.0), 1.0, SENSOR)
    assert 5 < np.median(dim.flux / dim.flux_std) < 9
    assert dim.converged.all()
    compare = glint_fit._compare
    monkeypatch.setattr(glint_fit, "_compare", lambda part, *rest: (rounds.append(len(part)), compare(part, *rest))[1])
    dark = fit_glints(shown(rng, 200, 1e-3), 1.0, SENSOR)
    assert rounds[0] == 200
    assert sum(rounds[9:]) < 1000, "1480 if none is given up"
    assert not (dark.converged & (dark.flux > 5 * dark.flux_std)).any()
    assert (dark.flux < 5 * dark.flux_std)[~dark.converged].all()
