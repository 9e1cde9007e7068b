"""The noise is what the tracks show, however smooth the motion below it, however long it lasts, whoever shares it."""

import dataclasses
from functools import partial

import numpy as np
import pytest
from discrepancy_clips import FRAMES, STD, collisions, correlated, exact, noise_of_pair
from scipy.linalg import null_space, toeplitz
from scipy.ndimage import gaussian_filter1d, uniform_filter1d
from scipy.signal import savgol_filter
from scipy.stats import multivariate_normal

from discrepancy.noise.model import (
    CUBIC_COEFFICIENTS,
    MAX_WHITE_SHARE,
    MIN_WHITE_SHARE,
    BallPairs,
    Noise,
    NoiseComponent,
    StretchBundle,
    component_from_numbers,
    estimate_noise,
    finite_cost,
    fit_own_noise,
    minimise_cost,
    numbers_from_component,
)
from synthcam.model import Model

CORRELATIONS = [pytest.param(0.0, marks=pytest.mark.gate), 0.5, pytest.param(0.9, marks=pytest.mark.gate)]


def stretches(rng, rho, count=60, frames=(14, 22, 37, 59), std=1.0):
    for _ in range(count):
        n = int(rng.choice(frames))
        yield std * correlated(rng, n, rho), np.ones(n), np.arange(n)


def agree(values, truth):
    """The mean of repeats is the truth to within four of its standard errors, with a floor of 2 %."""
    return abs(np.mean(values) - truth) < max(4 * np.std(values, ddof=1) / np.sqrt(len(values)), 0.02 * truth)


def test_lags_of_an_autoregression_are_those_of_yule_and_walker():
    assert NoiseComponent(2.0, (0.9,)).autocovariances(40) == pytest.approx(2 * 0.9 ** np.arange(40))
    one, two = 0.6, -0.3
    phi = np.array([one * (1 - two), two])
    lags = NoiseComponent(1.0, (one, two)).autocovariances(30)
    assert lags[1] == pytest.approx(phi[0] / (1 - phi[1]))
    assert lags[2:] == pytest.approx(phi[0] * lags[1:-1] + phi[1] * lags[:-2])
    assert NoiseComponent(3.0, (0.5,), 0.25).autocovariances(3) == pytest.approx([3.0, 3 * 0.75 * 0.5, 3 * 0.75 * 0.25])


def test_restricted_likelihood_is_that_of_the_contrasts_that_no_cubic_touches():
    """-2 ln p of A'y, A' X = 0, differs between two covariances as the restricted likelihood does (Harville 1974)."""
    rng, n = np.random.default_rng(1), 15
    values = correlated(rng, n, 0.5)
    claimed = rng.uniform(0.5, 2, n)
    basis = np.vander(np.linspace(-1, 1, n), CUBIC_COEFFICIENTS) / claimed[:, None]
    bundle = StretchBundle.of([(values * claimed[:, None], claimed, np.arange(n))])
    contrasts, costs, exact_costs = null_space(basis.T), [], []
    for rho in (0.2, 0.8):
        covariance = toeplitz(rho ** np.arange(n))
        costs.append(sum(bundle.restricted_likelihood(covariance)))
        law = multivariate_normal(cov=contrasts.T @ covariance @ contrasts)
        exact_costs.append(-2 * law.logpdf((contrasts.T @ values).T).sum())
    assert costs[1] - costs[0] == pytest.approx(exact_costs[1] - exact_costs[0])


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_scale_and_correlation_are_recovered(rho):
    found = [fit_own_noise(stretches(np.random.default_rng(s), rho, std=2.0)) for s in range(4)]
    assert agree([np.sqrt(c.variance) / 2 for c in found], 1.0)
    if rho:
        assert agree([c.autocovariances(2)[1] / c.variance for c in found], rho)
    else:
        assert all(c.partial_autocorrelations == () for c in found)


