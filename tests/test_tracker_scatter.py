"""The noise of tracks that carry no errors, from the tracks themselves."""

from dataclasses import replace

import numpy as np
import pytest

from tracker.estimate import measure
from tracker.scatter import scatter
from tracker_noisy import BENCHMARK, dataset, noisy, truth_of


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    data = dataset(tmp_path_factory.mktemp("scatter") / "data", BENCHMARK, 12)
    return [truth_of(data, clip) for clip in range(12)]


def test_noise_is_found_in_spite_of_contact_and_slides(clips):
    for noise in (0.005, 0.05):
        found = []
        for i, (truth, _) in enumerate(clips):
            tracks = noisy(truth, np.random.default_rng(i), noise)
            found.append(scatter(tracks.frame, tracks.particle, tracks.xy))
        assert np.mean(found) == pytest.approx(noise, rel=0.03)
        assert np.std(found) < 0.12 * noise


def test_gaps_and_order_do_not_matter_and_too_little_says_so():
    rng = np.random.default_rng(0)
    frame, particle = np.tile(np.arange(400), 2), np.repeat([4, 1], 400)
    xy = np.column_stack([frame * 1.5, 0.01 * frame**1.5]) + rng.normal(0, 0.2, (800, 2))
    kept = rng.permutation(800)[:700]
    assert scatter(frame[kept], particle[kept], xy[kept]) == pytest.approx(0.2, rel=0.1)
    assert np.isnan(scatter(frame[:6], particle[:6], xy[:6]))
    assert np.isnan(scatter(frame[::2], particle[::2], xy[::2]))


def test_perfect_places_do_not_divide_by_zero():
    frame = np.arange(50)
    assert 0 < scatter(frame, np.zeros(50, int), np.column_stack([frame, frame])) < 1e-5


def test_a_row_says_where_its_errors_come_from(clips):
    z = []
    for i, (truth, camera) in enumerate(clips):
        tracks = noisy(truth, np.random.default_rng(i), 0.02)
        (given,) = measure(tracks, camera)
        (found,) = measure(replace(tracks, cov=np.full_like(tracks.cov, np.nan)), camera)
        assert given["noise"] == "given"
        assert np.isnan(given["noise_px"])
        assert found["noise"] == "scatter"
        assert found["noise_px"] == pytest.approx(0.02, rel=0.3)
        assert found["r"] == pytest.approx(given["r"], abs=given["r_std"])
        z.append(found["chi2_free"] / found["dof_free"])
    assert np.mean(z) == pytest.approx(1, abs=0.15)
