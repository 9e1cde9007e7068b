"""The search from Python: the same as by the command, and bad input in one line."""

import dataclasses
import json
import re
import sys

import numpy as np
import pandas as pd
import pytest
from discrepancy_clips import only
from discrepancy_files import SCENE, TRUTH, record
from matplotlib.figure import Figure
from repository import ROOT
from tracker_noisy import without_local

import discrepancy
import tracker
from discrepancy import cli
from discrepancy.data.reading import read_collisions
from synthcam.model import Model
from tracker.camera.views import find_first_difference

RIVAL = ("restitution_speed",)  # the free law that describes what is hidden; others would only take time


@pytest.fixture(scope="module")
def recorded():
    return record()


@pytest.fixture(scope="module")
def results(recorded):
    """The result of `tracker.measure` for the same tables, in another order."""
    table = pd.read_csv(recorded / "tracks.csv")
    with without_local():
        every = [tracker.measure(part, recorded / "camera.json") for _, part in table.groupby("clip")]
    return [every[k] for k in (3, 1, 0, 5, 4, 2)]


@pytest.fixture(scope="module")
def found(results):
    with pytest.MonkeyPatch.context() as patch:
        only(patch, RIVAL)
        return discrepancy.find(results, "painter_behringer")


def undated(path):
    """Its text, without the minute in which a page was made."""
    return re.sub(r"Made [-0-9]+ [0-9:]+ UTC", "", path.read_text())


def test_collisions_from_memory_are_those_of_the_folder_to_the_last_bit(recorded, results):
    one, lost = read_collisions(recorded / "results")
    other, also = read_collisions(results)
    assert lost == also
    assert len(one) == len(other) == 6
    for a, b in zip(one, other, strict=True):
        assert (a.clip, a.striker, a.offset) == (b.clip, b.striker, b.offset)
        assert find_first_difference(a.camera, b.camera) == ""
        for name in ("frame", "ball", "xy", "covariance", "launch", "slide_ends"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), name)


@pytest.mark.usefixtures("undrawn")
def test_the_command_writes_the_same_document(recorded, found, tmp_path, monkeypatch):
    only(monkeypatch, RIVAL)
    words = ["find", recorded / "results", "--model", ROOT / SCENE, "-o", tmp_path / "report"]
    monkeypatch.setattr(sys, "argv", ["discrepancy", *map(str, words)])
    cli.app(standalone_mode=False)
    written = (tmp_path / "report/discrepancy.json").read_text()
    assert json.loads(written) == found.document()
    assert found.document()["clips"] == {"fitted": 5, "kept_out": 1, "left_out": list(found.left_out)}
    paths = {"measured": str(recorded / "results"), "base_model": str(ROOT / SCENE)}  # which the page names
    dataclasses.replace(found, **paths).report(tmp_path / "mine")
    assert (
        f"Tracks: {paths['measured']}. Base model: {paths['base_model']}." in (tmp_path / "mine/index.html").read_text()
    )
    for name in ("discrepancy.json", "model.yaml", "index.html"):
        assert undated(tmp_path / "mine" / name) == undated(tmp_path / "report" / name), name


def test_what_was_hidden_is_named_and_the_model_keeps_it(found, tmp_path):
    assert found.verdict == "named"
    assert [n.effect for n in found.named] == ["velocity_restitution"]
    assert abs(found.model.effects[0].e - TRUTH) < 4 * found.named[0].std["velocity_restitution.e"]
    assert found.gap.after < found.gap.before
    found.model.write(tmp_path / "model.yaml")
    again = Model.read(tmp_path / "model.yaml")
    assert again.effects == found.model.effects
    assert again.restitution == found.model.restitution


def test_tables_and_repr(found):
    assert found.ranking["effect"][0] == "velocity_restitution"
    assert found.where.columns.tolist() == ["phase", "ball", "observable", "sigma", "against", "size"]
    assert repr(found) == f"named, from 6 collisions. {found.sentence()}"
    assert "velocity_restitution.e" in found._repr_html_()
    assert found._repr_html_().count("<tr") == 2


def test_the_plot_holds_the_gap(found):
    ax = Figure().subplots()
    assert found.plot_gap(ax) is ax
    assert ax.get_ylabel() == "rms residual in x and y (µm)"
    whole = {bars.get_label(): bars.patches[-1].get_height() for bars in ax.containers}
    assert whole == {
        "base model": found.gap.before_um,
        "with what was found": found.gap.after_um,
        "noise alone": found.gap.floor_um,
    }


def test_a_report_takes_no_folder_that_holds_something_else(found, tmp_path):
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(discrepancy.InputError, match="holds something else"):
        found.report(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["letter.txt"]


@pytest.mark.parametrize(
    ("model", "said"),
    [
        ({"modle": {}}, "model: modle: unknown key; did you mean model?; there are ball, model, effects, free"),
        ({"model": {"restitution": 2.0}}, "model: model.restitution: expected a number of 1 or less"),
        ({"free": ["luck"]}, "model: free: luck is no parameter"),
        ("no_such.yaml", "no_such.yaml: no such file"),
        (7, "model: of type int, expected a model, its settings, or a path"),
    ],
)
def test_what_is_no_model_is_one_line(results, model, said):
    with pytest.raises(discrepancy.InputError, match=re.escape(said)) as error:
        discrepancy.find(results, model)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("policy", "said"),
    [
        (discrepancy.SearchPolicy(min_collisions=7), "6 measured collisions: expected 7 or more"),
        (discrepancy.SearchPolicy(max_launch_speed_m_s=0.1), "check scale and fps of the camera"),
    ],
)
def test_a_policy_reaches_reading_and_search(results, policy, said):
    with pytest.raises(discrepancy.InputError, match=re.escape(said)):
        discrepancy.find(results, Model(), policy=policy)


def test_what_are_no_results_is_one_line(recorded, results):
    for wrong, said in (
        ([], "results: no clip with a measured collision"),
        ([results[0].tracks], "results: number 0 is of type DataFrame, expected what tracker.track"),
        (results[:2], "2 measured collisions: expected 6 or more"),
        (str(recorded / "nowhere"), "nowhere: no such file or folder"),
        (recorded / "tracks.csv", "expected argument camera"),
        (7, "results: of type int, expected"),
    ):
        with pytest.raises(discrepancy.InputError, match=said) as error:
            discrepancy.find(wrong, Model())
        assert "\n" not in str(error.value)


def test_a_dict_is_a_model_too(results, found, monkeypatch):
    """No search is made: what it is asked is enough. A result names only the models that came from files."""
    asked = []
    monkeypatch.setattr(
        "discrepancy.search.search", lambda clips, model, *rest: asked.append((len(clips), model)) or found
    )
    settings = {"model": {"restitution": 0.8}, "effects": {"plate_tilt": {"x": 1e-3}}}
    named = [discrepancy.find(results, model).base_model for model in (settings, str(ROOT / SCENE))]
    assert named == ["", str(ROOT / SCENE)]
    assert [count for count, _ in asked] == [6, 6]
    assert (asked[0][1].restitution, asked[0][1].effects[0].x, asked[1][1]) == (0.8, 1e-3, Model())


def test_results_of_one_number_are_counted(results):
    tracks, camera = results[0].tracks, results[0].camera
    again = [tracker.measure(tracks, camera) for _ in range(3)]
    assert {r.number for r in again} == {0}
    assert [c.clip for c in read_collisions(again)[0]] == [0, 1, 2]
