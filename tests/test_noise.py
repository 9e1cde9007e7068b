"""The noise is what the tracks show, no matter how smooth the motion below it or how long it remembers."""

import numpy as np
import pytest

from discrepancy.noise import ORDER, SMOOTH, Noise, estimate
from discrepancy_clips import correlated


def stretches(rng, rho, count=100, frames=(14, 60), std=1.0):
    for _ in range(count):
        n = int(rng.integers(*frames))
        yield std * correlated(rng, n, rho), np.ones(n)


def agree(values, truth):
    """The mean of repeats is the truth to within four of its standard errors, with a floor of 2 %."""
    return abs(np.mean(values) - truth) < max(4 * np.std(values, ddof=1) / np.sqrt(len(values)), 0.02)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_scale_and_correlation_are_recovered(rho):
    found = [estimate(stretches(np.random.default_rng(s), rho, std=2.0)) for s in range(8)]
    assert agree([n.scale / 2 for n in found], 1.0)
    for lag in range(1, ORDER + 1):
        assert agree([n.covariance[lag] / n.covariance[0] for n in found], rho**lag)


def test_the_cubic_leaves_correlation_of_its_own_and_it_is_undone():
    repeats = [list(stretches(np.random.default_rng(s), 0.0, count=200, frames=(25, 26))) for s in range(8)]
    basis = np.vander(np.linspace(-1, 1, 25), SMOOTH)
    left = np.stack([p - basis @ np.linalg.lstsq(basis, p, rcond=None)[0] for r in repeats for p, _ in r])
    assert (left[:, 1:] * left[:, :-1]).mean() / (left**2).mean() < -0.1
    assert agree([estimate(r).correlation for r in repeats], 0.0)


def test_smooth_motion_is_no_noise():
    plain = list(stretches(np.random.default_rng(2), 0.5))
    moved = [(p + 1e4 * np.vander(np.linspace(-1, 1, len(p)), SMOOTH) @ np.ones((SMOOTH, 2)), c) for p, c in plain]
    assert np.allclose(estimate(moved).covariance, estimate(plain).covariance, rtol=1e-6)


def test_noise_is_counted_in_claimed_standard_deviations():
    plain = list(stretches(np.random.default_rng(3), 0.0))
    rng = np.random.default_rng(4)
    claims = [rng.uniform(0.5, 2, len(p)) for p, _ in plain]
    scaled = [(p * c[:, None] * 1e-6, c * 1e-6) for (p, _), c in zip(plain, claims, strict=True)]
    assert estimate(scaled).scale == pytest.approx(1, abs=4 / np.sqrt(2 * sum(p.size for p, _ in plain)))


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_whitened_noise_is_white(rho):
    noise = Noise(rho ** np.arange(ORDER + 1.0))
    rng = np.random.default_rng(5)
    frame = np.concatenate([np.arange(60), np.r_[0:25, 26:31, 40:60]])  # the second ball is missed twice
    ball = np.repeat([0, 1], [60, 50])
    white = []
    for _ in range(400):
        seen = np.concatenate([correlated(rng, 60, rho, 1), correlated(rng, 60, rho, 1)[frame[60:]]])
        white.append(noise.filter(frame, ball) @ seen[:, 0])
    each = np.array(white)
    assert np.all(np.abs((each**2).mean(axis=0) - 1) < 5 * np.sqrt(2 / 400))
    assert np.mean(each**2) == pytest.approx(1, abs=4 * np.sqrt(2 / each.size))
    for lag in range(1, ORDER + 1):
        inside = frame[lag:] - frame[:-lag] == lag  # across a gap nothing is claimed
        assert abs((each[:, lag:] * each[:, :-lag])[:, inside & (ball[lag:] == ball[:-lag])].mean()) < 0.02


def test_the_filter_never_looks_across_a_gap_or_to_the_other_ball():
    frame, ball = np.array([0, 1, 2, 5, 6, 7, 8]), np.array([0, 0, 0, 0, 0, 1, 1])
    used = Noise(0.9 ** np.arange(ORDER + 1.0)).filter(frame, ball) != 0
    assert [np.flatnonzero(row)[0] for row in used] == [0, 0, 1, 3, 3, 5, 5]


def test_too_little_to_read_noise_from():
    with pytest.raises(ValueError, match="too few"):
        estimate(stretches(np.random.default_rng(6), 0.0, frames=(8, 11)))
    with pytest.raises(ValueError, match="no noise"):
        estimate([(np.zeros((40, 2)), np.ones(40))])
