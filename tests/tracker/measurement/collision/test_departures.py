"""The average over a law and departures from it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import expit, wofz

from tracker.measurement.collision.departures import (
    LawDeparture,
    average_over_departures,
    find_posterior,
    weigh_departures,
)
from tracker.measurement.collision.derived import DerivedValues


def posterior_of_one(z, scale, expected=0.5):
    """Probability that a parameter is not zero, its mean and variance, from one measurement with the error 1."""
    found = find_posterior(np.array([z]), np.eye(1), np.array([scale]), [expected])
    return 1 - found.zero, found.mean[0], found.cov[0, 0]


@pytest.mark.parametrize(("z", "scale"), [(0.1, 10.0), (0.7, 0.2), (2.0, 1.0), (3.0, 30.0), (4.5, 8.0), (12.0, 2.0)])
def test_the_mean_over_both_models_is_that_of_numerical_integrals(z, scale):
    def integrate(power):
        def density(x):
            return x**power * scale / (np.pi * (scale**2 + x**2)) * np.exp(-((z - x) ** 2) / 2) / np.sqrt(2 * np.pi)

        return quad(density, z - 12, z + 12, points=sorted({0.0, z}), epsabs=0, epsrel=1e-9, limit=200)[0]

    evidence, first, second = map(integrate, (0, 1, 2))
    equal = np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)
    mean = first / (evidence + equal)
    probability, found, variance = posterior_of_one(z, scale)
    assert probability == pytest.approx(evidence / (evidence + equal), rel=1e-6)
    assert found == pytest.approx(mean, rel=1e-6, abs=1e-12)
    assert variance == pytest.approx(second / (evidence + equal) - mean**2, rel=1e-6)
    assert posterior_of_one(z, scale, 0.1)[0] == pytest.approx(
        0.1 * evidence / (0.1 * evidence + 0.9 * equal), rel=1e-6
    )


@pytest.mark.parametrize("expected", [0.01, 0.5])
@pytest.mark.parametrize("scale", [0.1, 3.0, 25.0, 1e4])
@pytest.mark.parametrize("z", [0.0, 1.5, 4.8])
def test_one_parameter_has_the_posterior_of_a_voigt_profile(z, scale, expected):
    """Faddeeva's function w is the evidence for a Cauchy prior; its derivatives give mean and variance (Tweedie)."""
    at = (z + 1j * scale) / np.sqrt(2)
    w = wofz(at)
    first = 2j / np.sqrt(np.pi) - 2 * at * w
    slope, bend = first.real / w.real / np.sqrt(2), -(w + at * first).real / w.real
    probability = expit(np.log(w.real) + z**2 / 2 + np.log(expected / (1 - expected)))
    shifted = z + slope
    variance = probability * (1 + bend - slope**2) + probability * (1 - probability) * shifted**2
    found = (probability, probability * shifted, variance)
    assert posterior_of_one(z, scale, expected) == pytest.approx(found, rel=2e-6)


MEASURED = [((2.5, -1.0), (12.0, 4.0)), ((0.3, 3.5), (1.0, 30.0)), ((-3.0, 3.0), (9.0, 9.0))]  # and scales


@pytest.mark.parametrize(("z", "scales"), MEASURED)
@pytest.mark.parametrize("correlation", [-0.7, 0.4])
def test_the_posterior_of_two_parameters_is_that_of_sums_over_a_grid(z, scales, correlation):
    expected = (0.5, 0.1)
    precision = np.array([[1.0, correlation], [correlation, 1.0]])
    step = 0.05
    values = np.arange(-15.0, 15.0 + step / 2, step)
    zero = len(values) // 2
    priors, none = [], 1.0
    for scale, share in zip(scales, expected, strict=True):
        prior = share * step * scale / np.pi / (scale**2 + values**2)
        prior[zero] += 1 - share
        none *= (1 - share) / prior[zero]
        priors.append(prior)
    x, y = np.meshgrid(values, values, indexing="ij")
    log = z[0] * x + z[1] * y - (x**2 + y**2) / 2 - correlation * x * y
    weight = np.outer(*priors) * np.exp(log - log.max())
    weight /= weight.sum()
    points = np.stack([x.ravel(), y.ravel()])
    found = find_posterior(np.array(z), precision, np.array(scales), expected)
    assert found.mean == pytest.approx(points @ weight.ravel(), abs=2e-4)
    assert found.cov == pytest.approx(np.cov(points, aweights=weight.ravel(), ddof=0), abs=1e-3)
    assert found.zero == pytest.approx(none * weight[zero, zero], rel=1e-3)


def test_the_mean_follows_the_measured_values_by_its_covariance():
    precision, scales = np.array([[1.0, -0.5], [-0.5, 1.0]]), np.array([20.0, 6.0])

    def mean(*z):
        return find_posterior(np.array(z), precision, scales, (0.5, 0.5)).mean

    slope = np.column_stack([(mean(6.01, 5.0) - mean(5.99, 5.0)) / 0.02, (mean(6.0, 5.01) - mean(6.0, 4.99)) / 0.02])
    found = find_posterior(np.array([6.0, 5.0]), precision, scales, (0.5, 0.5))
    assert found.cov == pytest.approx(slope, rel=1e-4)
    assert found.followed == pytest.approx(found.cov, rel=0.01)  # no doubt is left about the models
    near_zero = find_posterior(np.array([0.5, 0.3]), precision, scales, (0.5, 0.5))
    assert near_zero.followed == pytest.approx(near_zero.cov, rel=1e-9)
    doubtful = find_posterior(np.array([3.2, 0.0]), precision, scales, (0.5, 0.5))
    left = doubtful.cov - doubtful.followed @ precision @ doubtful.followed
    assert np.linalg.eigvalsh(left).min() > -1e-12
    assert doubtful.cov[0, 0] > 1.5 * np.linalg.inv(precision)[0, 0]


