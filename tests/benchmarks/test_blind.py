"""The blind trials: truths stay sealed, a round can be checked by anybody; a few boxes of each kind."""

import dataclasses
import functools
import json
import lzma
from pathlib import Path
from types import SimpleNamespace

import pytest
from blind_boxes import TINY, line
from discrepancy_clips import only
from discrepancy_outsiders import FEW, RIVALS

from benchmarks.search import blind
from benchmarks.search.sealed import analysis, drawing, page, rounds
from benchmarks.search.sealed.boxes import Study
from benchmarks.search.sealed.ledger import Broken, Ledger
from benchmarks.search.sealed.studies import STUDIES
from discrepancy.data.notes import SearchNote, SearchNoteKind
from synthcam.library import library
from synthcam.model import Model, write_model

TRUTH = {"kind": "one", "hidden": {"stribeck.rise": 0.1}}
ANSWER = {"verdict": "none", "named": []}


def test_a_box_is_sealed_answered_and_opened_once(tmp_path):
    ledger = Ledger(tmp_path, "study")
    with pytest.raises(Broken, match="before it was sealed"):
        ledger.answer(3, ANSWER)
    ledger.seal(3, TRUTH)
    with pytest.raises(Broken, match="not the answer on record"):
        ledger.open(3, ANSWER, {})
    ledger.answer(3, ANSWER)
    with pytest.raises(Broken, match="not the answer on record"):
        ledger.open(3, ANSWER | {"verdict": "named"}, {})
    opened = ledger.open(3, ANSWER, {"code": "x"})
    assert {k: opened[k] for k in TRUTH} == TRUTH
    assert len(ledger.opened()) == 1
    with pytest.raises(Broken, match="opened before"):
        ledger.open(3, ANSWER, {})


def test_another_answer_is_refused(tmp_path):
    ledger = Ledger(tmp_path, "study")
    ledger.seal(3, TRUTH)
    assert ledger.recall_answer(3) is None
    ledger.answer(3, ANSWER)
    for other in (ANSWER, ANSWER | {"verdict": "named"}):
        with pytest.raises(Broken, match="answered before"):
            ledger.answer(3, other)
    assert ledger.recall_answer(3) == ANSWER
    (path,) = ledger.sealed.glob("*.answer.json")
    path.write_text(json.dumps(ANSWER | {"verdict": "named"}))
    with pytest.raises(Broken, match="not the answer on record"):
        ledger.recall_answer(3)


def test_a_box_answered_before_a_kill_is_opened_with_that_answer(tmp_path, monkeypatch):
    study, said = Study("killed", {"none": 1}, 1, **TINY), ANSWER | {"code": "before"}
    ledger = Ledger(tmp_path, study.name)
    ledger.commit("s")
    ledger.seal(0, drawing.draw(study, 0, "s"))
    ledger.answer(0, said)
    monkeypatch.setattr(blind, "answer_box", lambda *_: pytest.fail("analysed again"))
    assert "none" in blind.trial(study, 0, tmp_path, "s")
    (row,) = page.rows_in(tmp_path)
    assert (row.verdict, row.code, row.gap) == ("none", "before", {})


def test_a_fingerprint_of_all_that_answers(tmp_path, monkeypatch):
    """A change in any of the packages, or in what seals and judges, is another search."""
    monkeypatch.setattr(blind, "ROOT", tmp_path)
    seen = {blind.code()}
    for folder in ("src/discrepancy", "src/synthcam/effects", "src/tracker", "benchmarks/search/sealed"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "a.py").write_text("")
        seen.add(blind.code())
    assert len(seen) == 5


def test_a_changed_truth_is_refused(tmp_path):
    ledger = Ledger(tmp_path, "study")
    ledger.seal(0, TRUTH)
    ledger.answer(0, ANSWER)
    path = ledger.sealed / "00000.json"
    path.write_text(path.read_text().replace("0.1", "0.2"))
    with pytest.raises(Broken, match="not the one that was sealed"):
        ledger.open(0, ANSWER, {})
    assert ledger.opened() == []
    ledger.seal(0, TRUTH | {"hidden": {}})  # what is on record stays
    with pytest.raises(Broken, match="not the one that was sealed"):
        ledger.truth(0)


def test_a_killed_run_loses_no_box_and_opens_none_twice(tmp_path):
    ledger = Ledger(tmp_path, "study")
    for box in (0, 1):
        ledger.seal(box, TRUTH)
        ledger.answer(box, ANSWER)
    ledger.open(0, ANSWER, {})
    whole = ledger.results.read_bytes()
    ledger.results.write_bytes(whole + whole[:20])  # killed while it wrote
    assert [row["box"] for row in ledger.opened()] == [0]
    ledger.open(1, ANSWER, {})
    assert [row["box"] for row in ledger.opened()] == [0, 1]


