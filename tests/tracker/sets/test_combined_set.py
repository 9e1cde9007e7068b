"""Results taken together: which values enter, what is refused, and means that a hand calculation gives."""

import json

import numpy as np
import pandas as pd
import pytest
from tracker_film import CAMERA
from tracker_local import draw_rows, draw_unequal_rows
from typer.testing import CliRunner

import tracker
from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.cli import app
from tracker.measurement.estimate import make_empty_row


def row(clip, r, std=0.01, **more):
    """A row of estimates with r, v0 and b alone."""
    known = {"clip": clip, "v0": 0.1 + 0.05 * clip, "b": 0.0, "particle1": 0, "particle2": 1, "r": r, "r_std": std}
    empty = make_empty_row(Camera.from_dict(CAMERA), "ok")
    return {name: value for name, value in empty.items() if name != "recommended"} | known | more


def write(folder, rows, tracks="", digest="a"):
    """RESULTS of such rows; tracks: what distinguishes the recordings of this folder from others."""
    for one in rows:
        (folder / f"clips/{one['clip']:06d}").mkdir(parents=True)
        (folder / f"clips/{one['clip']:06d}/tracks.csv").write_text(f"{tracks or folder.name} {one['clip']}")
    pd.DataFrame(rows).to_parquet(folder / "estimates.parquet")
    (folder / "run.json").write_text(json.dumps({"input": digest + folder.name}))
    return folder


def test_the_mean_of_equal_errors_is_that_of_the_values(tmp_path):
    values = [0.90, 0.94, 0.92, 0.96, 0.88]
    found = tracker.combine(write(tmp_path / "a", [row(k, r) for k, r in enumerate(values)]))
    r = found.quantities["r"]
    assert r.mean.coefficients[0] == pytest.approx(np.mean(values))
    assert r.mean.std[0] == pytest.approx(np.std(values, ddof=1) / np.sqrt(5))
    assert r.mean.scatter == pytest.approx(np.sqrt(np.var(values, ddof=1) - 0.01**2))
    assert r.slope.coefficients[1] == pytest.approx(np.polyfit(0.1 + 0.05 * np.arange(5), values, 1)[0])
    assert r.values["mean_without"].iloc[3] == pytest.approx(np.mean([0.90, 0.94, 0.92, 0.88]))
    assert (found.used, found.left_out) == (5, {})
    assert found.means.loc["r", "n"] == 5


def test_a_crowd_whose_contacts_show_no_friction_names_the_command_that_may_find_it(tmp_path):
    """Bodies on air have no friction to be found."""

    def combine(name, **more):
        known = {"status": "crowd", "recommended": "local", "r_local": 0.9, "r_local_std": 0.01} | more
        rows = [row(k, 0.9, **known) for k in (0, 1)]
        return tracker.combine(write(tmp_path / name, rows), quantities=["r", "mu_k"]).notes

    assert any("tracker gas" in note for note in combine("balls"))
    assert not any("tracker gas" in note for note in combine("pucks", motion_local="glide"))
    assert not any("tracker gas" in note for note in combine("known", mu_k_local=0.2, mu_k_local_std=0.01))
    with pytest.raises(InputError, match=r"no value of r, mu_k.*tracker gas"):
        combine("none", r_local=np.nan)


def test_the_recommended_fit_enters(tmp_path):
    """A row without a recommendation, as of another version, enters by its status."""
    local = {"r_local": 0.8, "r_local_std": 0.01, "v0_local": 0.5, "b_local": 0.6}
    rows = [
        row(0, 0.9, recommended="tied", **local),
        row(1, 0.9, np.nan, recommended="local", status="misfit", **local),
        row(2, 0.9, recommended="free", r_free=0.7, r_free_std=0.01),
        row(3, 0.9, recommended="none", **local),
        row(4, 0.9, status="misfit"),
        row(5, np.nan, recommended="tied"),
    ]
    found = tracker.combine([write(tmp_path / "a", rows)], quantities=["r"])
    values = found.quantities["r"].values
    assert values["value"].tolist() == [0.9, 0.8, 0.7]
    assert values["fit"].tolist() == ["tied", "local", "free"]
    assert values["v_n"].iloc[1] == pytest.approx(0.4)
    assert found.left_out == {"misfit": 1, "ok": 2}
    alone = [{k: v for k, v in one.items() if k not in ("r", "r_std")} for one in rows[:2]]
    values = tracker.combine(write(tmp_path / "c", alone), quantities=["r"]).quantities["r"].values
    assert values["value"].tolist() == [0.8]  # of results that have the local estimate alone
    plain = [{k: v for k, v in one.items() if "local" not in k and k != "recommended"} for one in rows]
    values = tracker.combine(write(tmp_path / "b", plain), quantities=["r"]).quantities["r"].values
    assert values["clip"].tolist() == [0, 2, 3]


