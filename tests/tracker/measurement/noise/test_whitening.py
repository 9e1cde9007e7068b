"""Errors that a resting ball has in every frame alike: what they are, and that the fits count them once."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import gamma, kv
from tracker_noisy import BENCHMARK, dataset, noisy, scalars_of, truth_of, without_local

from tracker.detection.glints import SHADED_POSITION_ERROR_RADII, PositionFlag
from tracker.measurement.collision.contacts import _shorten_rest
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.measurement.estimate import measure
from tracker.measurement.noise.whitening import PositionWhitener, covariance_of_windows, position_covariance
from tracker.measurement.positions import BallTrack

SIGMA = 1.25


def test_shared_errors_are_those_of_a_random_pattern():
    """Shift of a Gaussian glint by white pixels: its gradient times the pattern, summed, here on a fine grid."""
    grid = np.arange(-12, 12.01, 0.2)
    x, y = np.meshgrid(grid, grid)

    def slopes(position):
        u, v = x - position[0], y - position[1]
        g = np.exp(-(u**2 + v**2) / (2 * SIGMA**2))
        return np.stack([u * g, v * g]).reshape(2, -1)

    positions = np.array([[0.0, 0.0], [0.6, 0.0], [0.0, 1.7], [2.0, -1.1], [7.0, 0.0]])
    told = np.concatenate([slopes(p) for p in positions])
    product = told @ told.T
    fixed = np.tile(np.eye(2) * 0.3, (5, 1, 1))
    mine = position_covariance(positions, fixed + np.eye(2), fixed, SIGMA) - np.kron(np.eye(5), np.eye(2))
    np.testing.assert_allclose(mine, 0.3 * product / product[0, 0], atol=1e-3)


@pytest.mark.parametrize("drifts", [(), ((2e-6, 0.01), (1e-6, 0.1))])
def test_windows_have_the_blocks_of_the_whole_covariance(drifts):
    """Of a ball whose error from the pixels is larger along x, at unequal steps."""
    rng, n, length = np.random.default_rng(5), 20, 7
    position = np.cumsum(rng.uniform(0, 1.5e-4, (n, 2)), axis=0)
    lasting = sum(size**2 for size, _ in drifts) * np.eye(2)
    fixed = lasting + np.array([[4e-12, 1e-12], [1e-12, 2e-12]])
    cov = fixed + rng.uniform(1, 3, (n, 1, 1)) * np.eye(2) * 1e-12
    fixed = np.tile(fixed, (n, 1, 1))
    whole = position_covariance(position, cov, fixed, 1e-4, drifts).reshape(n, 2, n, 2)
    blocks = covariance_of_windows(position, cov, fixed, 1e-4, drifts, length)
    expected = [whole[k : k + length, :, k : k + length].transpose(0, 2, 1, 3) for k in range(n - length + 1)]
    assert blocks == pytest.approx(np.array(expected), rel=1e-12, abs=1e-12 * whole.max())


def test_whitening_leaves_unit_errors():
    rng = np.random.default_rng(0)
    position = np.cumsum(rng.normal(0, 0.4, (30, 2)), axis=0)
    root = rng.normal(size=(30, 2, 2))
    cov = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(2)
    white = PositionWhitener(position, cov, 0.6 * cov, SIGMA)
    unit = np.stack([white(e) for e in np.eye(60).reshape(60, 30, 2)], axis=1)
    np.testing.assert_allclose(
        unit @ position_covariance(position, cov, 0.6 * cov, SIGMA) @ unit.T, np.eye(60), atol=1e-9
    )
    np.testing.assert_allclose(white(np.eye(60).reshape(60, 30, 2)), unit.T)
    errors = rng.normal(size=(30, 2))
    np.testing.assert_allclose(white.distance(errors), np.einsum("ni,nij,nj->n", errors, np.linalg.inv(cov), errors))


def test_a_shared_part_as_large_as_the_whole_stays_regular():
    cov = np.tile(np.eye(2), (50, 1, 1))
    white = PositionWhitener(np.zeros((50, 2)), cov, 1.5 * cov, SIGMA)
    assert np.isfinite(white(np.ones((50, 2)))).all()


def test_a_resting_ball_is_known_no_better_than_its_shared_error():
    cov = np.tile(np.eye(2), (100, 1, 1))
    ones = np.tile(np.eye(2)[:, None], (1, 100, 1))
    told = PositionWhitener(np.zeros((100, 2)), cov, 0.07 * cov, SIGMA)(ones).T
    std = np.sqrt(np.diag(np.linalg.inv(told.T @ told)))
    np.testing.assert_allclose(std, np.sqrt(0.07 + 0.93 / 100), rtol=1e-6)


def test_more_of_a_long_rest_is_left_out_and_a_motion_is_not():
    n = 2000
    frame, cov = np.arange(n), np.tile(np.eye(2) * 1e-12, (n, 1, 1))
    where = np.zeros((n, 2))
    where[1000:, 0] = np.minimum(np.arange(n - 1000), 400) * 1e-4
    course = BallTrack(0, frame, frame / 250, where, cov, 0.0, 0.1 * cov, 2e-4)
    left = _shorten_rest(course, 1000)
    assert set(range(1000, 1400)) <= set(left.frame)
    assert (left.frame < 1000).sum() == pytest.approx(150, abs=3)
    assert (left.frame > 1400).sum() == pytest.approx(150, abs=3)


def shared_noise(truth, camera, rng, own=0.009, fixed=0.004):
    """Tracks whose errors have a part common to positions alike; wider than a real one, to be seen in few clips."""
    tracks = noisy(truth, rng, own)
    ones = np.broadcast_to(np.eye(2), (len(tracks), 2, 2))
    parts = (ones * (own**2 + fixed**2), ones * fixed**2)
    xy = noisy(truth, rng, 0.0).xy
    for ball in (0, 1):
        rows = tracks.particle == ball
        root = np.linalg.cholesky(position_covariance(xy[rows], parts[0][rows], parts[1][rows], camera.sigma))
        xy[rows] += (root @ rng.standard_normal(len(root))).reshape(-1, 2)
    return replace(tracks, x=xy[:, 0], y=xy[:, 1], cov=parts[0], fixed=parts[1])


@pytest.fixture(scope="module")
def repeated(tmp_path_factory):
    """(row, row of a fit that assumes that nothing is shared) of many films of one slow collision; and its truth."""
    settings = {"launch": {"v0": 0.2, "b": 0.2}, "timing": {"contact_frame": 25.3}}
    data = dataset(tmp_path_factory.mktemp("one") / "data", settings, 1)
    truth, camera = truth_of(data, 0)
    rng, rows = np.random.default_rng(2), []
    for _ in range(24):
        tracks = shared_noise(truth, camera, rng)
        alone = replace(tracks, fixed=np.zeros_like(tracks.fixed))
        with without_local():
            rows.append((measure(tracks, camera)[0], measure(alone, camera)[0]))
    return rows, scalars_of(data).iloc[0]


@pytest.mark.gate
@pytest.mark.parametrize("kind", ["", "_free"])
def test_fisher_errors_agree_with_repetition(repeated, kind):
    """The claimed covariance against the scatter of many films of one collision: a parametric bootstrap."""
    rows, _ = repeated
    ratios = {}
    for name in QUANTITY_NAMES:
        values, claimed = (np.array([row[f"{name}{kind}{end}"] for row, _ in rows]) for end in ("", "_std"))
        if claimed[0] > 0:
            ratios[name] = np.nanstd(values) / np.sqrt(np.nanmean(claimed**2))
    assert len(ratios) >= 19
    assert [n for n, r in ratios.items() if abs(r - 1) > 4 / np.sqrt(2 * len(rows))] == []


@pytest.mark.gate
@pytest.mark.parametrize("name", ["b_free", "t_c", "final_angle", "w1n_free"])
def test_errors_are_too_small_when_the_shared_part_is_left_out(repeated, name):
    rows, true = repeated
    truth = true[name.removesuffix("_free")]
    told, untold = (
        np.nanstd([(row[name] - truth) / row[f"{name}_std"] for row in part]) for part in zip(*rows, strict=True)
    )
    assert abs(told - 1) < 4 / np.sqrt(2 * len(rows))
    assert untold > 1.2 * told


def test_a_lasting_shift_is_correlated_as_matern_says():
    """Against the general Matern covariance, by Bessel's function (Rasmussen & Williams 2006, eq. 4.14, nu = 3/2).

    Two shifts keep their own ways: a warp over 0.2 m makes no offset of what changes over 2 mm.
    """
    rng = np.random.default_rng(3)
    where, rms, over = rng.uniform(0, 4e-3, (12, 2)), 1.1e-5, 2.4e-3
    cov = np.tile(np.eye(2) * 9e-10, (12, 1, 1))
    whole = position_covariance(where, cov, 0.5 * cov, 2e-4, ((rms, over), (rms, 0.2))).reshape(12, 2, 12, 2)
    less = cov - 2 * rms**2 * np.eye(2), 0.5 * cov - 2 * rms**2 * np.eye(2)
    lasting = whole - position_covariance(where, *less, 2e-4).reshape(12, 2, 12, 2)
    others = ~np.eye(12, dtype=bool)
    way = np.sqrt(3) * np.hypot(*(where[:, None] - where[None]).T)[others]
    expected = sum(2 / gamma(1.5) * (apart / 2) ** 1.5 * kv(1.5, apart) for apart in (way / over, way / 0.2))
    np.testing.assert_allclose(lasting[:, 1, :, 1][others], rms**2 * expected)
    assert np.abs(lasting[:, 0, :, 1]).max() < 1e-20


@pytest.fixture(scope="module")
def shaded(tmp_path_factory):
    """Rows of collisions, balls off by smooth fields of random waves: flagged so; of a few, taken for pixels."""
    data = dataset(tmp_path_factory.mktemp("shaded") / "data", BENCHMARK, 16)
    rng, told, untold, truths = np.random.default_rng(4), [], [], scalars_of(data)
    for clip in range(16):
        truth, camera = truth_of(data, clip)
        tracks = noisy(truth, rng, 0.02)
        own, rms = tracks.cov, SHADED_POSITION_ERROR_RADII * camera.diameter_px / 2
        waves, phases = rng.standard_normal((2, 2, 200, 2)) / camera.diameter_px, rng.uniform(0, 2 * np.pi, (2, 2, 200))
        shift = np.empty((len(tracks.x), 2))
        for ball in (0, 1):
            its = tracks.particle == ball
            for axis in (0, 1):
                angle = np.column_stack([tracks.x, tracks.y])[its] @ waves[ball, axis].T + phases[ball, axis]
                shift[its, axis] = rms * np.sqrt(2 / 200) * np.cos(angle).sum(axis=1)
        fixed = np.broadcast_to(np.eye(2) * rms**2, own.shape)
        off = replace(tracks, x=tracks.x + shift[:, 0], y=tracks.y + shift[:, 1], cov=own + fixed, fixed=fixed)
        flagged = replace(off, flags=np.full(len(off.x), PositionFlag.SHADED.word))
        with without_local():
            told.append(measure(flagged, camera)[0] | {"true": truths.iloc[clip]})
            untold += measure(off, camera) if clip < 5 else []
    return told, untold


@pytest.mark.gate
@pytest.mark.parametrize("name", ["r", "mu_k", "v0"])
def test_balls_in_their_own_shadow_have_errors_that_hold(shaded, name):
    rows = [row for row in shaded[0] if row["status"] == "ok"]
    z = np.array([(row[name] - row["true"][name]) / row[f"{name}_std"] for row in rows])
    assert len(z) >= 15
    assert np.sqrt(np.mean(z**2)) < 1 + 3 / np.sqrt(2 * len(z))


@pytest.mark.gate
def test_without_the_flag_a_smooth_shift_is_taken_for_rough_noise(shaded):
    few = len(shaded[1])
    told, untold = (np.nanmedian([row["v0_std"] for row in part[:few]]) for part in shaded)
    assert told < 0.7 * untold
