"""Errors that last over some frames: their size and correlation by what the fit of a parabola leaves."""

import numpy as np
import pytest

from tracker.measurement.local.lasting_errors import LastingErrors, estimate_correlation


def draw(rho, n, count, seed=1):
    """Errors (count, n, 2) of size 1 whose correlation falls by rho from one position to the next."""
    fresh = np.random.default_rng(seed).normal(0, np.sqrt(1 - rho**2), (count, n, 2))
    out = fresh.copy()
    out[:, 0] /= np.sqrt(1 - rho**2)
    for k in range(1, n):
        out[:, k] += rho * out[:, k - 1]
    return out


@pytest.mark.parametrize("rho", [0.0, 0.4, 0.7])
def test_errors_beside_a_parabola_have_the_size_that_its_coefficients_show(rho):
    """The residuals of a fit by least squares, and the scatter of its coefficients, from many draws."""
    n, columns, errors = 36, 3, draw(rho, 36, 3000)
    basis = np.linalg.qr(np.vander(np.arange(n), columns))[0]
    found = np.einsum("nc,knd->kcd", basis, errors)
    left = errors - np.einsum("nc,kcd->knd", basis, found)
    known = LastingErrors.of(rho, n, columns)
    assert known.left == pytest.approx(np.sum(left**2) / (2 * len(left) * (n - columns)), rel=0.02)
    assert known.inflation == pytest.approx(np.mean(found**2), rel=0.05)
    estimates = [estimate_correlation(one, columns) for one in left[:500]]
    assert np.median(estimates) == pytest.approx(rho, abs=0.03)


def test_too_few_residuals_show_no_correlation():
    assert estimate_correlation(np.ones((6, 2)), 3) == 0.0
    assert LastingErrors.of(0.7, 3, 3) == LastingErrors(0.0, 1.0, 1.0)
