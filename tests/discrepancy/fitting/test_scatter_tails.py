"""Long tails of the scatter: the likelihood is that of Student's t."""

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_t

from discrepancy.fitting.scatter_tails import FREEDOMS, MULTIPLES, RotatedResiduals, TailLikelihood, weigh_multiples
from discrepancy.fitting.stretch_moves import StretchScatter


@pytest.mark.parametrize("freedom", FREEDOMS)
@pytest.mark.parametrize("size", [0.5, 2.0, 8.0])
def test_accelerations_far_above_the_noise_have_the_density_of_students_t(freedom, size):
    """The average over the multiples of a stretch, by scipy's density; both up to the same constant."""
    variances, off = np.array([1e6, 4e6, 9e6]), np.array([1.0, -2.0, 1.5])

    def measure(factor):
        seen = RotatedResiduals(variances, factor * np.sqrt(variances) * off, np.zeros((3, 0)), 0.0)
        return logsumexp(seen.log_likelihoods(np.zeros(0)) + weigh_multiples(freedom))

    exact = multivariate_t(shape=np.diag(variances), df=freedom)
    wanted = exact.logpdf(size * np.sqrt(variances) * off) - exact.logpdf(0.2 * np.sqrt(variances) * off)
    assert measure(size) - measure(0.2) == pytest.approx(wanted, abs=0.05)


def test_without_freedom_all_stretches_have_the_same_accelerations():
    assert MULTIPLES[np.isfinite(weigh_multiples(0.0))] == pytest.approx([1.0])


def test_a_multiple_is_that_by_which_students_t_weighs_a_stretch():
    """(freedom + numbers) / (freedom + chi^2), the weight of Lange, Little & Taylor."""

    class Stretch:
        def __init__(self, chi):
            self.chi = chi

        def rotate(self, scatter):
            return RotatedResiduals(np.full(5, 1e6), 1e3 * self.chi * np.ones(5), np.zeros((5, 0)), 0.0)

    sizes = np.array([0.5, 1.0, 3.0, 10.0])
    found, _ = TailLikelihood([Stretch(size) for size in sizes]).find_multiples(StretchScatter(freedom=4.0))
    assert found == pytest.approx((4 + 5 * sizes**2) / (4 + 5), rel=0.03)