def test_a_recording_given_twice_counts_once(tmp_path):
    a, b = write(tmp_path / "a", [row(0, 0.9), row(1, 0.92)]), tmp_path / "b"
    write(b, [row(0, 0.91, 0.02), row(7, 0.9)], tracks="other")
    (b / "clips/000007/tracks.csv").write_text("a 1")
    found = tracker.combine([a, b, a])
    assert found.quantities["r"].values[["result", "clip"]].values.tolist() == [["a", 0], ["a", 1], ["b", 0]]
    assert found.notes[0] == "recordings given twice count once: b, clip 7 is a, clip 1"
    assert "a, clip 0 is a, clip 0, and 1 more" in found.notes[1]


def test_one_collision_that_decides_and_results_that_differ_are_told(tmp_path):
    rows = [row(k, r, 0.001) for k, r in enumerate((0.900, 0.901, 0.899, 0.9005))]
    found = tracker.combine(write(tmp_path / "a", [*rows, row(4, 0.95, 0.001)]), quantities=["r"])
    (note,) = found.notes  # a fifth of a mean of five is not more than its error
    assert "clip 4, collision 0 is 44.6 standard errors from the others, with the scatter; without it the" in note
    precise = [row(0, 0.95, 0.001), *(row(k, 0.9, 0.05) for k in (1, 2, 3))]
    (note,) = tracker.combine(write(tmp_path / "c", precise), quantities=["r"]).notes
    assert note.startswith("r: c, clip 0, collision 0 decides the mean: 0.9 without it, 0.9499")
    other = write(tmp_path / "b", [row(k, r, 0.001) for k, r in enumerate((0.940, 0.941, 0.939))])
    both = tracker.combine([write(tmp_path / "d", rows), other], quantities=["r"])
    assert any(note.startswith("r differs between the results") for note in both.notes)
    assert both.quantities["r"].by_result["b"].coefficients[0] == pytest.approx(0.94)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([row(0, 0.9, 0.0)], "a: clip 0, collision 0: r has the standard error 0, expected one above 0"),
        ([row(0, 0.9, -0.1)], "standard error -0.1"),
        ([row(0, np.nan), row(1, np.inf)], "no value of"),
        ([row(0, 0.9, status="misfit")], "(1 misfit)"),
    ],
)
def test_nonsense_is_refused(rows, message, tmp_path):
    with pytest.raises(InputError) as refused:
        tracker.combine([write(tmp_path / "a", rows)])
    assert message in str(refused.value)


