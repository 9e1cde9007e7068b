"""Fits that the data reject, errors that a table claims wrongly, and clips that spoil nothing but themselves."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import kstest
from tracker_forces import tied
from tracker_noisy import BENCHMARK, NOISE, dataset, measured, noisy, results, scalars_of, truth_of, without_local
from typer.testing import CliRunner

import tracker
from discrepancy.data.first_guess import build_collision
from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.cli import app
from tracker.detection.link import Tracks
from tracker.measurement import estimate
from tracker.measurement.collision import collision_fit, noise_correlation
from tracker.measurement.collision.adequacy import Flag, compute_p_value, list_disproving_values
from tracker.measurement.collision.collision_model import mean_positions, tied_to_free
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.measurement.estimate import fit_all_jointly, measure
from tracker.measurement.messages import list_messages
from tracker.notes import NoteKind
from tracker.recording import measure_clip
from tracker.scoring.score import score
from tracker.scoring.score_page import write_report
from tracker.settings import FitSettings, TrackerSettings

CLIPS = 14
LEVEL = FitSettings().rejection_level
SHOWN = ("v0", "b", "r", "mu_k", "C", "tau1", "energy_fraction")


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    return dataset(tmp_path_factory.mktemp("own") / "data", BENCHMARK, CLIPS)


@pytest.fixture(scope="module")
def hopping(tmp_path_factory):
    """Collisions with a motion that the model has not: the target is pressed on the plate and hops."""
    settings = BENCHMARK | {"effects": {"hop": {"share": 1.0}}}
    return dataset(tmp_path_factory.mktemp("hop") / "data", settings, 4)


@pytest.fixture(scope="module")
def rejected(hopping):
    """Rows of four collisions that the model does not fit."""
    return measured(hopping, 4)


@pytest.fixture(scope="module")
def accepted(own):
    """Rows of eight collisions that the model fits."""
    return measured(own, 8)


def lasting(rng, count, rho):
    """Unit noise (count, 2) whose correlation falls as rho^lag."""
    noise = rng.standard_normal((count, 2))
    for k in range(1, count):
        noise[k] = rho * noise[k - 1] + np.sqrt(1 - rho**2) * noise[k]
    return noise


def claiming(own, size, claim, rho=0.0, clips=CLIPS, settings=None):
    """A row a clip of tracks with noise of `size` that claim `claim` (None: nothing), px, and the truth."""
    rng, rows, truths = np.random.default_rng(3), [], scalars_of(own)
    for clip in range(clips):
        truth, camera = truth_of(own, clip)
        tracks = noisy(truth, rng, 0.0)
        off = np.concatenate([lasting(rng, int((tracks.particle == ball).sum()), rho) for ball in (0, 1)])
        xy = tracks.xy + size * off
        cov = np.broadcast_to(np.eye(2) * (np.nan if claim is None else claim) ** 2, tracks.cov.shape)
        with without_local():
            (row,) = measure(replace(tracks, x=xy[:, 0], y=xy[:, 1], cov=cov), camera, settings)
        rows.append(row | {f"{n}_true": truths[n].iloc[clip] for n in QUANTITY_NAMES})
    return pd.DataFrame(rows)


def z_of(table, name):
    off = ((table[name] - table[f"{name}_true"]) / table[f"{name}_std"]).to_numpy(float)
    return off[np.isfinite(off)]


def dishonest(table):
    """Quantities whose z is not N(0, 1), by more than 4 sampling errors; those without z count too."""
    found = {name: z_of(table, name) for name in SHOWN}
    return [n for n, z in found.items() if not (len(z) and abs(z.std() - 1) < 4 / np.sqrt(2 * len(z)))]


def test_what_the_data_reject_has_no_errors_and_stays_for_looking_at(rejected):
    table = rejected
    assert table["status"].tolist() == ["misfit"] * 4
    assert (table["adequate"] < LEVEL).all()
    accepted = table["adequate_free"] > LEVEL
    assert accepted.sum() == 3  # of the fastest the flight shows in the free fit too
    assert table.loc[~accepted, [f"{name}_free_std" for name in QUANTITY_NAMES]].isna().all(axis=None)
    for name in ("v0", "r", "mu_k", "C", "tau1"):
        assert np.isfinite(table[name]).all()
    assert table[[f"{name}_std" for name in QUANTITY_NAMES]].isna().all(axis=None)
    assert np.isfinite(table.loc[accepted, "v0_free_std"]).all()
    assert table[[f"{n}_free_std" for n in ("C", "w1t", "w2t")]].isna().all(axis=None)  # by laws that are in doubt
    blocks = json.loads(table["cov"][0])
    assert {v for line in blocks["tied"] for v in line} == {None}
    assert blocks["free"][0][0] > 0
    note, *local = list_messages(table, "out/results")
    assert all(str(other).startswith(("local estimates: ", "masses: ")) for other in local)
    assert note.kind is NoteKind.MISFIT
    said = str(note)
    assert said.startswith("4 of 4 collisions do not fit the model (median chi2/dof ")
    causes = ["compression", "do not roll", "scale", "tilted plate", "unequal balls", "slides or spins"]
    assert sorted(causes, key=said.index) == causes
    assert said.endswith("To find the cause: discrepancy find out/results --model MODEL")


def test_nothing_of_a_misfit_is_fitted_with_the_others(accepted, rejected):
    good, bad = accepted.iloc[:6], rejected
    assert fit_all_jointly(pd.concat([good, bad])) == fit_all_jointly(good)
    assert fit_all_jointly(bad)["clips"] == 0


def test_a_search_takes_what_the_tracker_rejects(hopping):
    truth, camera = truth_of(hopping, 0)
    tracks = noisy(truth, np.random.default_rng(0))
    (row,) = measure(tracks, camera)
    assert row["status"] == "misfit"
    found = build_collision(tracks, row | {"clip": 0}, camera)
    assert not isinstance(found, str)
    assert found.launch[3] == pytest.approx(scalars_of(hopping)["v0"][0], rel=0.01)


def test_own_clips_are_borne_and_the_test_can_fail(own):
    table = claiming(own, NOISE, NOISE)
    assert (table["status"] == "ok").all()
    assert (table["noise"] == "given").all()
    assert (table["flags"] == "").all()
    for name in ("adequate", "adequate_free", "agree"):
        assert kstest(table[name], "uniform").pvalue > 1e-3
    assert kstest(claiming(own, NOISE, NOISE / 1.15)["adequate"], "uniform").pvalue < 1e-3


@pytest.mark.parametrize("times", [5.0, 0.2])
def test_errors_claimed_wrongly_are_found_from_the_tracks(own, times):
    table, without = (claiming(own, times * NOISE, claim, clips=6) for claim in (NOISE, None))
    assert (table["status"] == "ok").all()
    assert (table["noise"] == "scatter").all()
    assert table["noise_ratio"].mean() == pytest.approx(times, rel=0.05)
    assert without["noise_ratio"].isna().all()
    assert dishonest(table) == []
    for name in SHOWN:
        assert np.abs((table[name] - without[name]) / table[f"{name}_std"]).max() < 0.05
    (note,) = list_messages(table)
    assert note.kind is NoteKind.NOISE
    assert f"by {table['noise_ratio'].median():.3g} times their claimed errors" in str(note)
    assert list_messages(without) == []  # a table that claims nothing claims nothing wrong


@pytest.mark.gate
def test_noise_that_lasts_is_counted(own, monkeypatch):
    table = claiming(own, NOISE, NOISE, rho=0.9)
    assert (table["status"] == "ok").all()
    assert table["noise_rho"].median() == pytest.approx(0.9, abs=0.05)
    assert kstest(table["adequate"], "uniform").pvalue > 1e-3
    assert dishonest(table) == []
    monkeypatch.setattr(collision_fit, "with_correlated_noise", lambda pair, free: None)
    monkeypatch.setattr(collision_fit, "list_alternative_strikers", lambda meeting, rolling: iter(()))
    true_laws = FitSettings(rolling_loss_difference=0.0, broken_law=0.0)  # noise that is not counted looks like others
    assert len(dishonest(claiming(own, NOISE, NOISE, rho=0.9, settings=true_laws))) == len(SHOWN)


def test_noise_is_read_where_the_impact_has_no_part(hopping, monkeypatch):
    """A misfit of the model just after the hit is not mistaken for lasting noise, even if all fits before."""
    monkeypatch.setattr(noise_correlation, "MIN_CORRELATION_SIGMA", -np.inf)
    table = measured(hopping, 2)
    assert (table["noise_rho"] == 0).all()
    assert (table["status"] == "misfit").all()


def test_p_values_of_errors_found_from_the_same_residuals():
    """Draws of residuals whose first part gives the size: the p-values are uniform, those without it are not."""
    rng = np.random.default_rng(1)
    known, rest = rng.chisquare(60, 4000), rng.chisquare(40, 4000)
    size = known / 60
    found = [compute_p_value(c, 100, 60) for c in (known + rest) / size]
    assert kstest(found, "uniform").pvalue > 1e-3
    assert kstest([compute_p_value(c, 100, np.inf) for c in (known + rest) / size], "uniform").pvalue < 1e-3
    assert np.isnan(compute_p_value(100.0, 100, 0.0))
    assert compute_p_value(1000.0, 100, 60) < LEVEL < compute_p_value(130.0, 100, 60)


def pucks(camera, r, mass, v0=0.3, b=0.2, frames=100, noise=0.02):
    """Two discs that glide without friction or spin; mass of the target over the striker's; tc at .1 s."""
    d, n = np.array([1.0, 0.0]), np.array([np.sqrt(1 - b * b), -b])
    kick = (1 + r) * v0 * n[0] / (1 + mass)  # impulse over the target's mass, along n
    since = np.arange(frames)[:, None] / camera.fps + camera.exposure / 2 - 0.1
    late = np.maximum(since, 0)
    ways = kick * n * late, -camera.ball_diameter * n + v0 * d * since - mass * kick * n * late
    flat = np.concatenate([np.column_stack([way, np.full(frames, camera.radius)]) for way in ways])
    xy = camera.project(flat) + np.random.default_rng(0).normal(0, noise, (2 * frames, 2))
    cov, plain = np.tile(np.eye(2) * noise**2, (2 * frames, 1, 1)), np.full(2 * frames, np.nan)
    frame, particle = np.tile(np.arange(frames), 2), np.repeat([0, 1], frames)
    return Tracks(frame, particle, xy[:, 0], xy[:, 1], cov, plain, np.full(2 * frames, ""), plain, plain)


