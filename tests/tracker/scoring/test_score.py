"""Scores against hand-worked cases, Monte Carlo, and results spoiled on purpose."""

import json
import pickle
import re
import shutil

import numpy as np
import pandas as pd
import pytest
from tracker_noisy import BENCHMARK, NOISE, dataset, noisy, results, scalars_of, truth_of

from synthcam_shared.errors import InputError
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.measurement.estimate import measure
from tracker.scoring.error_bars import compute_error_statistics, compute_true_parameters, quantity_bounds
from tracker.scoring.localisation import PositionSums, match, position_bounds, score_positions
from tracker.scoring.score import _score_clip, score, to_track_points
from tracker.scoring.tracking_metrics import TrackPoints, score_tracks

CLIPS = 4


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return dataset(tmp_path_factory.mktemp("score") / "data", BENCHMARK, CLIPS, seed=2)


@pytest.fixture(scope="module")
def found(tmp_path_factory, data):
    return results(tmp_path_factory.mktemp("found"), data, CLIPS)


def dots(*points):
    frame, track, x, y = np.array(points, dtype=float).reshape(-1, 4).T
    return TrackPoints.of(frame.astype(int), track.astype(int), np.column_stack([x, y]))


LINE = dots(*((f, 0, 20 * f, 0) for f in range(4)))


def test_perfect_tracks_score_one():
    both = dots(*((f, k, 20 * f, 50 * k) for f in range(4) for k in (0, 1)))
    for name, value in score_tracks([(both, both), (LINE, LINE)]).items():
        assert value == (0 if name == "swaps" else pytest.approx(1))


