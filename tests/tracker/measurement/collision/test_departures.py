"""The average over a law and departures from it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import expit

from tracker.measurement.collision.departures import LawDeparture, average_over_departures, weigh_shift
from tracker.measurement.collision.derived import DerivedValues


@pytest.mark.parametrize(("z", "scale"), [(0.1, 10.0), (0.7, 0.2), (2.0, 1.0), (3.0, 30.0), (4.5, 8.0), (12.0, 2.0)])
def test_the_mean_over_both_models_is_that_of_numerical_integrals(z, scale):
    def integrate(power):
        def density(x):
            return x**power * scale / (np.pi * (scale**2 + x**2)) * np.exp(-((z - x) ** 2) / 2) / np.sqrt(2 * np.pi)

        return quad(density, z - 12, z + 12, points=sorted({0.0, z}), epsabs=0, epsrel=1e-9, limit=200)[0]

    evidence, first, second = map(integrate, (0, 1, 2))
    equal = np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)
    mean = first / (evidence + equal)
    weight, rare = weigh_shift(z, scale), weigh_shift(z, scale, 0.1)
    assert rare.probability == pytest.approx(0.1 * evidence / (0.1 * evidence + 0.9 * equal), rel=1e-6)
    assert weight.probability == pytest.approx(evidence / (evidence + equal), rel=1e-6)
    assert weight.mean == pytest.approx(mean, rel=1e-6, abs=1e-12)
    assert weight.variance == pytest.approx(second / (evidence + equal) - mean**2, rel=1e-6)


def test_nothing_jumps_as_a_departure_grows():
    weights = [weigh_shift(z, 20.0) for z in np.arange(0.0, 5.0, 0.01)]
    assert np.abs(np.diff([weight.mean for weight in weights])).max() < 0.03
    assert np.abs(np.diff([weight.variance for weight in weights])).max() < 0.03


@pytest.mark.parametrize("scale", [1e6, 1e8, 1e12, 1e20, 1e200])
@pytest.mark.parametrize("z", [0.0, 3.0, 40.0, 1e5])
def test_a_prior_much_wider_than_the_error_leaves_the_measured_value(z, scale):
    """The posterior is then normal; its probability follows from both densities."""
    weight = weigh_shift(z, scale)
    assert weight.shifted == pytest.approx(z, rel=1e-6, abs=1e-9)
    assert weight.shifted_variance == pytest.approx(1.0, rel=1e-6)
    log_odds = z**2 / 2 - np.log(scale * (1 + (z / scale) ** 2) * np.sqrt(np.pi / 2))  # densities of both models
    assert weight.probability == pytest.approx(expit(log_odds), rel=1e-6)


def test_nothing_jumps_where_the_series_of_the_weight_begins():
    near, far = (weigh_shift(2.0, scale) for scale in (1414.0, 1414.3))
    assert far.shifted_variance == pytest.approx(near.shifted_variance, abs=1e-8)
    assert far.probability == pytest.approx(near.probability, rel=3e-4)


@pytest.mark.parametrize("keys", [0, 2])
def test_quantities_with_departures_have_the_covariance_of_linear_fits(keys):
    """Two linear fits of one set of data, of which the tied one has fewer parameters; the camera has `keys` errors."""
    rng = np.random.default_rng(3)
    wide, by, known = rng.normal(size=(60, 6)), rng.normal(size=60), rng.normal(size=(60, keys))
    tie = rng.normal(size=(6, 3))

    def fit(rows, to_wide, by=by, **prior):
        """Estimators of the six parameters if the departure is zero, and of the departure; and the effect."""
        inverse = np.linalg.inv(rows.T @ rows)
        project = np.eye(60) - rows @ inverse @ rows.T
        left, rest = project @ by, project @ known
        left = np.linalg.solve(np.eye(60) + rest @ rest.T, left)
        square = left @ by
        estimator, difference = to_wide @ inverse @ rows.T, left / square
        found = {"response": difference, "shared": difference @ known, "effect": -estimator @ by}
        found |= {"value": 0.0, "cov_with_tied": np.zeros(6)}
        return estimator, LawDeparture(std=square**-0.5, **found, **prior)

    def quantities(estimator):
        return DerivedValues(np.zeros(6), estimator @ estimator.T).with_shared(estimator @ known)

    def assert_is(values, estimator):
        assert values.shared == pytest.approx(estimator @ known, rel=1e-5)
        assert values.cov == pytest.approx(estimator @ estimator.T + values.shared @ values.shared.T, rel=1e-5)

    sure, never = {"typical": 1e6, "expected": 1.0}, {"typical": 0.0}
    tied, tied_one = fit(wide @ tie, tie, **sure)
    free, free_one = fit(wide, np.eye(6))
    assert_is(
        average_over_departures(quantities(tied), [tied_one]), tied + np.outer(tied_one.effect, tied_one.response)
    )
    other = fit(wide @ tie, tie, rng.normal(size=60), **sure)[1]
    both = np.outer(tied_one.effect, tied_one.response) + np.outer(other.effect, other.response)
    assert_is(average_over_departures(quantities(tied), [tied_one, other]), tied + both)
    free_one = replace(free_one, cov_with_tied=free @ tied_one.response)
    together = free + np.outer(free_one.effect, tied_one.response)
    assert_is(average_over_departures(quantities(free), [free_one], [tied_one]), together)
    tied_one = replace(tied_one, **never)
    values = average_over_departures(quantities(free), [free_one], [tied_one])
    assert_is(values, free + np.outer(free_one.effect - tied_one.effect, tied_one.response))
    if not keys:  # Hausman, for linear fits
        apart = (free_one.effect - tied_one.effect) * tied_one.std
        assert values.cov == pytest.approx(free @ free.T - np.outer(apart, apart))


def test_errors_hold_on_average_over_departures_and_cameras_as_they_are_expected():
    """Departures are drawn from the prior. Their measured values are off mostly by a key of the camera."""
    rng = np.random.default_rng(5)
    effect, shared, std, scale, n = 2.0, 1.5, 0.6, 4.0, 4000
    wrong, noise = rng.normal(size=(2, n))
    true = np.where(rng.random(n) < 0.5, scale * rng.standard_cauchy(n), 0.0)
    measured = true + 0.8 * wrong + std * noise  # with an error of 1
    one = LawDeparture(0.0, 1.0, np.array([std]), np.array([0.8]), np.full(1, effect), np.zeros(1), typical=scale)
    given = DerivedValues(np.zeros(1), np.full((1, 1), 1 + shared**2), np.full((1, 1), shared))
    z, plain = [], []
    for number in range(n):
        found = replace(one, value=measured[number])
        values = average_over_departures(given, [found])
        off = values.value[0] + shared * wrong[number] + rng.normal() - effect * true[number]
        z.append(off / values.std[0])
        plain.append(off / np.sqrt(given.cov[0, 0] + effect**2 * found.weight.variance))
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.05)
    assert np.sqrt(np.mean(np.square(plain))) > 1.1  # without their correlation
