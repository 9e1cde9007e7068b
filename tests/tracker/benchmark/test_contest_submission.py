"""Tables of another program, scored as those that run here; a truth that does not leave its folder."""

import json
import shutil
import sys
from dataclasses import replace

import pandas as pd
import pytest
from benchmark_suite import TINY, Given, noisy, simulated, suite

from synthcam_shared.errors import InputError
from tracker.benchmark.contest import read_submission_form, score_submission
from tracker.benchmark.report.leaderboard import write_entry
from tracker.benchmark.suite.definition import parse_definition
from tracker.cli import main


@pytest.fixture(autouse=True)
def drawn(monkeypatch):
    """No pictures, which test_contest.py looks at, and the clips at the bound, always the same, measured once."""
    monkeypatch.setattr("tracker.benchmark.contest.write_report", lambda *words: None)
    monkeypatch.setattr(
        "tracker.benchmark.judging.entry.simulate_at_bound", lambda made, part, clip: simulated(part.name, clip)
    )


def tables(folder, clips=range(4), change=noisy, **form):
    """A submission as another program would write it: clip, frame, particle, x, y and errors."""
    made = suite()
    folder.mkdir()
    (folder / "submission.json").write_text(json.dumps({"name": "theirs", **form}))
    columns = ["frame", "particle", "x", "y", "x_std", "y_std", "cov_xy"]
    rows = [Given(made, change).of("axes", clip)[0][columns].assign(clip=clip) for clip in clips]
    if rows:
        pd.concat(rows).to_csv(folder / "axes.csv", index=False)
    return folder


@pytest.mark.gate
def test_tables_at_the_bound_score_as_a_tracker_at_the_bound(tmp_path):
    entries, notes = score_submission(
        suite(), tables(tmp_path / "s", authors="A. N. Other", ms_per_frame=3), tmp_path / "r", ""
    )
    assert notes == []
    (one,) = entries
    assert one["tracker"] == {"name": "theirs", "authors": "A. N. Other", "ms_per_frame": 3, "made": "submitted"}
    assert one["score"] > 85
    assert one["quantities"]["bright"]["measured"] == 2
    assert abs(one["quantities"]["bright"]["r"]["bias"]) < 0.01


@pytest.mark.usefixtures("not_local")
def test_a_file_a_clip_in_another_programs_format_gives_the_same(tmp_path):
    whole = tables(tmp_path / "s", clips=(0, 3))
    parted = tmp_path / "t"
    (parted / "axes").mkdir(parents=True)
    (parted / "submission.json").write_text('{"name": "theirs"}')
    for clip, rows in pd.read_csv(whole / "axes.csv").groupby("clip"):
        rows.drop(columns="clip").to_csv(parted / "axes" / f"{clip:06d}.csv", index=False)
    one, other = (score_submission(suite(), s, tmp_path / f"r{k}", "")[0][0] for k, s in enumerate((whole, parted)))
    assert one == other


@pytest.mark.usefixtures("unfitted", "not_local")
def test_clips_without_a_table_are_not_found(tmp_path):
    (one,), notes = score_submission(suite(), tables(tmp_path / "s", clips=(0, 1)), tmp_path / "r", "")
    assert notes == ["axes: no table of 2 of 4 clips, which count as not found"]
    assert one["parts"]["bright"]["found"] == 1.0
    assert one["parts"]["dim"]["found"] == 0.0
    assert one["parts"]["dim"]["efficiency"] == 0.0


@pytest.mark.usefixtures("unfitted", "not_local")
def test_glints_are_taken_to_centres_where_the_form_says_so(tmp_path):
    def glints(table, rng):
        moved = noisy(table, rng)
        return moved.assign(
            x=moved["x"] + table["glint_x_px"] - table["x_px"], y=moved["y"] + table["glint_y_px"] - table["y_px"]
        )

    wrong, right = (
        score_submission(suite(), tables(tmp_path / f"s{k}", change=glints, **form), tmp_path / f"r{k}", "")[0][0]
        for k, form in enumerate(({}, {"point": "glint"}))
    )
    assert wrong["parts"]["bright"]["ratio"] > 20
    assert wrong["defects"]["size"]["glint"] == pytest.approx(1, abs=0.01)
    assert right["parts"]["bright"]["ratio"] < 1.3


@pytest.mark.usefixtures("unfitted", "not_local")
def test_a_withheld_truth_is_scored_where_it_lies(tmp_path, monkeypatch, capsys):
    made = suite()
    films, truth = tmp_path / "suite", tmp_path / "kept"
    shutil.copytree(made.path, films, ignore=shutil.ignore_patterns("truth"))
    shutil.copytree(made.truth, truth)
    (films / "suite.json").write_text(json.dumps({**made.about, "split": "withheld", "seed": None}))
    typed = ["tracker", "benchmark", "submit", str(films), str(tables(tmp_path / "s")), "-o", str(tmp_path / "r")]
    monkeypatch.setattr(sys, "argv", typed)
    with pytest.raises(SystemExit) as stopped:
        main()
    err = capsys.readouterr().err
    assert (stopped.value.code, err.count("\n")) == (2, 1)
    assert "the truth of this suite is withheld" in err
    before = {path: path.read_bytes() for path in truth.rglob("*") if path.is_file()}
    monkeypatch.setattr(sys, "argv", [*typed, "--truth", str(truth), "--json"])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 0
    (line,) = json.loads(capsys.readouterr().out)["leaderboard"]
    assert line["truth"] == "withheld from the tracker's authors"
    assert {path: path.read_bytes() for path in truth.rglob("*") if path.is_file()} == before
    assert not [path for path in (tmp_path / "r").rglob("*") if path.suffix == ".parquet"]
    true = pd.read_parquet(truth / "axes" / "clips" / "000000" / "truth" / "tracks.parquet")["x_mean_px"]
    told = "".join(path.read_text() for path in (tmp_path / "r").rglob("*.*") if path.is_file())
    assert not [value for value in true if f"{value:.6f}" in told]


