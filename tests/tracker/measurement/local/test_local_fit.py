"""Fits of one stretch: the end of its slide, and the window that is fitted."""

import numpy as np
import pytest

from tracker.measurement.local.local_fit import choose_window, fit_single_stretch
from tracker.measurement.local.stretches import ROLL, SLIDE, SLIDE_AND_ROLL, Stretch

NOISE = 1e-6


def make_stretch(path, time, seed=1):
    n, noise = len(time), np.random.default_rng(seed).normal(0, NOISE, (len(time), 2))
    cov = np.tile(np.eye(2) * NOISE**2, (n, 1, 1))
    return Stretch(1, True, time, path + noise, cov, np.zeros_like(cov), np.zeros(n, dtype=bool))


@pytest.mark.parametrize("seed", range(8))
def test_a_slide_that_outlasts_the_stretch_is_no_short_slide_with_a_large_loss(seed):
    time = np.arange(1, 23) * 4e-3
    stretch = make_stretch(np.outer(time, [0.4, 0.4]) - np.outer(time**2 / 2, [1.1, 1.1]), time, seed)
    found = fit_single_stretch(stretch, 0.0, SLIDE_AND_ROLL)
    assert np.exp(found.values[6]) > 0.7 * np.ptp(time)
    assert found.values[2:4] == pytest.approx([0.4, 0.4], abs=1e-3)
    assert found.chi2 < 2 * found.dof


@pytest.mark.parametrize(("force_from", "longest"), [(np.inf, 1.0), (0.12, 0.25)])
def test_a_window_ends_before_a_force_that_the_motions_lack(force_from, longest):
    time = np.arange(1, 51) * 4e-3
    path = np.outer(time, [0.4, 0.1]) + np.outer(np.maximum(time - force_from, 0) ** 2, [0.0, 30.0])
    window = choose_window(make_stretch(path, time), 0.0, (SLIDE, ROLL, SLIDE_AND_ROLL))
    assert longest * 0.2 <= window.time[-1] <= max(longest * 0.2, min(force_from, 0.2)) + 8e-3