def test_a_track_broken_in_the_middle():
    """Worked by hand: four points, found as two tracks of two."""
    broken = dots(*((f, f // 2, 20 * f, 0) for f in range(4)))
    got = score_tracks([(LINE, broken)])
    by_hand = {"alpha": 1 / 2, "beta": 1 / 3, "jsc": 1 / 3, "jsc_theta": 1 / 2, "mota": 3 / 4, "idf1": 1 / 2}
    for name, value in by_hand.items():
        assert got[name] == pytest.approx(value)
    assert got["hota"] == pytest.approx(np.sqrt(1 / 2))  # detection 1, association 2/4
    assert got["swaps"] == 1


def test_misses_extras_and_offsets():
    """One of four points missed, one point from nowhere; then all points 1 px off with a gate of 5."""
    partial = dots((0, 0, 0, 0), (1, 0, 20, 0), (2, 0, 40, 0), (3, 1, 300, 300))
    got = score_tracks([(LINE, partial)])
    assert got["mota"] == pytest.approx(1 - 2 / 4)
    assert got["idf1"] == pytest.approx(2 * 3 / 8)
    assert got["alpha"] == pytest.approx(3 / 4)
    assert got["beta"] == pytest.approx((4 - 1) / (4 + 1))
    assert got["jsc"] == pytest.approx(3 / 5)
    off = TrackPoints(LINE.frame, LINE.track, LINE.xy + np.array([0, 1.0]))
    assert score_tracks([(LINE, off)])["alpha"] == pytest.approx(0.8)
    assert score_tracks([(LINE, off)])["hota"] == pytest.approx(16 / 19)  # alike .8: the levels up to .8 of 19
    lost = TrackPoints(LINE.frame, LINE.track, LINE.xy + np.array([0, 6.0]))
    assert score_tracks([(LINE, lost)])["mota"] == pytest.approx(-1)
    assert score_tracks([(LINE, lost)])["jsc_theta"] == 0


def test_exchanged_balls_are_two_swaps():
    truth = dots(*((f, k, 20 * f, 50 * k) for f in range(6) for k in (0, 1)))
    crossed = dots(*((f, k if f < 3 else 1 - k, 20 * f, 50 * k) for f in range(6) for k in (0, 1)))
    got = score_tracks([(truth, crossed)])
    assert got["swaps"] == 2
    assert got["idf1"] == pytest.approx(0.5)
    assert got["mota"] == pytest.approx(1 - 2 / 12)


def test_nothing_found_and_nothing_there():
    nothing = dots()
    got = score_tracks([(LINE, nothing)])
    assert (got["alpha"], got["jsc"], got["hota"], got["mota"]) == (0, 0, 0, 0)
    assert np.isnan(score_tracks([(nothing, nothing)])["alpha"])


def ball_table(positions, visible=True):
    frame = np.arange(len(positions))
    table = pd.DataFrame({"frame": frame, "particle": 0, "visible": visible})
    return table.assign(x_mean_px=[p[0] for p in positions], y_mean_px=[p[1] for p in positions])


def test_missed_false_and_excused_detections():
    truth = ball_table([(10.0, 10.0), (20.0, 10.0), (30.0, 10.0), (2.0, 10.0)], [True, True, True, False])
    spots = pd.DataFrame({"frame": [0, 1, 1, 3], "particle": [0, 0, 1, 0], "x": [10.5, 29.0, 90.0, 8.0], "y": 10.0})
    got = match(truth, spots, gate=5.0, ball_px=14.9)
    assert got.pairs.tolist() == [[0, 0]]
    assert got.missed == 2  # frames 1 (9 px off) and 2; the one half out of view need not be found
    assert got.false == 2  # both of frame 1; that of frame 3 lies on what shows of the hidden ball
    assert got.counted.tolist() == [True, True, True, False]


def test_a_ball_that_others_hide_by_more_than_half_need_not_be_found():
    truth = ball_table([(10.0, 10.0), (20.0, 10.0), (30.0, 10.0)]).assign(hidden=[0.3, 0.6, np.nan])
    spots = pd.DataFrame({"frame": [1], "particle": [0], "x": [21.0], "y": 10.0})
    assert match(truth.drop(columns="hidden"), spots, gate=5.0, ball_px=14.9).missed == 2
    got = match(truth, spots, gate=5.0, ball_px=14.9)
    assert (got.missed, got.false) == (2, 0)
    assert not got.counted[0]  # on what shows of the hidden ball
    assert len(to_track_points(got)[0].frame) == 2


def test_pixel_locking_shows_as_phase_bias():
    rng = np.random.default_rng(0)
    positions = [(0.37 * k, 50 + 0.211 * k) for k in range(2000)]
    truth = ball_table(positions)
    for locked in (0.0, 0.02):
        x = np.array([p[0] for p in positions])
        noise = rng.normal(0, 0.01, (2, len(x)))
        spots = pd.DataFrame({"frame": truth["frame"], "particle": 0, "x": x + locked / 2 * np.sin(2 * np.pi * x)})
        spots = spots.assign(x=spots["x"] + noise[0], y=truth["y_mean_px"] + noise[1])
        matched = match(truth, spots, 5.0, 14.9)
        got = score_positions([(matched, np.full((len(x), 2, 2), np.nan))])
        assert got["phase_bias_px"] == pytest.approx(locked, abs=0.002)
        assert np.isnan(got["bound_px"])


def test_clips_pool_as_all_their_positions_at_once(data, found):
    """The figures by their definitions."""
    clips = []
    for clip in range(CLIPS):
        truth, camera = truth_of(data, clip)
        tracks = pd.read_parquet(found / "clips" / f"{clip:06d}" / "tracks.parquet")
        matched = match(truth, tracks, 5.0, camera.diameter_px)
        clips.append((matched, position_bounds(matched, camera)))
    got = score_positions(clips)
    off, cov = (np.concatenate(parts) for parts in zip(*((m.off, c) for m, c in clips), strict=True))
    assert got["n"] == len(off) > 300
    assert got["rmse_px"] == pytest.approx(np.sqrt((off**2).mean()), rel=1e-12)
    assert got["bound_px"] == pytest.approx(np.sqrt(np.mean([np.trace(c) for c in cov]) / 2), rel=1e-12)


def test_what_is_kept_of_a_clip_does_not_grow_with_its_frames(data, found):
    _, held = _score_clip(found, data, 0)
    assert isinstance(held[0], PositionSums)
    assert len(pickle.dumps(held)) < 4000  # its tracks and bounds alone have 20 kB


def test_figures_of_known_errors():
    rng = np.random.default_rng(1)
    n = 4000
    std = rng.uniform(0.5, 2.0, n)
    off = rng.normal(0, 1, n) * std
    got = compute_error_statistics(3 + off, std, np.full(n, 3.0), std)
    assert got["ratio"] == pytest.approx(1, abs=4 / np.sqrt(n))
    assert got["z_std"] == pytest.approx(1, abs=4 / np.sqrt(2 * n))
    assert got["cover68"] == pytest.approx(0.6827, abs=4 * np.sqrt(0.22 / n))
    assert got["cover95"] == pytest.approx(0.95, abs=4 * np.sqrt(0.0475 / n))
    assert (
        compute_error_statistics(3 + off, std / 2, np.full(n, 3.0), std)["cover68"] < 0.45
    )  # what too small errors look like
    some = compute_error_statistics(
        np.array([1.0, np.nan, 2.0]), np.array([0.1, 0.1, 0.0]), np.array([1.1, 1, 2]), np.ones(3)
    )
    assert some["n"] == 2
    assert some["z_mean"] == pytest.approx(-1.0)  # an error of zero is no claim


def limits_of(folder, clip):
    """The bounds of a clip whose positions all have the same noise."""
    truth, camera = truth_of(folder, clip)
    scalars = scalars_of(folder).iloc[clip]
    tied = compute_true_parameters(
        truth, {k: float(scalars[k]) for k in ("v0", "b", "t_c", "r", "mu_k", "C", "drag", "decel")}
    )
    seen = truth[truth["visible"]].reset_index(drop=True)
    spots = seen[["frame", "particle"]].assign(x=seen["x_mean_px"], y=seen["y_mean_px"])
    matched = match(truth, spots, 5.0, camera.diameter_px)
    return quantity_bounds(matched, np.broadcast_to(np.eye(2) * NOISE**2, (len(spots), 2, 2)), tied, camera)


def test_bounds_of_a_hit_that_is_exactly_head_on(tmp_path):
    """They are those of a hit that is nearly so; only s, a ratio by b, has none."""
    exact, nearly = (
        limits_of(dataset(tmp_path / str(b), {**BENCHMARK, "launch": {"v0": 0.3, "b": b, "heading": 0}}, 1), 0)
        for b in (0, 1e-4)
    )
    assert {name for name, bound in exact.items() if not np.isfinite(bound)} == {"s_bound", "s_free_bound"}
    for name in exact.keys() - {"s_bound", "s_free_bound", "final_angle_bound", "final_angle_free_bound"}:
        assert exact[name] == pytest.approx(nearly[name], rel=0.01), name


@pytest.mark.gate
def test_bound_is_reached_by_the_fit(data):
    """The Fisher bound at the truth, against the scatter of 60 films of that clip."""
    truth, camera = truth_of(data, 1)
    limits = limits_of(data, 1)
    rng = np.random.default_rng(3)
    rows = [measure(noisy(truth, rng), camera)[0] for _ in range(60)]
    for name in ("r", "mu_k", "C", "tau1", "energy_fraction", "v2f_free", "r_free", "tau2_free"):
        scatter = np.std([row[name] for row in rows])
        assert scatter == pytest.approx(limits[f"{name}_bound"], rel=4 / np.sqrt(120))


def test_score_has_the_contracts_keys(found, data, tmp_path):
    got = score(found, data, detector="noisy")
    path = got.write(tmp_path / "report")
    table = json.loads(path.read_text())
    assert path.name == "score.json"
    parts = table["detectors"]["noisy"]
    assert set(parts["localisation"]) == {"n", "missed", "false", "rmse_px", "bound_px", "ratio", "phase_bias_px"}
    assert set(parts["tracking"]) == {
        "alpha",
        "beta",
        "jsc",
        "jsc_theta",
        "mota",
        "motp",
        "idf1",
        "hota",
        "deta",
        "assa",
        "swaps",
    }
    keys = {"n", "bias", "rmse", "bound", "ratio", "z_mean", "z_std", "cover68", "cover95"}
    assert set(parts["quantities"]) == {f"{n}{k}" for n in QUANTITY_NAMES for k in ("", "_free", "_local", "_paper")}
    assert parts["quantities"]["r_local"]["n"] == CLIPS
    assert parts["quantities"]["r_local"]["z_std"] < 1.5
    assert parts["quantities"]["v0_local"]["cover95"] >= 0.8
    assert all(set(v) == keys for v in parts["quantities"].values())
    assert parts["ms_per_frame"] is None
    assert parts["clips"] == {"n": CLIPS, "ok": CLIPS}
    assert parts["localisation"]["missed"] == parts["localisation"]["false"] == parts["tracking"]["swaps"] == 0
    assert parts["localisation"]["rmse_px"] == pytest.approx(NOISE, rel=0.05)
    assert abs(parts["quantities"]["r"]["bias"]) < 1e-3
    assert parts["quantities"]["r"]["bound"] < 1e-3
    assert list(tmp_path.glob("report/*.part")) == []


def test_a_shifted_detector_and_a_lost_clip_are_seen(data, tmp_path, found):
    shifted = score(results(tmp_path / "shifted", data, CLIPS, shift=0.02), data)
    assert shifted.localisation["rmse_px"] == pytest.approx(np.hypot(NOISE, 0.02 / np.sqrt(2)), rel=0.05)
    some = score(results(tmp_path / "some", data, CLIPS - 1), data)
    whole = score(found, data)
    last, _ = truth_of(data, CLIPS - 1)
    assert some.localisation["missed"] == last["visible"].sum()
    assert some.statuses == {"n": CLIPS, "ok": CLIPS - 1, "no result": 1}
    assert some.quantities["r"]["n"] == whole.quantities["r"]["n"] - 1


@pytest.mark.parametrize(
    ("columns", "says"), [(["glint_x_px", "glint_y_px"], True), (["x_mean_px", "y_mean_px"], False)]
)
def test_glints_given_as_centres_are_seen(data, tmp_path, found, columns, says):
    spoiled = tmp_path / "results"
    shutil.copytree(found, spoiled)
    for clip in range(CLIPS):
        path = spoiled / "clips" / f"{clip:06d}" / "tracks.parquet"
        truth, _ = truth_of(data, clip)
        tracks = truth[["frame", "particle"]].assign(x=truth[columns[0]] + 0.02, y=truth[columns[1]])
        tracks.to_parquet(path)
    assert ("--point glint" in score(spoiled, data).note) == says


def test_localisation_bound_is_used(data):
    truth, camera = truth_of(data, 0)
    tracks = noisy(truth, np.random.default_rng(0))
    spots = pd.DataFrame({n: getattr(tracks, n) for n in ("frame", "particle", "x", "y", "flux")})
    matched = match(truth, spots, 5.0, camera.diameter_px)
    cov = position_bounds(matched, camera)
    assert cov.shape == (len(matched.pairs), 2, 2)
    dim = position_bounds(match(truth, spots.assign(flux=spots["flux"] / 4), 5.0, camera.diameter_px), camera)
    assert (np.trace(dim, axis1=1, axis2=2) > 3 * np.trace(cov, axis1=1, axis2=2)).all()
    assert np.isnan(position_bounds(match(truth, spots.drop(columns="flux"), 5.0, camera.diameter_px), camera)).all()


def test_what_is_missing_is_named(found, data, tmp_path):
    with pytest.raises(InputError, match=r"clips\.parquet: no such file"):
        score(found, tmp_path)
    with pytest.raises(InputError, match=r"estimates\.parquet: no such file"):
        score(tmp_path, data)


def test_a_damaged_table_is_one_line(data, found, tmp_path):
    folders = {"truth": shutil.copytree(data, tmp_path / "truth"), "found": shutil.copytree(found, tmp_path / "found")}
    for where, file, said in (
        ("truth", "truth/clips.parquet", "damaged, expected the truth of a dataset"),
        ("truth", "clips/000000/truth/tracks.parquet", "damaged, expected true tracks"),
        ("found", "estimates.parquet", "damaged, expected results of tracker track"),
        ("found", "clips/000000/tracks.parquet", "damaged, expected tracks"),
    ):
        path = folders[where] / file
        before = path.read_bytes()
        path.write_text("no table")
        with pytest.raises(InputError, match=re.escape(f"{path}: {said}")) as error:
            score(folders["found"], folders["truth"])
        assert "\n" not in str(error.value)
        path.write_bytes(before)
    path = folders["truth"] / "truth/clips.parquet"
    pd.read_parquet(path)[["clip", "scene", "b"]].to_parquet(path)
    with pytest.raises(InputError, match="no column v0, t_c, r, mu_k, C, drag, decel, expected the truth of a dataset"):
        score(folders["found"], folders["truth"])