def test_white_noise_beside_slow_noise_is_told_apart():
    rng = np.random.default_rng(2)
    both = [(p + rng.standard_normal(p.shape), c, f) for p, c, f in stretches(rng, 0.95, count=200, frames=(40, 59))]
    found = fit_own_noise(both)
    assert found.white_share * found.variance == pytest.approx(1.0, rel=0.1)
    assert found.partial_autocorrelations[0] == pytest.approx(0.95, abs=0.06)


def test_smooth_motion_is_no_noise():
    plain = list(stretches(np.random.default_rng(2), 0.5))
    moved = [
        (p + 1e4 * np.vander(np.linspace(-1, 1, len(p)), CUBIC_COEFFICIENTS) @ np.ones((CUBIC_COEFFICIENTS, 2)), c, f)
        for p, c, f in plain
    ]
    assert fit_own_noise(moved).autocovariances(6) == pytest.approx(fit_own_noise(plain).autocovariances(6), rel=1e-4)


@pytest.mark.parametrize("rho", CORRELATIONS)
def test_missing_frames_do_not_change_the_noise(rho):
    """The correlation is that of neighbouring frames, whether a third of them are missing or two of three."""
    found = []
    for seed in range(4):
        rng, some = np.random.default_rng(seed), []
        for places, claimed, frame in stretches(rng, rho, count=90, frames=(40, 59)):
            kept = rng.random(len(frame)) < 0.67 if seed % 2 else frame % 3 == 0
            some.append((places[kept], claimed[kept], frame[kept]))
        found.append(fit_own_noise(some))
    assert agree([f.autocovariances(1)[0] for f in found], 1.0)
    assert np.mean([f.autocovariances(2)[1] / f.autocovariances(1)[0] for f in found]) == pytest.approx(rho, abs=0.04)


@pytest.mark.parametrize("rho", CORRELATIONS)
@pytest.mark.parametrize(
    "smooth",
    [
        partial(uniform_filter1d, size=3, axis=0),
        partial(gaussian_filter1d, sigma=1.0, axis=0),
        partial(savgol_filter, window_length=9, polyorder=2, axis=0),
    ],
)
def test_a_filter_is_recognised(rho, smooth):
    plain = list(stretches(np.random.default_rng(1), rho, frames=(22, 37, 59)))
    assert not Noise(fit_own_noise(plain)).is_smoothed
    assert Noise(fit_own_noise([(smooth(p), c, f) for p, c, f in plain])).is_smoothed


@pytest.mark.parametrize(("every", "rho", "seed"), [(2, 0.5, 30), (3, 0.9, 32)])
def test_every_other_frame_of_lasting_noise_is_no_filter(every, rho, seed):
    """Noise that swings from frame to frame can be the same at the frames that are seen."""
    thin = [c.select(np.flatnonzero(c.frame % every == 0)) for c in collisions(Model(), 24, seed, rho=rho)]
    noise = estimate_noise(thin)
    assert noise.own.partial_autocorrelations[1] < -0.12
    assert not noise.is_smoothed


@pytest.mark.parametrize("late", [0.02, 0.1])
@pytest.mark.parametrize("rho", CORRELATIONS)
def test_motion_within_a_phase_is_no_noise_and_no_filter(rho, late):
    """Balls roll where they are said to slide: no cubic follows them over the phase, but over eight places."""
    clips = collisions(Model(), 12, 3, rho=rho)
    right = estimate_noise(clips)
    wrong = estimate_noise([dataclasses.replace(c, slide_ends=c.slide_ends + late) for c in clips])
    assert right.whole_phase_scale == 0
    assert wrong.whole_phase_scale > 10
    assert not wrong.is_smoothed
    assert [n.innovation_scale for n in (right, wrong)] == pytest.approx(2 * [np.sqrt(1 - rho**2)], rel=0.1)