@pytest.mark.gate
def test_pucks_on_air(own):
    """Gliding discs are balls without friction; unequal ones are no equal balls, and a restitution over 1 is said."""
    camera = truth_of(own, 0)[1]
    (equal,) = measure(pucks(camera, 0.8, 1.0), camera)
    assert (equal["status"], equal["flags"]) == ("ok", "no slide seen")
    assert abs(equal["r"] - 0.8) < 4 * equal["r_std"]
    (heavy,) = measure(pucks(camera, 0.8, 2.0), camera)
    assert heavy["status"] == "misfit"
    assert heavy["flags"].split("|") == ["r over 1", "C over 5/7"]
    assert np.isnan(heavy["r_std"])
    notes = {note.kind: str(note) for note in list_messages(pd.DataFrame([heavy]))}
    assert notes[NoteKind.MISFIT].startswith("1 of 1 collision does not fit")
    assert notes[NoteKind.FLAG].startswith("r over 1 (1 collision): no two equal balls collide so")


def follow_model(camera, noise, claims=True, **changes):
    """Tracks of two balls that move as the tracker's own model says, whatever its parameters."""
    free = tied_to_free(tied(**changes))
    start, frame, particle = np.arange(100) / camera.fps, np.tile(np.arange(100), 2), np.repeat([0, 1], 100)
    metres = [mean_positions(free, ball, start, camera.exposure, camera.ball_diameter)[0] for ball in (1, 2)]
    flat = np.concatenate([np.column_stack([xy, np.full(100, camera.radius)]) for xy in metres])
    xy = camera.project(flat) + np.random.default_rng(0).normal(0, noise, (200, 2))
    cov, plain = np.tile(np.eye(2) * noise**2, (200, 1, 1)), np.full(200, np.nan)
    cov = cov if claims else np.full_like(cov, np.nan)
    return Tracks(frame, particle, xy[:, 0], xy[:, 1], cov, plain, np.full(200, ""), plain, plain)


