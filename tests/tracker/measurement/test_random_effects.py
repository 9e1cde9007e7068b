"""Random-effects means and regressions against the published numbers of another program, metafor of R.

The data are the 13 trials of the BCG vaccine against tuberculosis (Colditz et al. 1994), and the log relative risks of
W. Viechtbauer, Conducting meta-analyses in R with the metafor package, J. Stat. Softw. 36 (2010) no. 3.
"""

import numpy as np
import pytest

from tracker.measurement.random_effects import GeneralisedQ, fit_means_without_each, fit_random_effects

# infected and healthy with vaccine, infected and healthy without, latitude in degrees
TRIALS = np.array(
    [
        (4, 119, 11, 128, 44), (6, 300, 29, 274, 55), (3, 228, 11, 209, 42), (62, 13536, 248, 12619, 52),
        (33, 5036, 47, 5761, 13), (180, 1361, 372, 1079, 44), (8, 2537, 10, 619, 19), (505, 87886, 499, 87892, 13),
        (29, 7470, 45, 7232, 27), (17, 1699, 65, 1600, 42), (186, 50448, 141, 27197, 18), (5, 2493, 3, 2338, 33),
        (27, 16886, 29, 17825, 33),
    ],
    dtype=float,
)  # fmt: skip
ILL, WELL, ILL_WITHOUT, WELL_WITHOUT, LATITUDE = TRIALS.T
RISK = np.log(ILL / (ILL + WELL)) - np.log(ILL_WITHOUT / (ILL_WITHOUT + WELL_WITHOUT))
ERROR = np.sqrt(1 / ILL - 1 / (ILL + WELL) + 1 / ILL_WITHOUT - 1 / (ILL_WITHOUT + WELL_WITHOUT))
LINE = np.column_stack([np.ones(13), LATITUDE])
NO_SHARED = np.zeros((13, 0))


def test_heterogeneity_is_that_of_metafor():
    found = fit_random_effects(RISK, ERROR)
    assert found.q == pytest.approx(152.2330, abs=5e-5)
    assert found.dof == 12
    assert found.scatter**2 == pytest.approx(0.3181, abs=5e-5)  # method "PM"
    assert (found.scatter_low**2, found.scatter_high**2) == pytest.approx((0.1197, 1.1115), abs=5e-5)  # confint
    assert found.weights.sum() == pytest.approx(1)


@pytest.mark.parametrize(
    ("tau2", "design", "mean", "error", "knapp_hartung"),
    [(0.3132, LINE[:, :1], -0.7145, 0.1798, 0.1808), (0.0764, LINE, 0.2515, 0.2491, None)],  # method "REML"
)
def test_means_and_errors_at_the_scatter_of_metafor(tau2, design, mean, error, knapp_hartung):
    coefficients, cov, left = GeneralisedQ(RISK, ERROR**2, NO_SHARED, design).fit(tau2)
    assert (coefficients[0], cov[0, 0] ** 0.5) == pytest.approx((mean, error), abs=2e-4)
    if knapp_hartung:
        assert (cov[0, 0] * left / 12) ** 0.5 == pytest.approx(knapp_hartung, abs=1e-4)
    else:
        assert (coefficients[1], cov[1, 1] ** 0.5) == pytest.approx((-0.0291, 0.0072), abs=5e-5)


def test_regression_leaves_the_residual_heterogeneity_of_metafor():
    found = fit_random_effects(RISK, ERROR, design=LINE)
    assert (found.q, found.q_value) == pytest.approx((30.7331, 0.0012), abs=5e-5)


def test_one_value_keeps_its_error_and_two_have_one_degree_of_freedom():
    one = fit_random_effects(np.array([0.9]), np.array([0.02]))
    assert (one.coefficients[0], one.std[0], one.dof) == (0.9, pytest.approx(0.02), 0)
    assert np.isnan([one.scatter, one.i2, one.birge, one.prediction]).all()
    two = fit_random_effects(np.array([0.9, 0.96]), np.array([0.01, 0.01]))
    # both values weigh the same: the error is half of their distance, Student's t with one degree of freedom 12.7
    assert (two.std[0], two.high[0] - 0.93) == pytest.approx((0.03, 12.706 * 0.03), rel=1e-4)
    assert two.scatter == pytest.approx(np.sqrt(0.03**2 * 2 - 0.01**2))


def test_agreement_closer_than_the_errors_does_not_lessen_them():
    found = fit_random_effects(np.array([0.90, 0.901, 0.899]), np.full(3, 0.03))
    assert found.scatter == 0
    assert found.std[0] == pytest.approx(0.03 / np.sqrt(3))


def test_shared_errors_do_not_average_out():
    rng = np.random.default_rng(1)
    value, shared = 0.9 + 0.01 * rng.normal(size=400), np.full((400, 1), 0.005)
    found = fit_random_effects(value, np.full(400, 0.01), shared)
    assert found.shared_std[0] == pytest.approx(0.005)
    assert found.std[0] == pytest.approx(np.hypot(0.005, 0.01 / 20), rel=0.01)


def test_leaving_one_out_is_the_fit_of_the_others():
    mean, variance, scatter2 = fit_means_without_each(RISK, ERROR, NO_SHARED)
    rest = fit_random_effects(RISK[1:], ERROR[1:])
    assert (mean[0], variance[0] ** 0.5, scatter2[0] ** 0.5) == pytest.approx(
        (rest.coefficients[0], rest.std[0], rest.scatter)
    )
