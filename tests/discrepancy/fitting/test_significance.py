"""Scores by chance: quantiles of textbook distributions, and a |z| that does not jump."""

import numpy as np
import pytest
from scipy.stats import chi2 as chi2_law
from scipy.stats import norm

from discrepancy.fitting.significance import chance_threshold, chi2_to_sigma, count_trials


def test_sigmas_are_those_of_a_normal_variable():
    assert chi2_to_sigma(9.0, 1) == 3.0
    assert chi2_to_sigma(0.0, 2) == 0.0
    for dof in (2, 5, 45):
        for z in (1.0, 4.0, 8.0):
            assert chi2_to_sigma(chi2_law.isf(2 * norm.sf(z), dof), dof) == pytest.approx(z, rel=1e-6)


@pytest.mark.parametrize("dof", [2, 5, 45])
def test_sigmas_do_not_jump_where_probabilities_underflow(dof):
    chi2 = np.geomspace(500, 1e6, 400)
    z = np.array([chi2_to_sigma(x, dof) for x in chi2])
    ratio = z / np.sqrt(chi2)  # tends to 1 from below: more freedom never makes a chi^2 less likely
    assert np.all(np.diff(ratio) > 0)
    assert ratio[-1] == pytest.approx(1, abs=1e-3)
    assert ratio.max() <= 1
    fine = [chi2_to_sigma(x, dof) for x in np.linspace(1150, 1450, 600)]  # 1e-300 lies here
    assert np.abs(np.diff(fine, 2)).max() < 1e-3


def orthonormal(count, points=60):
    return np.linalg.qr(np.random.default_rng(1).standard_normal((points, count)))[0]


def chance(axes, *rest, **more):
    """Compute the threshold of chance for candidates with these orthonormal bases (points, k)."""
    together = np.concatenate(axes, axis=1)
    return chance_threshold(together.T @ together, [a.shape[1] for a in axes], *rest, **more)


@pytest.mark.parametrize("level", [1e-3, 0.05])
def test_the_best_of_independent_candidates(level):
    axes = [a[:, None] for a in orthonormal(20).T]
    each = 1 - (1 - level) ** (1 / 20)
    assert chance(axes, [False] * 20, level) == pytest.approx(norm.isf(each / 2), rel=0.02)
    assert chance(axes, [True] * 20, level) == pytest.approx(norm.isf(each), rel=0.02)


def test_the_same_candidate_many_times_is_one():
    axis = orthonormal(1)
    assert chance([axis] * 30, [False] * 30) == pytest.approx(norm.isf(5e-4), rel=0.02)
    assert chance([axis, -axis], [True, True]) == pytest.approx(norm.isf(5e-4), rel=0.02)


def test_candidates_of_several_strengths_count_once():
    both = orthonormal(5)
    assert chance([both], [False]) == pytest.approx(norm.isf(5e-4), rel=0.02)  # whatever its freedom
    single = chance([both[:, :3], both[:, 3:4], both[:, 4:]], [False] * 3)
    assert single == pytest.approx(norm.isf((1 - (1 - 1e-3) ** (1 / 3)) / 2), rel=0.02)


def test_what_the_fit_absorbs_scores_nothing():
    assert chance([np.zeros((9, 0))], [False]) == 0.0
    axis = orthonormal(1)
    assert chance([axis[:, :0], axis], [False, False]) == chance([axis], [False])


def test_looks_are_counted_and_paid_for():
    many = orthonormal(20)
    one = many[:, :1]
    assert count_trials([a[:, None] for a in many.T]) == pytest.approx(20)
    assert count_trials([one, -one, one]) == pytest.approx(1)
    assert count_trials([many[:, :2], many[:, 2:4], many[:, :2]]) == pytest.approx(9 / 5)
    assert chi2_to_sigma(50.0, 3, 20) == pytest.approx(np.sqrt(chi2_to_sigma(50.0, 3) ** 2 - 2 * np.log(20)))
    each = norm.isf((1 - (1 - 1e-3) ** (1 / 20)) / 2)
    paid = chance([a[:, None] for a in many.T], [False] * 20, trials_factors=[20.0] * 20)
    assert paid == pytest.approx(np.sqrt(each**2 - 2 * np.log(20)), rel=0.03)
    assert paid < norm.isf(5e-4)  # no further price among other candidates
