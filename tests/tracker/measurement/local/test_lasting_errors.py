"""Errors that last over some frames: their size and correlation by what the fit of a parabola leaves."""

import numpy as np
import pytest

from tracker.measurement.local.lasting_errors import CORRELATIONS, LastingErrors, measure_variances

COLUMNS, FIRST = 3, 2.25  # coefficients of the path; frames from the contact to the first position


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


def average(errors, count):
    """Means of so many neighbours each, times the root of their number: independent errors keep their size."""
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    return np.add.reduceat(errors, first, axis=1) / np.sqrt(count)[:, None]


def fit_velocities(errors, count):
    """Velocities (k, 2) at the contact, over their independent errors, of parabolas by least squares; the residuals."""
    since = np.cumsum(count) - (count - 1) / 2 + FIRST - 1
    shapes = np.vander(since, COLUMNS, increasing=True) * np.sqrt(count)[:, None]
    inverse = np.linalg.pinv(shapes)
    found = np.einsum("cn,knd->kcd", inverse, errors)
    return found[:, 1] / np.linalg.norm(inverse[1]), errors - np.einsum("nc,kcd->knd", shapes, found)


COUNTS = {"even": np.ones(36, int), "averaged far off": np.r_[np.ones(25, int), np.full(10, 4)]}


@pytest.mark.parametrize("count", COUNTS.values(), ids=COUNTS)
@pytest.mark.parametrize("rho", [0.0, 0.4, 0.7])
def test_errors_beside_a_parabola_have_the_size_that_its_velocity_shows(rho, count):
    """The residuals of a fit by least squares, and the scatter of its velocity at the contact, from many draws."""
    at = int(np.argmin(np.abs(CORRELATIONS - rho)))
    found, left = fit_velocities(average(draw(rho, count.sum(), 3000), count), count)
    known = LastingErrors.of(left[0], COLUMNS, count, FIRST)
    squares = np.sum(left**2, axis=(1, 2))
    assert known.left[at] == pytest.approx(np.mean(squares) / (2 * (len(count) - COLUMNS)), rel=0.02)
    assert known.freedom[at] == pytest.approx(2 * np.mean(squares) ** 2 / np.var(squares), rel=0.08)
    assert known.inflation[at] == pytest.approx(np.mean(found**2), rel=0.05)
    likely = np.sum([LastingErrors.of(one, COLUMNS, count).log_likelihood for one in left[:300]], axis=0)
    assert CORRELATIONS[np.argmax(likely)] == pytest.approx(rho, abs=0.051)


@pytest.mark.parametrize("first", [0.25, 1.0, 2.25, 6.0])
@pytest.mark.parametrize("rho", [0.0, 0.4, 0.7])
def test_the_variance_of_a_velocity_is_that_of_the_closed_form(rho, first):
    """s C s by the exponential correlation C, where s fits the velocity at the contact to eight positions."""
    at, since = int(np.argmin(np.abs(CORRELATIONS - rho))), first + np.arange(8)
    fit = np.linalg.pinv(np.vander(since, COLUMNS, increasing=True))[1]
    cov = rho ** np.abs(np.subtract.outer(since, since))
    got = LastingErrors.of(np.ones((8, 2)), COLUMNS, first=first).inflation[at]
    assert got == pytest.approx(fit @ cov @ fit / (fit @ fit), rel=1e-9)


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


@pytest.mark.parametrize("rho", [0.0, 0.4, 0.7])
@pytest.mark.parametrize(
    "counts",
    [(np.ones(8, int), np.ones(25, int), np.ones(25, int)), (COUNTS["even"], COUNTS["averaged far off"]) * 2],
    ids=["one short", "two averaged"],
)
def test_claimed_errors_of_velocities_hold(counts, rho):
    """Velocities at the contact: 68 and 95 % are within 1 and 1.96 claimed errors, in each stretch."""
    draws = 400
    parts = [fit_velocities(average(draw(rho, c.sum(), draws, seed), c), c) for seed, c in enumerate(counts)]
    freedom, columns = [2.0 * (len(c) - COLUMNS) for c in counts], [COLUMNS] * len(counts)
    claimed = np.array(
        [measure_variances([left[k] for _, left in parts], freedom, columns, counts)[0] for k in range(draws)]
    )
    for (velocity, _), variance in zip(parts, claimed.T, strict=True):
        score = np.abs(velocity) / np.sqrt(variance)[:, None]
        assert 0.64 < np.mean(score < 1) < 0.77
        assert 0.92 < np.mean(score < 1.96) < 0.98
        assert 0.9 < np.mean(variance) / np.mean(velocity**2) < 1.45


def test_short_stretches_do_not_overstate_independent_errors():
    """Of 8 positions each, the residuals of three stretches hardly show the correlation."""
    lefts = [fit_parabolas(draw(0.0, 8, 400, seed))[1] for seed in range(3)]
    claimed = [measure_variances([left[k] for left in lefts], [10.0] * 3, [COLUMNS] * 3)[0] for k in range(400)]
    assert 1.0 < np.mean(claimed) < 1.7


def test_too_few_residuals_show_no_correlation():
    few = LastingErrors.of(np.ones((3, 2)), COLUMNS)
    assert (few.left == 1).all()
    assert (few.inflation == 1).all()
    assert (few.freedom == 0).all()
    assert (few.log_likelihood == 0).all()
    one_more = np.outer([1.0, -3.0, 3.0, -1.0], [1.0, 0.5])
    assert np.ptp(LastingErrors.of(one_more, COLUMNS).log_likelihood) == pytest.approx(0.0, abs=1e-9)
