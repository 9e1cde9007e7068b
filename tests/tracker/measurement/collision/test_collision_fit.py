"""Both fits of one collision, from starts that may lead astray."""

import numpy as np
import pytest
from tracker_noisy import BENCHMARK, dataset, noisy, scalars_of, truth_of

from tracker.measurement.collision import collision_fit
from tracker.measurement.collision.collision_model import TIED
from tracker.measurement.estimate import measure


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    folder = dataset(tmp_path_factory.mktemp("fit") / "ds", BENCHMARK, 1, seed=13)
    truth, camera = truth_of(folder, 0)
    return noisy(truth, np.random.default_rng(0), 0.05), camera, float(scalars_of(folder)["r"][0])


def test_a_start_that_leads_astray_is_not_the_last(clip, monkeypatch):
    """For tracks by H.264, the fit from the likeliest start of a grid ended at chi^2 of 400 a degree of freedom."""
    tracks, camera, restitution = clip
    found = collision_fit.guess_parameters

    def astray(meeting):
        good = found(meeting)
        bad = good[0].copy()
        bad[TIED.index("t_c")] += 0.1
        return [bad, *good]

    monkeypatch.setattr(collision_fit, "guess_parameters", lambda meeting: astray(meeting)[:1])
    assert measure(tracks, camera)[0]["status"] != "ok"
    monkeypatch.setattr(collision_fit, "guess_parameters", astray)
    (row,) = measure(tracks, camera)
    assert row["status"] == "ok"
    assert row["r"] == pytest.approx(restitution, abs=4 * row["r_std"])
