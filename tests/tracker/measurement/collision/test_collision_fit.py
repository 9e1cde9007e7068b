"""Both fits of one collision, from starts that may lead astray."""

from dataclasses import replace

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


def test_slide_times_that_the_tied_fit_lacks_are_tried_only_where_the_tracks_reject_it(clip, monkeypatch):
    """Where they accept it, other slide times end where the first ones do."""
    tracks, camera, _ = clip
    asked, fit = list[int](), collision_fit.fit_motion

    def count(pair, tied, starts, *rest, **more):
        asked.append(1 if tied else len(starts))
        return fit(pair, tied, starts, *rest, **more)

    monkeypatch.setattr(collision_fit, "fit_motion", count)
    (row,) = measure(tracks, camera)
    assert set(asked) == {1}
    monkeypatch.setattr(collision_fit, "_is_accepted", lambda *_: False)
    (same,) = measure(tracks, camera)
    assert max(asked) == 3
    for name in ("v0", "r", "mu_k", "C", "tau1", "tau2"):
        assert row[f"{name}_free"] == pytest.approx(same[f"{name}_free"], abs=1e-3 * row[f"{name}_free_std"])
    monkeypatch.undo()
    monkeypatch.setattr(collision_fit, "fit_motion", count)
    asked.clear()
    slower = replace(tracks, x=np.where(tracks.frame > np.median(tracks.frame), tracks.x + 0.3, tracks.x))
    measure(slower, camera)
    assert max(asked) == 3