def test_noise_is_counted_in_claimed_standard_deviations():
    plain = list(stretches(np.random.default_rng(3), 0.0))
    rng = np.random.default_rng(4)
    claims = [rng.uniform(0.5, 2, len(p)) for p, *_ in plain]
    scaled = [(p * c[:, None] * 1e-6, c * 1e-6, f) for (p, _, f), c in zip(plain, claims, strict=True)]
    assert np.sqrt(fit_own_noise(scaled).variance) == pytest.approx(
        1, abs=4 / np.sqrt(2 * sum(p.size for p, *_ in plain))
    )


def common_mode_score(clips, seed, walk=0.0, jitter=0.0, rho=0.0, axes=(1, 1)):
    """Clips with noise of their own and with a random walk or jitter that both balls share, in units of STD."""
    rng, out = np.random.default_rng(seed), []
    for c in clips:
        common_mode = walk * np.cumsum(rng.standard_normal((FRAMES, 2)), axis=0) + jitter * rng.standard_normal(
            (FRAMES, 2)
        )
        common_mode = STD * common_mode * axes
        out.append(
            dataclasses.replace(c, xy=c.xy + noise_of_pair(rng, rho) + np.concatenate([common_mode, common_mode]))
        )
    return out


CLIPS = exact(Model(), 8, 5)


def test_jitter_that_both_balls_share_is_measured():
    noise = estimate_noise(common_mode_score(CLIPS, 1, jitter=2.0, axes=(1, 0.5)))
    x, y = (s.variance / STD**2 for s in noise.shared)
    assert (x, y) == (pytest.approx(4, rel=0.25), pytest.approx(1, rel=0.25))
    assert noise.shared[0].autocovariances(2)[1] / noise.shared[0].variance == pytest.approx(0, abs=0.15)
    assert noise.scale == pytest.approx(1, rel=0.1)
    assert noise.common_mode_rms == pytest.approx(STD * np.sqrt(2.5), rel=0.2)


def test_a_shared_random_walk_has_its_increments():
    noise = estimate_noise(common_mode_score(CLIPS, 2, walk=1.0))
    assert noise.scale == pytest.approx(1, rel=0.1)
    for s in noise.shared:
        lags = s.autocovariances(2)
        assert 2 * (lags[0] - lags[1]) / STD**2 == pytest.approx(1, rel=0.25)


def test_balls_that_share_nothing_are_not_taken_for_shaken():
    scores = []
    for seed in range(20):
        clips = common_mode_score(CLIPS, seed)
        scores.append(
            BallPairs(pair for c in clips for pair in c.paired_stretches()).common_mode_score(NoiseComponent(1.0))
        )
    assert max(scores) < 4
    assert 0 < np.mean(scores) < 1.49 + 3 / np.sqrt(20)  # nine independent normal scores: the largest is 1.49
    assert estimate_noise(common_mode_score(CLIPS, 3, rho=0.9)).shared == ()


def test_missing_frames_break_a_stretch_and_no_more():
    rng = np.random.default_rng(9)
    whole = common_mode_score(CLIPS, 4, jitter=2.0)
    holed = []
    for c in whole:
        kept = rng.uniform(size=len(c.frame)) > 0.02
        parts = {name: getattr(c, name)[kept] for name in ("frame", "ball", "xy", "covariance")}
        holed.append(dataclasses.replace(c, **parts))
    one, other = estimate_noise(whole), estimate_noise(holed)
    assert other.scale == pytest.approx(one.scale, rel=0.15)
    assert other.common_mode_rms == pytest.approx(one.common_mode_rms, rel=0.25)


def test_a_bundle_of_unequal_stretches_counts_each_by_its_own_length():
    rng = np.random.default_rng(11)
    parts = [(correlated(rng, n, 0.5), np.ones(n), np.arange(n)) for n in (19, 15, 14)]
    together, covariance = StretchBundle.of(parts), toeplitz(0.7 ** np.arange(19))
    each = [StretchBundle.of([p]).restricted_likelihood(covariance[: len(p[0]), : len(p[0])]) for p in parts]
    assert together.restricted_likelihood(covariance) == pytest.approx(np.sum(each, axis=0))
    assert together.restricted_likelihood(np.tile(covariance, (3, 1, 1))) == pytest.approx(np.sum(each, axis=0))