def test_the_secret_is_on_record_before_the_boxes_that_it_draws(tmp_path):
    study = Study("none", {"none": 1}, 1, **TINY)
    one, same, other = (drawing.draw(study, 0, secret) for secret in ("s", "s", "t"))
    assert one == same
    assert one["seed"] != other["seed"]
    assert one["base"] != other["base"]
    ledger = Ledger(tmp_path, "none")
    ledger.commit("s")
    ledger.seal(0, one)
    ledger.commit("s")
    first, second = (json.loads(text) for text in ledger.record.read_text().splitlines())
    assert first == {
        "secret": "043a718774c572bd8a25adbeb1bfcd5c0256ae11cecf9f9c3f925d0e52beaf89"
    }  # sha256sum's, of "s"
    assert second["box"] == 0
    with pytest.raises(Broken, match="another secret"):
        ledger.commit("t")


@pytest.fixture
def finished(tmp_path):
    """A round of three boxes in two studies, one left shut; where it lies, and where it is to be published."""
    for study, boxes_of in (("every-x", (0, 1)), ("nulls-x", (0,))):
        ledger = Ledger(tmp_path / "out", study)
        ledger.commit("s")
        for box in boxes_of:
            row = line(["hop"], ["hop"], study=study, box=box)
            ledger.seal(box, row["truth"])
            ledger.answer(box, row["answer"])
            ledger.open(box, row["answer"], {"gap": {}})
        ledger.seal(7, row["truth"] | {"box": 7})
    (tmp_path / "rounds").mkdir()
    (tmp_path / "rounds" / "earlier.json").write_text("[]")
    return tmp_path / "out", tmp_path / "rounds"


def test_a_round_in_the_repository_tells_all(finished):
    out, place = finished
    rounds.publish(out, "x", "s", place)
    assert rounds.verify(place / "x") == []
    assert rounds.list_unopened(place / "x") == ["every-x 7", "nulls-x 7"]
    assert [r.study for r in rounds.judge_round(place / "x")] == ["every-x", "every-x", "nulls-x"]
    assert sorted(rounds.judge_round(place / "x"), key=str) == sorted(page.rows_in(out), key=str)
    with pytest.raises(Broken, match="published already"):
        rounds.publish(out, "x", "s", place)
    text = rounds.render_tables(rounds.judge_round(place / "x"), place)
    (row,) = [r for r in text.splitlines() if r.startswith("| right class from there on | 99 % | 3 of 3, 100.0 ")]
    assert row.endswith("; classes of 1.0 names, 1 at most | - |")
    assert "hop 3" in text
    page_of = f"before\n{rounds.BEGIN}\nold\n{rounds.END}\nafter"
    assert rounds.insert_tables(page_of, text) == f"before\n{rounds.BEGIN}\n\n{text}\n{rounds.END}\nafter"


def test_nothing_is_published_that_does_not_hold(finished):
    out, place = finished
    with pytest.raises(Broken, match="the secret's hash"):
        rounds.publish(out, "x", "t", place)
    with pytest.raises(Broken, match="no round y"):
        rounds.publish(out, "y", "s", place)
    assert rounds.list_published(place) == []


def edited(name, change):
    """A published round with one of its texts changed."""

    def edit(place):
        path = place / name
        packed = name.endswith("xz")
        text = lzma.decompress(path.read_bytes()).decode() if packed else path.read_text()
        path.write_bytes(lzma.compress(change(text).encode()) if packed else change(text).encode())

    return edit


@pytest.mark.parametrize(
    ("edit", "faults"),
    [
        (edited("about.json", lambda t: t.replace('"s"', '"t"')), ["every-x: the secret", "nulls-x: the secret"]),
        (edited("boxes.jsonl.xz", lambda t: t.replace("0.5", "0.6", 1)), ["every-x 0: the truth is not"]),
        (edited("boxes.jsonl.xz", lambda t: t.replace("1.3", "1.0", 1)), ["every-x 0: the answer is not"]),
        (edited("boxes.jsonl.xz", lambda t: t + t.splitlines()[0] + "\n"), ["every-x 0: opened 2 times"]),
        (
            edited("nulls-x.ledger.jsonl", lambda t: "\n".join(t.splitlines()[k] for k in (0, 2, 1, 3)) + "\n"),
            ["nulls-x 0: the ledger"],
        ),
        (
            edited("nulls-x.ledger.jsonl", lambda t: "\n".join(t.splitlines()[k] for k in (1, 0, 2, 3)) + "\n"),
            ["nulls-x: the secret"],
        ),
    ],
    ids=["secret", "truth", "answer", "twice", "answer before truth", "secret after a box"],
)
def test_a_published_round_that_was_touched_is_found_out(edit, faults, finished):
    out, place = finished
    rounds.publish(out, "x", "s", place)
    edit(place / "x")
    found = rounds.verify(place / "x")
    assert len(found) == len(faults)
    assert all(f.startswith(w) for f, w in zip(found, faults, strict=True))