@pytest.mark.parametrize(
    ("changes", "flag"),
    [
        ({"r": 1.088}, Flag.R_OVER_1),
        ({"C": -0.1}, Flag.C_UNDER_0),
        ({"C": 0.8}, Flag.C_OVER_5_7),
        ({"r": 1.0}, None),
        ({"r": 0.99, "C": 0.7}, None),
        ({"C": 0.0}, None),
    ],
)
def test_impossible_values_are_a_misfit_however_well_they_fit(own, changes, flag):
    camera = truth_of(own, 0)[1]
    (row,) = measure(follow_model(camera, NOISE, **changes), camera)
    assert min(row["adequate"], row["adequate_free"], row["agree"]) > LEVEL
    (name,) = [key for key in changes if flag is None or key in flag][:1]
    assert row[name] == pytest.approx(changes[name], abs=0.03)
    table = pd.DataFrame([row | {"clip": 0}])
    if flag is None:
        assert (row["status"], row["flags"]) == ("ok", "")
        assert row[f"{name}_std"] > 0
        assert fit_all_jointly(table)["clips"] == 1
        return
    assert (row["status"], row["flags"]) == ("misfit", flag)
    assert np.isnan(row[f"{name}_std"])
    assert row[f"{name}_free_std"] > 0 or name == "C"  # velocities are measured whatever the law of the impact
    assert fit_all_jointly(table)["clips"] == 0
    said = [str(one) for one in list_messages(table) if one.kind is NoteKind.FLAG]  # and what the local estimate says
    assert sum(text.startswith(f"{flag} (1 collision): no two equal balls collide so") for text in said) == 1


