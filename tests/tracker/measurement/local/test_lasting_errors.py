"""Errors that last over some frames: their size and correlation by what the fit of a parabola leaves."""

import numpy as np
import pytest

from tracker.measurement.local.lasting_errors import CORRELATIONS, LastingErrors, measure_variances

COLUMNS = 3


def draw(rho, n, count, seed=1):
    """Errors (count, n, 2) of size 1 whose correlation falls by rho from one position to the next."""
    fresh = np.random.default_rng(seed).normal(0, np.sqrt(1 - rho**2), (count, n, 2))
    out = fresh.copy()
    out[:, 0] /= np.sqrt(1 - rho**2)
    for k in range(1, n):
        out[:, k] += rho * out[:, k - 1]
    return out


def fit_parabolas(errors):
    """Coefficients (count, 3, 2) of orthonormal polynomials, by least squares, and the residuals."""
    basis = np.linalg.qr(np.vander(np.linspace(-1, 1, errors.shape[1]), COLUMNS))[0]
    found = np.einsum("nc,knd->kcd", basis, errors)
    return found, errors - np.einsum("nc,kcd->knd", basis, found)


@pytest.mark.parametrize("rho", [0.0, 0.4, 0.7])
def test_errors_beside_a_parabola_have_the_size_that_its_coefficients_show(rho):
    """The residuals of a fit by least squares, and the scatter of its coefficients, from many draws."""
    n, at = 36, int(np.argmin(np.abs(CORRELATIONS - rho)))
    found, left = fit_parabolas(draw(rho, n, 3000))
    known = LastingErrors.of(left[0], COLUMNS)
    assert known.left[at] == pytest.approx(np.sum(left**2) / (2 * len(left) * (n - COLUMNS)), rel=0.02)
    assert known.inflation[at] == pytest.approx(np.mean(found**2), rel=0.05)
    likely = np.sum([LastingErrors.of(one, COLUMNS).log_likelihood for one in left[:300]], axis=0)
    assert CORRELATIONS[np.argmax(likely)] == pytest.approx(rho, abs=0.051)


@pytest.mark.parametrize("n", [5, 9])
@pytest.mark.parametrize("k", [0, 8, 18])
def test_the_likelihood_is_that_of_the_covariance_of_the_residuals(n, k):
    """By a full basis of what is left of n positions beside a parabola, and the size of the errors integrated out."""
    full = np.linalg.qr(np.vander(np.linspace(-1, 1, n), COLUMNS), mode="complete")[0][:, COLUMNS:]
    left = full @ np.random.default_rng(n).normal(size=(n - COLUMNS, 2))

    def expect(rho):
        cov = full.T @ rho ** np.abs(np.subtract.outer(np.arange(n), np.arange(n))) @ full
        square = np.trace((full.T @ left).T @ np.linalg.solve(cov, full.T @ left))
        return -np.linalg.slogdet(cov)[1] - (n - COLUMNS) * np.log(square)

    got = LastingErrors.of(left, COLUMNS).log_likelihood
    assert got[k] - got[4] == pytest.approx(expect(CORRELATIONS[k]) - expect(CORRELATIONS[4]))


@pytest.mark.parametrize(
    ("shape", "rho", "within"),
    [
        ((8, 25, 25), 0.0, (0.64, 0.72)),
        ((36, 36, 36), 0.0, (0.64, 0.72)),
        ((8, 25, 25), 0.5, (0.66, 0.80)),
        ((36, 36, 36), 0.7, (0.66, 0.80)),
    ],
)
def test_claimed_errors_of_velocities_hold(shape, rho, within):
    """Velocities at the ends of parabolas: 68 % are within one claimed error, and more where the errors last."""
    parts, ratios, scores = [], [], []
    for seed, n in enumerate(shape):
        errors = draw(rho, n, 500, seed)
        time = np.linspace(-1, 1, n)
        slope = np.array([2.0, 1.0, 0.0]) @ np.linalg.pinv(np.vander(time, COLUMNS))
        parts.append((fit_parabolas(errors)[1], np.einsum("n,knd->kd", slope, errors) / np.hypot.reduce(slope)))
    freedom = [2.0 * (n - COLUMNS) for n in shape]
    for k in range(500):
        claimed, usual = measure_variances([left[k] for left, _ in parts], freedom, [COLUMNS] * len(shape))
        scores.append([np.abs(velocity[k]) / np.sqrt(own) for (_, velocity), own in zip(parts, claimed, strict=True)])
        ratios.append([*claimed, usual])
    assert within[0] < np.mean(np.array(scores) < 1) < within[1]
    assert 0.92 < np.mean(np.array(scores) < 1.96) < 0.975
    if rho == 0:
        assert np.mean(ratios, axis=0) == pytest.approx(1.0, abs=0.15)


def test_short_stretches_do_not_overstate_independent_errors():
    """Of 8 positions each, the residuals of three stretches hardly show the correlation: twice the variance before."""
    lefts = [fit_parabolas(draw(0.0, 8, 400, seed))[1] for seed in range(3)]
    claimed = [measure_variances([left[k] for left in lefts], [10.0] * 3, [COLUMNS] * 3)[0] for k in range(400)]
    assert 1.0 < np.mean(claimed) < 1.75


def test_too_few_residuals_show_no_correlation():
    few = LastingErrors.of(np.ones((3, 2)), COLUMNS)
    assert (few.left == 1).all()
    assert (few.inflation == 1).all()
    assert (few.log_likelihood == 0).all()
    one_more = np.outer([1.0, -3.0, 3.0, -1.0], [1.0, 0.5])
    assert np.ptp(LastingErrors.of(one_more, COLUMNS).log_likelihood) == pytest.approx(0.0, abs=1e-9)