def test_one_bad_recording_does_not_count_for_all():
    clips = common_mode_score(CLIPS, 5)
    bad = dataclasses.replace(clips[0], xy=CLIPS[0].xy + 10 * (clips[0].xy - CLIPS[0].xy))
    noise = estimate_noise([bad, *clips[1:]])
    assert noise == estimate_noise(clips[1:])
    assert noise.scale == pytest.approx(1, rel=0.1)


@pytest.mark.parametrize(("power", "counts"), [(6.0, True), (13.0, False)])
def test_a_recording_of_nine_times_the_noise_does_not_count(power, counts):
    clips = common_mode_score(CLIPS[:4], 5)
    bad = dataclasses.replace(clips[0], xy=CLIPS[0].xy + np.sqrt(power) * (clips[0].xy - CLIPS[0].xy))
    assert (estimate_noise([bad, *clips[1:]]) != estimate_noise(clips[1:])) is counts


def test_a_noise_far_from_the_tracks_has_a_cost_too():
    def singular(x):
        return float(np.linalg.cholesky(np.array([[1.0, x[0]], [x[0], 1.0]])).sum()) if x[0] > 1.5 else float(x[0] ** 2)

    assert finite_cost(singular, np.array([2.0])) == finite_cost(lambda x: float("nan"), np.zeros(1)) == 1e12
    assert abs(minimise_cost(singular, np.array([1.4]))[0]) <= 1.01


def test_too_little_to_read_noise_from():
    with pytest.raises(ValueError, match="too few"):
        fit_own_noise(stretches(np.random.default_rng(6), 0.0, frames=(5, 7)))
    with pytest.raises(ValueError, match="no noise"):
        fit_own_noise([(np.zeros((40, 2)), np.ones(40), np.arange(40))])


def test_a_noise_says_its_scale_and_correlation():
    noise = Noise(NoiseComponent(4.0, (0.5,)))
    assert (noise.scale, noise.correlation, noise.common_mode_rms) == (2.0, 0.5, 0.0)


@pytest.mark.parametrize("part", [MIN_WHITE_SHARE, MAX_WHITE_SHARE])
def test_noise_at_the_end_of_its_range_is_a_start_like_any_other(part):
    numbers = numbers_from_component(NoiseComponent(1.0, (0.5,), part))
    assert np.isfinite(numbers).all()
    assert component_from_numbers((1, True), 1.0, numbers).white_share == pytest.approx(part, abs=1.1e-3)


def test_what_is_new_from_frame_to_frame():
    """It is the spread about the best forecast: the innovations of an autoregression, and all of white noise."""
    rng, rho = np.random.default_rng(4), 0.97
    drift, steps = np.zeros(200_000), rng.standard_normal(200_000)
    for k in range(1, len(drift)):
        drift[k] = rho * drift[k - 1] + steps[k]
    slow = Noise(NoiseComponent(4.0 / (1 - rho**2), (rho,)))
    assert 2.0 * np.std(drift[1:] - rho * drift[:-1]) == pytest.approx(slow.innovation_scale, rel=0.01)
    assert slow.scale == pytest.approx(2.0 * np.std(drift), rel=0.1)
    assert slow.is_slow
    assert not Noise(NoiseComponent(4.0)).is_slow
    assert Noise(NoiseComponent(4.0)).innovation_scale == 2.0
    mixed = Noise(NoiseComponent(4.0, (rho,), 0.25))
    assert mixed.innovation_scale == pytest.approx(2 * np.sqrt(0.25 + 0.75 * (1 - rho**2)))