@pytest.mark.parametrize("level", [1e-3, 1e-6])
def test_a_level_of_rejection_that_was_set_decides_what_a_misfit_is_said_to_break(own, level):
    """r over 1, and claimed errors a little too small, so that the p-value lies between both levels."""
    camera = truth_of(own, 0)[1]
    tracks = follow_model(camera, NOISE, r=1.088)
    tracks = replace(tracks, cov=tracks.cov / 1.32)
    with without_local():
        (row,) = measure(tracks, camera, FitSettings(rejection_level=level))
    assert 1e-6 < row["adequate"] < 1e-3
    rejected = level == 1e-3
    assert (row["status"], row["model_rejected"]) == ("misfit", rejected)
    assert list_disproving_values(row) == ([] if rejected else ["r over 1"])
    said = [one.kind for one in list_messages(pd.DataFrame([row | {"clip": 0}]))]
    assert (NoteKind.MISFIT in said) == rejected


@pytest.mark.parametrize(("noise", "claims", "status"), [(1, True, "misfit"), (20, True, "ok"), (20, False, "ok")])
def test_a_value_within_three_errors_of_its_limit_stays(own, noise, claims, status):
    """The same restitution of 1.005, seen with little noise and with much; and by tracks that claim no errors."""
    camera = truth_of(own, 0)[1]
    (row,) = measure(follow_model(camera, noise * NOISE, claims, r=1.005), camera)
    assert row["status"] == status
    assert (row["flags"] == "r over 1") == (status == "misfit")
    if status == "ok":
        assert 1 < row["r"] < 1 + 3 * row["r_std"]


