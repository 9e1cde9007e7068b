"""Whitened residuals are white to the last digit, whatever is missing and whichever balls share the noise."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import blank

from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.noise.whitening import ClipWhitener

LAUNCH = np.array([0.0, 0.0, 0.08, 0.4, 0.3, 0.2])
OWN = NoiseComponent(1.7, (0.8, -0.2), 0.3)
ALONE = Noise(OWN)
SHAKEN = Noise(OWN, (NoiseComponent(9e-12, (0.97,)), NoiseComponent(2e-12)))


def clip(gaps=True):
    """Twelve frames, claims of any size and shape; a ball is missed now and then."""
    rng = np.random.default_rng(3)
    whole = blank(0, LAUNCH, np.array([0.1, 0.1]), 12)
    kept = np.setdiff1d(np.arange(24), [0, 5, 6, 15] if gaps else [])
    root = 1e-6 * (np.eye(2) + 0.4 * rng.standard_normal((24, 2, 2)))
    claims = root @ root.transpose(0, 2, 1)
    return dataclasses.replace(
        whole, frame=whole.frame[kept], ball=whole.ball[kept], xy=whole.xy[kept], covariance=claims[kept]
    )


def covariance(c, noise):
    """Write out the covariance of every measured number with every other: (n, 2, n, 2), m^2."""
    n = len(c.frame)
    lags = noise.own.autocovariances(20)
    roots = np.linalg.cholesky(c.covariance)
    out = np.zeros((n, 2, n, 2))
    for i in range(n):
        for j in range(n):
            apart = abs(c.frame[i] - c.frame[j])
            if c.ball[i] == c.ball[j]:
                out[i, :, j] += lags[apart] * roots[i] @ roots[j].T
            for axis, shared in enumerate(noise.shared):
                out[i, axis, j, axis] += shared.autocovariances(20)[apart]
    return out


@pytest.mark.parametrize("noise", [ALONE, SHAKEN], ids=["alone", "shaken"])
@pytest.mark.parametrize("gaps", [False, True])
def test_the_covariance_becomes_one(noise, gaps):
    c = clip(gaps)
    white = ClipWhitener.of(c, noise)
    n = len(c.frame)
    units = white(np.eye(2 * n).reshape(n, 2, 2 * n))
    whole = covariance(c, noise).reshape(2 * n, 2 * n)
    assert units @ whole @ units.T == pytest.approx(np.eye(2 * n), abs=1e-9)
    claimed = np.linalg.slogdet(c.covariance)[1].sum()
    assert white.log_determinant == pytest.approx(np.linalg.slogdet(whole)[1] - claimed)


@pytest.mark.parametrize("noise", [ALONE, SHAKEN], ids=["alone", "shaken"])
def test_whitening_can_be_undone(noise):
    c, rng = clip(), np.random.default_rng(1)
    white = ClipWhitener.of(c, noise)
    for shape in ((), (3,)):
        residuals = rng.standard_normal((len(c.frame), 2, *shape))
        assert white.undo(white(residuals)) == pytest.approx(residuals)


@pytest.mark.parametrize("noise", [ALONE, SHAKEN], ids=["alone", "shaken"])
def test_a_white_number_looks_back_only(noise):
    c = clip()
    n = len(c.frame)
    used = ClipWhitener.of(c, noise)(np.eye(2 * n).reshape(n, 2, 2 * n)).reshape(n, 2, n, 2) != 0
    later = c.frame[None, :] > c.frame[:, None]
    assert not used.any(axis=(1, 3))[later].any()
    other = c.ball[None, :] != c.ball[:, None]
    assert used.any(axis=(1, 3))[other].any() == bool(noise.shared)


@pytest.mark.parametrize("noise", [ALONE, SHAKEN], ids=["alone", "shaken"])
def test_a_target_at_rest_is_off_by_the_same_in_every_frame(noise):
    launch = np.array([0.0, 0.0, 0.03, 0.4, 0.3, 0.2])
    c = dataclasses.replace(blank(0, launch, np.array([0.1, 0.1]), 12), offset=5e-7)
    n, resting = len(c.frame), (c.ball == 0) & (c.frame / 250 + 5e-4 <= 0.03)
    assert resting.sum() == 8
    whole = covariance(c, noise)
    for axis in (0, 1):
        whole[:, axis, :, axis] += 25e-14 * np.outer(resting, resting)
    units = ClipWhitener.of(c, noise)(np.eye(2 * n).reshape(n, 2, 2 * n))
    assert units @ whole.reshape(2 * n, 2 * n) @ units.T == pytest.approx(np.eye(2 * n), abs=1e-9)


@pytest.mark.parametrize("noise", [ALONE, SHAKEN], ids=["alone", "shaken"])
def test_what_differs_from_stretch_to_stretch_is_part_of_the_covariance(noise):
    bare = clip()
    n = len(bare.frame)
    columns = 2e-6 * np.random.default_rng(4).standard_normal((2 * n, 3))
    c = dataclasses.replace(bare, scatter=(columns @ columns.T).reshape(n, 2, n, 2))
    white, whole = ClipWhitener.of(c, noise), covariance(bare, noise).reshape(2 * n, 2 * n)
    units = white(np.eye(2 * n).reshape(n, 2, 2 * n))
    total = whole + columns @ columns.T
    assert units @ total @ units.T == pytest.approx(np.eye(2 * n), abs=1e-8)
    residuals = np.random.default_rng(5).standard_normal((n, 2)) * 1e-6
    assert white.undo(white(residuals)) == pytest.approx(residuals)
    best = residuals.ravel() - columns @ columns.T @ np.linalg.solve(total, residuals.ravel())  # of a Gaussian
    assert white.undo_noise(white(residuals)).ravel() == pytest.approx(best)
    some = np.arange(0, n, 2)
    assert c.select(some).scatter == pytest.approx(c.scatter[some][:, :, some])