def test_published_boxes_are_those_that_the_secret_draws(finished):
    out, place = finished
    ledger, study = Ledger(out, "filmed_nulls-x"), dataclasses.replace(STUDIES["filmed_nulls"], name="filmed_nulls-x")
    ledger.commit("s")
    for box in (0, 1):
        ledger.seal(box, drawing.draw(study, box, "s") | ({"seed": 1} if box else {}))
        ledger.answer(box, ANSWER)
        ledger.open(box, ANSWER, {})
    for path in out.glob("[en]*-x*.jsonl"):
        path.unlink()
    rounds.publish(out, "x", "s", place)
    assert rounds.redraw_boxes(place / "x") == ["filmed_nulls-x 1: the secret draws another box"]


def test_of_each_study_the_last_round_that_has_it_is_told(monkeypatch, tmp_path):
    """Round 10 comes after round 9; what it does not ask is told of the one before."""
    rows = {"9": ["nulls-9", "nulls-9", "pairs-9"], "10": ["nulls-10"]}
    for name in rows:
        (tmp_path / name).mkdir()
        (tmp_path / name / rounds.ABOUT).write_text("{}")
    monkeypatch.setattr(rounds, "judge_round", lambda place: [SimpleNamespace(study=one) for one in rows[place.name]])
    assert [row.study for row in rounds.latest(tmp_path)] == ["nulls-10", "pairs-9"]


def test_no_box_of_a_published_round_is_opened(tmp_path, monkeypatch):
    monkeypatch.setattr(blind, "ROUNDS", tmp_path)
    (tmp_path / "x").mkdir()
    with pytest.raises(Broken, match="x is published"):
        blind.run(SimpleNamespace(round="x"))


def test_a_secret_is_made_once_and_for_its_owner_alone(tmp_path):
    options = SimpleNamespace(secret=None, output=tmp_path)
    with pytest.raises(Broken, match="there is no secret"):
        blind.read_secret(options)
    made = blind.read_secret(options, make=True)
    assert len(made) == 64
    assert blind.read_secret(options, make=True) == blind.read_secret(options) == made
    assert (tmp_path / "secret.txt").stat().st_mode & 0o777 == 0o600


@pytest.mark.gate
def test_what_the_docs_tell_of_the_rounds_is_what_the_rounds_tell(monkeypatch):
    """And each round that lies in the repository holds, and is small."""
    for name in ("read_boxes", "judge_round"):  # several ask for the same boxes
        monkeypatch.setattr(rounds, name, functools.cache(getattr(rounds, name)))
    for place in rounds.list_published(blind.ROUNDS):
        assert rounds.verify(place) == []
        assert sum(p.stat().st_size for p in place.iterdir()) < max(1e6, 5e3 * len(rounds.judge_round(place)))
    text = rounds.render_tables(rounds.latest(blind.ROUNDS), blind.ROUNDS)
    assert rounds.insert_tables(blind.DOCS.read_text(), text) == blind.DOCS.read_text()


SMALL = {"clips": 6, "size": (320, 240), "filmed": True}


@pytest.mark.parametrize(
    "study",
    [
        Study("nothing", {"none": 1}, 1, **TINY | {"clips": 6, "frames": 40}, integrated=0),
        *(
            pytest.param(study, marks=pytest.mark.gate)
            for study in (
                Study("another integrator", {"one": 1}, 1, **TINY, integrated=1, effects=("spin_transfer_velocity",)),
                Study("outsider", {"outside": 1}, 1, **TINY, effects=("root_drag",)),
                Study("film", {"one": 1}, 1, **TINY | SMALL, effects=("velocity_restitution",)),
            )
        ),
    ],
    ids=lambda study: study.name,
)
def test_a_box_from_sealing_to_opening(study, tmp_path, monkeypatch):
    """All but the first know five effects and three free laws, and hide theirs at 20 times its limit.

    It tries the way, not the power.
    """
    if study.name != "nothing":  # it alone pays for the whole library, and for a process of its own
        only(monkeypatch, RIVALS["force_speed"], **{name: library()[name] for name in FEW})
        monkeypatch.setattr(blind, "analyse_in_process", analysis.analyse)
    blind.trial(study, 0, tmp_path, "s")
    (row,) = page.rows_in(tmp_path)
    assert row.false == ()
    assert row.right_class == (row.kind != "outside")
    assert row.declared == (row.kind == "outside")
    if row.kind == "one":
        assert row.closure > 0.9
        assert row.source == ("video" if study.filmed else "integrator")
    with pytest.raises(Broken, match="opened before"):
        blind.trial(study, 0, tmp_path, "s")


def test_an_answer_holds_the_notes_on_clips_as_text(tmp_path, monkeypatch):
    """The search gives typed notes; the ledger is JSON."""
    note = SearchNote(SearchNoteKind.SMOOTHED, 3)
    monkeypatch.setattr(analysis, "read_collisions", lambda *_: ([], [note]))
    monkeypatch.setattr(analysis, "search", lambda *_, **__: SimpleNamespace(data=SimpleNamespace(held_out=())))
    monkeypatch.setattr(analysis, "answer", lambda _: {"verdict": "none"})
    write_model(Model(), tmp_path / "model.yaml")
    answer = analysis.analyse(Path("tracks.csv"), None, tmp_path / "model.yaml", tmp_path)
    assert json.loads(json.dumps(answer))["left_out"] == [str(note)]