def test_the_thresholds_of_a_fit_are_settings(own, tmp_path):
    """By argument, by keys and by a YAML file; other settings are another run, and a wrong key is named."""
    camera = truth_of(own, 0)[1]
    tracks, strict, loose = follow_model(camera, NOISE, r=1.088), FitSettings(), FitSettings(impossible_sigma=1e4)
    with without_local():
        assert [measure(tracks, camera, s)[0]["status"] for s in (strict, loose)] == ["misfit", "ok"]
    (row,) = measure(tracks, camera, FitSettings(local_window_s=0))
    assert (row["status"], json.loads(row["local"])["reason"]) == ("misfit", "the setting local_window_s is 0")
    table = pd.DataFrame({name: getattr(tracks, name) for name in ("frame", "particle", "x", "y")})
    table = table.assign(x_std=NOISE, y_std=NOISE)
    table.to_csv(tmp_path / "tracks.csv", index=False)
    for settings in (TrackerSettings(fit=loose), {"fit": {"impossible_sigma": 1e4}}):
        assert tracker.measure(table, camera, settings=settings).rows[0]["status"] == "ok"
    (tmp_path / "settings.yaml").write_text("fit: {impossible_sigma: 1.0e+4}\n")
    (tmp_path / "wrong.yaml").write_text("fit: {impossible_sigmas: 5}\n")
    words = ["measure", str(tmp_path / "tracks.csv"), "--camera", str(own / "clips/000000/camera.json")]
    words += ["-o", str(tmp_path / "out"), "--no-pages"]
    done = CliRunner().invoke(app, [*words, "--json", "--settings", str(tmp_path / "settings.yaml")])
    assert json.loads(done.stdout)["status"] == {"ok": 1}
    run = json.loads((tmp_path / "out/run.json").read_text())
    assert run["settings"] == {"fit": {"impossible_sigma": 1e4}}
    with pytest.raises(InputError, match="holds the results of another run"):
        CliRunner().invoke(app, words, catch_exceptions=False)
    with pytest.raises(InputError, match=r"wrong\.yaml: fit\.impossible_sigmas"):
        CliRunner().invoke(app, [*words, "--settings", str(tmp_path / "wrong.yaml")], catch_exceptions=False)


@pytest.mark.parametrize(
    ("key", "times", "flag"),
    [
        ("scale", 0.95, "balls overlap"),
        ("scale", 1.05, "balls do not touch"),
        ("ball_diameter", 0.7, "balls do not touch"),
        ("fps", 10, "mu_k over 1.5"),
        ("both", 100, "v0 over 20 m/s"),
    ],
)
def test_a_wrong_camera_is_said_with_what_to_check(own, key, times, flag):
    truth, camera = truth_of(own, 0)
    given = {name: getattr(camera, name) for name in ("size", "striker", "fps", "scale", "ball_diameter")}
    given |= {name: given[name] * times for name in (("scale", "ball_diameter") if key == "both" else (key,))}
    rows = measure(noisy(truth, np.random.default_rng(0)), Camera.from_dict(given | {"t": [0, 0, 1e3]}))
    assert flag in rows[0]["flags"].split("|")
    (line,) = [line for line in map(str, list_messages(pd.DataFrame(rows))) if line.startswith(flag)]
    assert "check" in line
    assert "masses" not in line


def test_a_scale_as_wrong_as_it_is_said_to_be_is_not_suspicious(own):
    truth, camera = truth_of(own, 0)
    given = {name: getattr(camera, name) for name in ("size", "striker", "fps", "ball_diameter")}
    wrong = given | {"scale": 0.95 * camera.scale, "scale_std": 0.03 * camera.scale}
    (row,) = measure(noisy(truth, np.random.default_rng(0)), Camera.from_dict(wrong))
    assert (row["status"], row["flags"]) == ("ok", "")


def test_what_the_model_cannot_follow_is_no_outlier(own):
    """Two positions bent by 8 errors after the hit: both fits see the same ones; one wrong position is left out."""
    truth, camera = truth_of(own, 1)
    tracks = noisy(truth, np.random.default_rng(0))
    x = tracks.x.copy()
    x[60] += 1.0
    (row,) = measure(replace(tracks, x=x), camera)
    assert (row["status"], row["dropped"], row["dropped_free"]) == ("ok", 1, 1)
    assert row["dof"] - row["dof_free"] == 7


