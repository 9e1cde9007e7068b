"""Verdicts with one deciding constant changed: what is changed, that it is changed back, and what the table counts."""

from argparse import Namespace

import pytest

from benchmarks.search import sensitivity
from benchmarks.search.sealed.ledger import lines
from discrepancy.policy import SearchPolicy, current_policy

TRUTH = {"study": "nulls-7", "box": 3, "kind": "none", "effects": [], "defect": {}, "source": "synthcam"}
TRUTH |= {"noise": "white", "hidden": {}}


@pytest.fixture
def searches(monkeypatch):
    """The floor of a claim that each search saw; a search names a hop under 5."""
    seen = []

    def analysed(measured, camera, model, folder):
        seen.append(current_policy().min_claim_sigma)
        named = [{"effect": "hop", "parameters": {}}] if seen[-1] < 3 else []
        return {"verdict": "named" if named else "none", "named": named}

    monkeypatch.setattr(sensitivity, "prepare", lambda truth, folder: (folder, None))
    monkeypatch.setattr(sensitivity, "analyse", analysed)
    return seen


def search(place, todo, until=float("inf")):
    return sensitivity.search_box({"truth": TRUTH}, todo, place, until, sensitivity.code())


def test_numbers_are_multiplied_cosines_come_nearer_to_one_and_counts_stay_counts():
    assert sensitivity.changed("min_claim_sigma", 2.0) == 2 * SearchPolicy().min_claim_sigma
    assert sensitivity.changed("alias_cosine", 0.5) == pytest.approx((1 + SearchPolicy().alias_cosine) / 2)
    assert sensitivity.changed("alias_cosine", 2.0) < SearchPolicy().alias_cosine < 1
    assert sensitivity.changed("max_effects", 0.1) == 1
    assert all(type(sensitivity.changed(n, 0.5)) is type(getattr(SearchPolicy(), n)) for n in sensitivity.FIELDS)
    assert sensitivity.changes(["max_effects"], [1.1, 2.0]) == [("", 1.0), ("max_effects", 2.0)]


def test_each_search_sees_its_change_and_the_value_is_put_back(searches, tmp_path):
    floor, name = SearchPolicy().min_claim_sigma, "min_claim_sigma"
    search(tmp_path / "searches.jsonl", [("", 1.0), (name, 0.5), (name, 2.0)])
    assert searches == [floor, floor / 2, 2 * floor]
    assert floor == SearchPolicy().min_claim_sigma
    found = list(lines(tmp_path / "searches.jsonl"))
    assert [(r["factor"], r["verdict"], r["right"]) for r in found] == [
        (1.0, "none", True), (0.5, "named", False), (2.0, "none", True)]  # fmt: skip
    rows = sensitivity.table(found).splitlines()
    assert rows[0].startswith("1 boxes searched as things are, 1 of them answered rightly")
    assert [r.split(" | ")[2:8] for r in rows[4:]] == [["0.5", "2", "1", "1", "1", "0"], ["2", "8", "1", "0", "0", "0"]]
    assert "nulls-7 3: none -> named hop" in rows[4]


def test_a_study_goes_on_where_it_stopped(searches, tmp_path, monkeypatch, capsys):
    place, name = tmp_path / "searches.jsonl", "min_claim_sigma"
    assert search(place, [("", 1.0)], until=0.0) == "nulls-7 3: 0 of 1 searches"
    search(place, [("", 1.0), (name, 0.5)])
    asked = []
    monkeypatch.setattr(sensitivity, "ProcessPoolExecutor", lambda *_: Here(asked))
    monkeypatch.setattr(sensitivity, "as_completed", list)
    monkeypatch.setattr(sensitivity, "opened", lambda options: [{"truth": TRUTH}])
    options = Namespace(constants=[name], factors="0.5,2", minutes=1, jobs=1)
    sensitivity.run(options, place)
    assert asked == [[(name, 2.0)]]
    monkeypatch.setattr(sensitivity, "code", lambda: "another")
    sensitivity.run(options, place)
    assert asked[1:] == [[("", 1.0), (name, 0.5), (name, 2.0)]]


class Here:
    """A pool that only writes down what it is asked."""

    def __init__(self, asked):
        self.asked = asked

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def submit(self, function, line, todo, *rest):
        self.asked.append(todo)
        return self

    def result(self):
        return "done"


def test_boxes_are_chosen_by_study_and_number():
    chosen = {"round": "7", "boxes": None, "filmed": False}
    one = sensitivity.opened(Namespace(studies="limit:6,pairs", **chosen))
    assert {(o["truth"]["study"], o["truth"]["box"]) for o in one} == {
        ("limit-7", 6),
        *(("pairs-7", k) for k in range(8)),
    }
    few = sensitivity.opened(Namespace(studies="", **chosen | {"boxes": 1}))
    assert {o["truth"]["box"] for o in few} == {0}
    assert all(o["truth"]["source"] != "video" for o in few)
    assert len(sensitivity.opened(Namespace(studies="", **chosen | {"filmed": True}))) == 106