def test_nothing_jumps_as_a_departure_grows():
    _, means, variances = np.transpose([posterior_of_one(z, 20.0) for z in np.arange(0.0, 5.0, 0.01)])
    assert np.abs(np.diff(means)).max() < 0.03
    assert np.abs(np.diff(variances)).max() < 0.03


@pytest.mark.parametrize("scale", [1e6, 1e8, 1e12, 1e20, 1e100])
@pytest.mark.parametrize("z", [0.0, 3.0, 40.0, 1e5])
def test_a_prior_much_wider_than_the_error_leaves_the_measured_value(z, scale):
    """The posterior is then normal; its probability follows from both densities."""
    probability, mean, _ = posterior_of_one(z, scale)
    log_odds = z**2 / 2 - np.log(scale * (1 + (z / scale) ** 2) * np.sqrt(np.pi / 2))  # densities of both models
    assert probability == pytest.approx(expit(log_odds), rel=1e-5)
    assert mean == pytest.approx(z * expit(log_odds), rel=1e-5, abs=1e-9)


def test_correlated_departures_have_errors_that_hold():
    """One is drawn from its prior, the other is zero. As if independent, rms z is too large."""
    rng, n, std = np.random.default_rng(8), 500, np.array([0.5, 2.0])
    precision = np.array([[1.0, -0.6], [-0.6, 1.0]])
    root = np.linalg.cholesky(precision)
    rows = [
        LawDeparture(0.0, s, s * r, np.zeros(0), np.array([e]), np.zeros(1), typical=12 * s)
        for s, r, e in zip(std, root, (4.0, 1.2), strict=True)
    ]
    given, z, apart = DerivedValues(np.zeros(1), np.eye(1)), [], []
    for true in rng.standard_cauchy((n, 2)) * 12 * (rng.random((n, 2)) < 0.5):  # in errors
        seen = precision @ true + root @ rng.normal(size=2)
        found = [replace(one, value=value * one.std) for one, value in zip(rows, seen, strict=True)]
        off = rng.normal() - sum(one.effect[0] * one.std * d for one, d in zip(rows, true, strict=True))
        values = average_over_departures(given, found)
        z.append((values.value[0] + off) / values.std[0])
        one, two = (average_over_departures(given, [single]) for single in found)
        both = one.value[0] + two.value[0] + off
        apart.append(both / np.sqrt(one.cov[0, 0] + two.cov[0, 0] - 1))
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.12)
    assert np.sqrt(np.mean(np.square(np.clip(apart, -9, 9)))) > 2


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
    by_other = rng.normal(size=60)
    other = fit(wide @ tie, tie, by_other, **sure)[1]
    pair = weigh_departures([tied_one, other])
    size = np.array([tied_one.std, other.std])
    together = np.linalg.solve(pair.precision, np.stack([tied_one.response, other.response]) / size[:, None])
    both = (np.column_stack([tied_one.effect, other.effect]) * size) @ together
    assert_is(average_over_departures(quantities(tied), [tied_one, other]), tied + both)
    free_one = replace(free_one, cov_with_tied=free @ tied_one.response)
    free_other = replace(fit(wide, np.eye(6), by_other)[1], cov_with_tied=free @ other.response, is_shown=False)
    both = (np.column_stack([free_one.effect, free_other.effect]) * size) @ together
    assert_is(average_over_departures(quantities(free), [free_one, free_other], [tied_one, other]), free + both)
    together = free + np.outer(free_one.effect, tied_one.response)
    assert_is(average_over_departures(quantities(free), [free_one], [tied_one]), together)
    tied_one = replace(tied_one, **never)
    values = average_over_departures(quantities(free), [free_one], [tied_one])
    assert_is(values, free + np.outer(free_one.effect - tied_one.effect, tied_one.response))
    both = average_over_departures(quantities(free), [free_one, free_other], [tied_one, replace(other, **never)])
    assert_is(both, free + np.outer(free_one.effect - tied_one.effect, tied_one.response))
    if not keys:  # Hausman, for linear fits
        apart = (free_one.effect - tied_one.effect) * tied_one.std
        assert values.cov == pytest.approx(free @ free.T - np.outer(apart, apart))


def test_errors_hold_on_average_over_departures_and_cameras_as_they_are_expected():
    """Departures are drawn from the prior. Their measured values are off mostly by a key of the camera."""
    rng = np.random.default_rng(5)
    effect, shared, std, scale, n = 2.0, 1.5, 0.6, 4.0, 2000
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
        plain.append(off / np.sqrt(given.cov[0, 0] + effect**2 * weigh_departures([found]).cov[0, 0]))
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.05)
    assert np.sqrt(np.mean(np.square(plain))) > 1.1  # without their correlation