@pytest.mark.parametrize("error", [np.linalg.LinAlgError("singular"), ValueError("no"), ZeroDivisionError("none")])
def test_a_clip_whose_arithmetic_fails_says_so(own, monkeypatch, error):
    truth, camera = truth_of(own, 0)
    tracks = noisy(truth, np.random.default_rng(0))

    def fails(*_, **__):
        raise error

    for name in ("fit_collision", "find_contacts"):
        with monkeypatch.context() as spoilt:
            spoilt.setattr(estimate, name, fails)
            (row,), motion = measure_clip(tracks, camera)
            assert row["status"] == f"the fit failed: {error}"
            assert np.isnan(row["r"])
            assert motion.columns.tolist()[:2] == ["t_s", "particle"]
    assert set(row) == set(measure(tracks, camera)[0])


def test_covariances_that_are_none_do_not_lose_the_fit_of_all(accepted):
    table = accepted.copy()
    whole = fit_all_jointly(table)
    table = table.set_index(np.arange(8))
    spoilt = json.loads(table.at[2, "cov"])
    for fit in ("tied", "free"):
        spoilt[fit] = [[-abs(v) if i == j else v for j, v in enumerate(row)] for i, row in enumerate(spoilt[fit])]
    table.at[2, "cov"] = json.dumps(spoilt)
    spoilt = json.loads(table.at[5, "cov"])  # correlations beyond one, with variances as they were
    for fit in ("tied", "free"):
        spoilt[fit] = [[v if i == j else 10 * v for j, v in enumerate(row)] for i, row in enumerate(spoilt[fit])]
    table.at[5, "cov"] = json.dumps(spoilt)
    found = fit_all_jointly(table)
    assert found["chi2"]["r"] == pytest.approx(whole["chi2"]["r"], abs=4 * whole["chi2"]["r_std"])
    assert found["rolling"]["n"] == 6
    json.dumps(found, allow_nan=False)


def test_commands_say_how_many_are_misfits_and_why(own, hopping, tmp_path):
    tables = []
    for clip, data in enumerate((own, hopping, hopping)):
        tracks = noisy(truth_of(data, clip)[0], np.random.default_rng(clip))
        columns = {name: getattr(tracks, name) for name in ("frame", "particle", "x", "y")}
        tables.append(pd.DataFrame({"clip": clip} | columns | {"x_std": NOISE, "y_std": NOISE}))
    pd.concat(tables).to_csv(tmp_path / "tracks.csv", index=False)
    words = ["measure", str(tmp_path / "tracks.csv"), "--camera", str(own / "clips/000000/camera.json")]
    words += ["-o", str(tmp_path / "out"), "--no-pages"]
    done = CliRunner().invoke(app, [*words, "--json"])
    summary = json.loads(done.stdout)
    assert summary["status"] == {"misfit": 2, "ok": 1}
    assert summary["warnings"][0].partition(" (")[0] == "2 of 3 collisions do not fit the model"
    again = CliRunner().invoke(app, words)
    assert "complete before; 3 rows of estimates: 2 misfit, 1 ok" in again.stdout
    assert again.stderr == "".join(f"tracker: {warning}\n" for warning in summary["warnings"])


@pytest.mark.usefixtures("undrawn", "not_local")
def test_a_score_counts_misfits_and_holds_only_their_free_fit_to_the_truth(hopping, tmp_path):
    found = score(results(tmp_path / "results", hopping, 3), hopping)
    assert found.statuses == {"n": 4, "misfit": 3, "no result": 1}
    assert found.quantities["r"]["n"] == 0
    assert found.quantities["v0_free"]["n"] == 3
    assert found.quantities["v0_free"]["z_std"] < 3
    page = write_report(found, tmp_path / "results", hopping, tmp_path / "page").read_text(encoding="utf-8")
    assert "The tied fit describes the collision of no clip (3 misfits)" in page
