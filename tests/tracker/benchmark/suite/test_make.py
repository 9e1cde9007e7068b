"""Films apart from the truth; the same suite for the same seed; a truth withheld and known by its digest."""

import json
import shutil

import numpy as np
import pytest
from benchmark_suite import TINY, suite, tiny

from synthcam_shared.errors import InputError
from tracker.benchmark.suite import make as module
from tracker.benchmark.suite.definition import (
    DIGEST_WITHOUT_CROWDS,
    check_truth,
    open_suite,
    parse_definition,
    truth_digest,
)
from tracker.benchmark.suite.make import make_suite


def test_no_film_holds_the_truth_and_the_card_says_what_it_is():
    made = suite()
    names = {path.name for path in (made.path / "films").rglob("*") if path.is_file()}
    assert names == {"README.md", "SHA256SUMS", "frames.tif", "camera.json"}
    assert not list((made.path / "films").rglob("truth"))
    about = json.loads((made.path / "suite.json").read_text())
    assert about["truth_sha256"] == truth_digest(made.truth, made.definition)
    card = (made.path / "README.md").read_text()
    for word in (about["truth_sha256"], "| seed | 5 |", "license: cc0-1.0", "tracker benchmark submit"):
        assert word in card


def test_bounds_are_those_of_all_balls_in_view_and_a_dim_one_has_a_wider_one():
    made = suite()
    limits = made.bounds["axes"]
    spread = np.sqrt((limits["xx"] + limits["yy"]) / 2).groupby(limits["clip"]).median()
    assert len(limits) == 4 * 36 * 2
    assert limits["xx"].notna().all()
    assert spread[2] > 5 * spread[0]  # clips 2, 3 are dim: a peak of 12 in place of 200
    assert (made.quantity_bounds("axes")["r_bound"] > 0).all()


def test_a_second_call_keeps_what_is_there(monkeypatch):
    made = suite()
    monkeypatch.setattr(module, "_synthcam", lambda *words: pytest.fail("made again"))
    assert make_suite(made.path, tiny(), workers=1).about == made.about
    with pytest.raises(InputError, match="holds another suite"):
        make_suite(made.path, tiny("small"), workers=1)


def test_a_withheld_truth_lies_apart_with_a_seed_that_is_drawn(tmp_path, monkeypatch):
    made = suite()
    asked = []

    def copied(*words):
        asked.append(words)
        out, truth = (words[words.index(option) + 1] for option in ("-o", "--withhold-truth"))
        shutil.copytree(made.film("axes"), out)
        shutil.copytree(made.truth / "axes", truth)

    monkeypatch.setattr(module, "_synthcam", copied)
    withheld = make_suite(tmp_path / "suite", tiny(), tmp_path / "truth", workers=1)
    assert withheld.about["split"] == "withheld"
    assert withheld.about["seed"] is None
    drawn = json.loads((tmp_path / "truth" / "seed.json").read_text())["seed"]
    assert str(drawn) == asked[0][asked[0].index("--seed") + 1]
    assert drawn != 5
    text = "".join(path.read_text() for path in (tmp_path / "suite").glob("*.*"))
    assert str(drawn) not in text
    alone = open_suite(tmp_path / "suite")
    with pytest.raises(InputError, match="the truth of this suite is withheld: give its folder"):
        check_truth(alone)
    assert check_truth(open_suite(tmp_path / "suite", tmp_path / "truth")).bounds["axes"] is not None
    tracks = next((tmp_path / "truth").rglob("tracks.parquet"))
    tracks.write_bytes(tracks.read_bytes()[:-1] + b"x")
    with pytest.raises(InputError, match="its SHA-256 differs"):
        check_truth(open_suite(tmp_path / "suite", tmp_path / "truth"))


def test_the_truth_of_two_balls_keeps_its_digest_beside_crowds(tmp_path):
    more = TINY.replace("axes:\n    clips", "crowd: {clips: 1, scenes: {many: {}}}\n  axes:\n    clips")
    crowded = parse_definition(more + "crowds: {axes: {}, parts: {many: many}}\n", "full", "tiny.yaml")
    for film, text in (("axes", "two balls"), ("crowd", "many balls")):
        (tmp_path / film).mkdir()
        (tmp_path / film / "truth.txt").write_text(text)
    before = truth_digest(tmp_path, tiny())
    assert truth_digest(tmp_path, crowded) != before
    assert module._digest_without_crowds(tmp_path, crowded) == {DIGEST_WITHOUT_CROWDS: before}
    assert module._digest_without_crowds(tmp_path, tiny()) == {}


def test_a_truth_within_the_films_is_refused(tmp_path):
    for truth in (tmp_path / "suite" / "truth", tmp_path):
        with pytest.raises(InputError, match="expected a separate folder for the truth"):
            make_suite(tmp_path / "suite", tiny(), truth)


def test_what_synthcam_refuses_is_said(tmp_path):
    wrong = parse_definition(TINY.replace("v0: 0.25", "v1: 0.25"), "full", "tiny.yaml")
    with pytest.raises(InputError, match=r"synthcam generate ended with status 2: .*launch\.v1"):
        make_suite(tmp_path / "suite", wrong, workers=1)
