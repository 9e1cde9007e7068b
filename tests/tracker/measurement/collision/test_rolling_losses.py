"""One rolling loss for both balls: what both fits do where it does not hold."""

import numpy as np
import pytest
from scipy.integrate import quad

import synthcam
from benchmarks.regression.error_bars import SHAKEN, follow_centres
from tracker.camera.camera import Camera
from tracker.measurement import estimate
from tracker.measurement.collision.adequacy import Flag
from tracker.measurement.collision.derived import DerivedValues
from tracker.measurement.collision.rolling_losses import LossDifference, ModelWeight, weigh_shift
from tracker.measurement.estimate import measure
from tracker.settings import FitSettings


def measure_hit(number, seed, *, drag, **settings):
    """The row of one drawn hit whose striker loses more speed by `drag`, 1/s, and its truth."""
    effects = {"rolling_mismatch": {"drag": drag}}
    clip = synthcam.Scene.build("loss", **SHAKEN, effects=effects).draw(number, seed)
    tracks = follow_centres(clip, np.random.default_rng([seed, number]))
    (row,) = measure(tracks, Camera.of(clip.camera_json), FitSettings(local_window_s=0, **settings))
    return row, clip.truth


@pytest.mark.parametrize(("number", "seed"), [(0, 14), (18, 14), (6, 15)])
def test_values_carry_a_difference_that_the_tracks_show(number, seed):
    """By one loss for both balls, v0 of these hits is 9 to 11 standard errors off, and they are ok too."""
    row, truth = measure_hit(number, seed, drag=0.02)
    assert (row["status"], row["flags"]) == ("ok", "")
    for name in ("v0", "b", "r", "mu_k", "C", "tau1", "tau2", "energy_fraction"):
        assert abs(row[name] - truth[name]) < 3 * row[f"{name}_std"]
    assert abs(row["v0_free"] - truth["v0"]) < 3 * row["v0_free_std"]


def test_a_difference_beyond_doubt_is_a_misfit_that_names_it():
    row, _ = measure_hit(2, 12, drag=0.02)
    assert (row["status"], row["flags"]) == ("misfit", Flag.LOSSES_DIFFER)
    assert row["adequate"] > 1e-4  # chi^2 of all positions does not show it
    assert np.isnan(row["v0_std"])


def test_equal_losses_hardly_change_the_values_and_their_errors(monkeypatch):
    averaged = [measure_hit(number, 12, drag=0.0)[0] for number in range(9)]
    monkeypatch.setattr(estimate, "compare_losses", lambda *_: None)
    alone = [measure_hit(number, 12, drag=0.0)[0] for number in range(9)]
    assert {(row["status"], row["flags"]) for row in averaged} == {("ok", "")}
    shift = [abs(row["v0"] - one["v0"]) / one["v0_std"] for row, one in zip(averaged, alone, strict=True)]
    wider = [row["v0_std"] / one["v0_std"] for row, one in zip(averaged, alone, strict=True)]
    assert max(shift) < 0.5
    assert min(wider) > 1
    assert np.median(wider) < 1.1


def test_a_setting_of_zero_keeps_the_fit_of_one_loss(monkeypatch):
    names = ("v0", "v0_std", "mu_k", "mu_k_std")
    kept, _ = measure_hit(0, 14, drag=0.02, rolling_loss_difference=0)
    changed, _ = measure_hit(0, 14, drag=0.02)
    monkeypatch.setattr(estimate, "compare_losses", lambda *_: None)
    alone, _ = measure_hit(0, 14, drag=0.02)
    assert [kept[name] for name in names] == [alone[name] for name in names]
    assert changed["v0"] != alone["v0"]


@pytest.mark.parametrize(("z", "scale"), [(0.1, 10.0), (0.7, 0.2), (2.0, 1.0), (3.0, 30.0), (4.5, 8.0), (12.0, 2.0)])
def test_the_mean_over_both_models_is_that_of_numerical_integrals(z, scale):
    def integrate(power):
        def density(x):
            return x**power * scale / (np.pi * (scale**2 + x**2)) * np.exp(-((z - x) ** 2) / 2) / np.sqrt(2 * np.pi)

        return quad(density, z - 12, z + 12, points=sorted({0.0, z}), epsabs=0, epsrel=1e-9, limit=200)[0]

    evidence, first, second = map(integrate, (0, 1, 2))
    equal = np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)
    mean = first / (evidence + equal)
    weight = weigh_shift(z, scale)
    assert weight.probability == pytest.approx(evidence / (evidence + equal), rel=1e-6)
    assert weight.mean == pytest.approx(mean, rel=1e-6, abs=1e-12)
    assert weight.variance == pytest.approx(second / (evidence + equal) - mean**2, rel=1e-6)


def test_nothing_jumps_as_a_difference_grows():
    weights = [weigh_shift(z, 20.0) for z in np.arange(0.0, 5.0, 0.01)]
    assert np.abs(np.diff([weight.mean for weight in weights])).max() < 0.03
    assert np.abs(np.diff([weight.variance for weight in weights])).max() < 0.03


def test_free_quantities_with_the_difference_of_the_tied_fit_have_their_covariance():
    """Two linear fits of one set of data, of which the tied one has fewer parameters."""
    rng = np.random.default_rng(3)
    wide, by = rng.normal(size=(60, 6)), rng.normal(size=60)
    tie = rng.normal(size=(6, 3))

    def fit(rows, to_wide):
        """Estimators of the six parameters if the difference is zero, and of the difference; and the effect."""
        inverse = np.linalg.inv(rows.T @ rows)
        left = by - rows @ inverse @ rows.T @ by
        estimator = to_wide @ inverse @ rows.T
        square = left @ left
        return estimator, left / square, LossDifference(0.0, square**-0.5, square**-0.5, 1.0, -estimator @ by)

    free, _, free_losses = fit(wide, np.eye(6))
    _, difference, tied_losses = fit(wide @ tie, tie)
    values = free_losses.replace_by(tied_losses, DerivedValues(np.zeros(6), free @ free.T))
    together = free + np.outer(free_losses.effect - tied_losses.effect, difference)
    assert values.cov == pytest.approx(together @ together.T)
    corrected = tied_losses.correct(values, ModelWeight(1.0, 0.0, 1.0))
    together = together + np.outer(tied_losses.effect, difference)
    assert corrected.cov == pytest.approx(together @ together.T)