@pytest.mark.usefixtures("unfitted", "not_local")
def test_a_submission_without_the_films_of_crowds_has_no_figures_of_them(tmp_path):
    """A suite whose film `more` counts as crowds; a table of it is then scored apart from the other films."""
    copy = tmp_path / "suite"
    shutil.copytree(suite().path, copy)
    for part in ("films", "truth"):
        shutil.copytree(copy / part / "axes", copy / part / "more")
    more = TINY.replace("axes:\n  brightness", "  more: {clips: 1, scenes: {many: {}}}\naxes:\n  brightness")
    definition = parse_definition(more + "crowds: {axes: {}, parts: {many: many}}\n", "full", "tiny.yaml")
    crowded = replace(suite(), path=copy, truth=copy / "truth", definition=definition)
    folder = tables(tmp_path / "s", clips=(0,))
    (alone,), notes = score_submission(crowded, folder, tmp_path / "r", "")
    assert notes[1] == "more: no table, so the entry has no figures of these crowds"
    assert alone["crowds"] == {}
    shutil.copy(folder / "axes.csv", folder / "more.csv")
    (whole,), notes = score_submission(crowded, folder, tmp_path / "r", "")
    assert len(notes) == 1
    assert whole["crowds"]["many"]["hota"] == pytest.approx(1.0, abs=0.02)
    assert whole["score"] == alone["score"]
    assert list(whole["parts"]) == list(alone["parts"]) == ["bright", "dim"]


@pytest.mark.parametrize(
    ("form", "said"),
    [
        ({"nam": "x"}, "name: expected the tracker's name"),
        ({"name": "x" * 300}, "name: expected one line of at most 60 characters"),
        ({"name": "x\ny"}, "name: expected one line"),
        ({"name": "x", "pont": "glint"}, "pont: unknown, expected one of .*did you mean point"),
        ({"name": "x", "point": "edge"}, "point: expected centre or glint, not 'edge'"),
        ({"name": "x", "ms_per_frame": -1}, "ms_per_frame: expected a number over 0, not -1"),
    ],
)
def test_a_wrong_form_is_one_line(tmp_path, form, said):
    (tmp_path / "submission.json").write_text(json.dumps(form))
    with pytest.raises(InputError, match=said):
        read_submission_form(tmp_path)


def test_a_clip_that_the_suite_does_not_have(tmp_path):
    folder = tables(tmp_path / "s", clips=(0,))
    rows = pd.read_csv(folder / "axes.csv").assign(clip=9)
    rows.to_csv(folder / "axes.csv", index=False)
    with pytest.raises(InputError, match="axes: clip 9: not in the suite, expected 0 to 3"):
        score_submission(suite(), folder, tmp_path / "r", "")


def without_clip(folder):
    pd.read_csv(folder / "axes.csv").drop(columns="clip").to_csv(folder / "axes.csv", index=False)


def without_positions(folder):
    pd.read_csv(folder / "axes.csv").assign(x=float("nan"), y=float("nan")).to_csv(folder / "axes.csv", index=False)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda folder: (folder / "axes.csv").unlink(), "s: no table, expected FILM.csv or FILM.parquet, or a folder"),
        (lambda folder: (folder / "axes.csv").rename(folder / "axis.csv"), "axis.csv: not named after a film, expected "
         "axes; did you mean axes"),
        (lambda folder: (folder / "axis").mkdir(), "axis: not named after a film"),
        (without_clip, "axes.csv: no column clip, expected clip, frame, particle, x, y; found frame, particle"),
        (without_positions, "s/axes.csv: x, y: blank in all 288 rows, expected positions"),
    ],
)  # fmt: skip
def test_a_submission_without_what_it_must_have_is_one_line(tmp_path, change, said):
    folder = tables(tmp_path / "s")
    change(folder)
    with pytest.raises(InputError, match=said) as stopped:
        score_submission(suite(), folder, tmp_path / "r", "")
    assert "\n" not in str(stopped.value)
    assert not (tmp_path / "r").exists()


@pytest.mark.usefixtures("unfitted", "not_local")
def test_a_submission_may_be_replaced_by_its_like_alone(tmp_path):
    def submit(folder, name):
        return score_submission(suite(), tables(tmp_path / folder, clips=(0,), name=name), tmp_path / "r", "")

    submit("s", "mine")
    assert len(submit("t", "mine")[0]) == 1
    with pytest.raises(InputError, match=r"mine.json: is of 'mine', submitted; expected another name than 'mine'"):
        write_entry(tmp_path / "r", {"tracker": {"name": "mine", "made": "run here"}})
    submit("u", "a b")
    with pytest.raises(InputError, match=r"a_b.json: is of 'a b', submitted; expected another name than 'a_b'"):
        submit("v", "a_b")