def test_a_table_that_is_none_is_refused(tmp_path):
    folder = write(tmp_path / "a", [row(0, 0.9)])
    (folder / "estimates.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(InputError, match=r"estimates\.parquet: damaged"):
        tracker.combine([folder])
    pd.DataFrame({"clip": [0]}).to_parquet(folder / "estimates.parquet")
    with pytest.raises(InputError, match="no column collision, status"):
        tracker.combine([folder])
    with pytest.raises(InputError, match="expected at least one"):
        tracker.combine([])


def test_the_command_writes_a_set_and_replaces_it(tmp_path):
    a = write(tmp_path / "a", [row(k, r) for k, r in enumerate((0.90, 0.94, 0.92, 0.96))])
    b = write(tmp_path / "b", [row(0, 0.93)])
    words = ["combine", str(a), str(b), "-o", str(tmp_path / "set")]
    said = CliRunner().invoke(app, words)
    assert said.exit_code == 0, said.output
    assert "5 of 5 collisions of 2 results enter." in said.output
    assert "0.930(10), scatter 0.02 (0.0089 to 0.063), slope" in said.output
    again = CliRunner().invoke(app, [*words, "--json"])
    found = json.loads(again.stdout)
    stored = json.loads((tmp_path / "set/set.json").read_text())
    assert {key: found[key] for key in stored} == stored
    assert sorted(p.name for p in (tmp_path / "set").iterdir()) == ["index.html", "set.json"]
    assert stored["results"] == {"a": 4, "b": 1}
    page = (tmp_path / "set/index.html").read_text()
    assert "forest plot" in page
    assert "<h1>Means and scatter of 5 collisions: set</h1>" in page


def write_local(folder, hits, seed, **more):
    """RESULTS of local estimates of head-on hits with r = 0.8, whose velocities have errors of 1 %."""
    return write_rows(folder, draw_rows(hits, 0.01, 0.01, 0.0, seed, **more))


def write_rows(folder, drawn):
    rows = [row(k, np.nan) | own for k, own in enumerate(drawn)]
    rows = [one | {"recommended": "local", "b_local": 0.1} for one in rows]
    (folder / "clips").mkdir(parents=True)
    (folder / "camera.json").write_text(json.dumps(CAMERA))
    return write(folder, rows)


def test_results_with_few_hits_are_calibrated_together(tmp_path):
    parts = [write_local(tmp_path / name, 5, seed) for seed, name in enumerate("ab")]
    combined = tracker.combine(parts, quantities=["r"])
    assert set(combined.table["local_hits"]) == {10}
    assert combined.notes[0].startswith("local estimates of 2 results are calibrated together, by the balance of")
    assert combined.quantities["r"].mean.coefficients[0] == pytest.approx(0.8, abs=0.05)
    (parts[1] / "camera.json").write_text(json.dumps(CAMERA | {"fps": 50.0}))
    assert set(tracker.combine(parts, quantities=["r"]).table["local_hits"]) == {0}


def test_a_common_calibration_says_what_else_it_changes(tmp_path):
    """Half of the hits have no recommendation before. The bodies are unequal, as far as their numbers name bodies."""
    parts = [write_rows(tmp_path / name, draw_unequal_rows(0.4, 7, seed=seed)) for seed, name in enumerate("ab")]
    table = pd.read_parquet(parts[1] / "estimates.parquet")
    table.assign(recommended="none").to_parquet(parts[1] / "estimates.parquet")
    note = tracker.combine(parts, quantities=["r"]).notes[0]
    assert "for 7 of them another estimate is recommended than in estimates.parquet" in note
    assert "A mass ratio is fitted too. This takes a number for the same body in all clips" in note


def test_a_mass_ratio_is_that_of_one_body_over_the_other_whichever_strikes(tmp_path):
    """Body 7 has exp(0.4) of the mass of body 9. Rows give struck over striking, and one value for the set."""
    folder = write_rows(tmp_path / "a", draw_unequal_rows(0.4, 12))
    found = tracker.combine(folder, quantities=["mass_ratio"])
    values = found.quantities["mass_ratio"].values
    assert len(values) == 12
    assert values["value"].to_numpy() == pytest.approx(np.exp(0.4), rel=0.02)
    single = pd.read_parquet(folder / "estimates.parquet")["mass_ratio_std"].min() * np.exp(0.4) ** 2
    assert values["std"].max() < 1.2 * single
    mean = found.quantities["mass_ratio"].mean
    assert mean.std[0] == pytest.approx(values["std"].iloc[0], rel=0.05)  # the error is shared
    assert any(note.startswith("mass_ratio is that of the particle with the lower number") for note in found.notes)


def test_a_note_says_that_the_error_of_a_warp_averages_out(tmp_path):
    folder = write_local(tmp_path / "a", 5, 0)
    knots = {"x": [0, 1, 2, 3], "y": [0, 1, 2, 3], "dx": [[0] * 4] * 4, "dy": [[0] * 4] * 4}
    std = {"std": 1e-4, "length": 0.1}
    maps = std | {"errors": [{"dx": [[1e-4] * 4] * 4, "dy": [[0] * 4] * 4}]}
    for warp, said in ((knots, False), (knots | std, True), (knots | maps, False)):
        (folder / "camera.json").write_text(json.dumps(CAMERA | {"warp": warp}))
        notes = tracker.combine(folder, quantities=["r"]).notes
        assert any(note.startswith("the error of `warp`") for note in notes) == said


def test_errors_of_the_scale_do_not_average_out_in_local_speeds(tmp_path):
    found = write_local(tmp_path / "a", 9, 3, shared=[("scale", "v0", 0.03)])
    mean = tracker.combine(found, quantities=["v0", "r"]).means
    assert mean.loc["v0", "shared_std"] == pytest.approx(0.03 * mean.loc["v0", "mean"], rel=0.05)
    without = tracker.combine(write_local(tmp_path / "b", 9, 3), quantities=["r"]).means
    assert mean.loc["r", "shared_std"] == pytest.approx(without.loc["r", "shared_std"], rel=0.01)


def test_a_bias_of_a_set_stays_in_its_mean(tmp_path):
    shared = {"bias_v1o": {"of": 0.02, "effect": {"r": 0.02}}, "bias_v2i": {"of": 0.02, "effect": {"r": -0.01}}}
    local = {"recommended": "local", "r_local_std": 0.03, "v0_local": 0.5, "b_local": 0.1}
    rows = [row(k, np.nan, **local, r_local=0.8 + 0.001 * k, local_shared=json.dumps(shared)) for k in range(9)]
    mean = tracker.combine(write(tmp_path / "a", rows), quantities=["r"]).means.loc["r"]
    assert mean["shared_std"] == pytest.approx(np.hypot(0.02, 0.01), rel=1e-3)
    assert mean["std"] == pytest.approx(np.sqrt(0.02**2 + 0.01**2 + (0.03**2 - 0.02**2 - 0.01**2) / 9), rel=1e-3)
