"""The blind trials: truths stay sealed, the second integrator and the limits are right; a few boxes of each kind."""

import dataclasses
import json
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binom

import blind
from discrepancy_clips import only
from discrepancy_outsiders import FEW
from sealed import analysis, boxes, evidence, goals, judge, oracle, page
from sealed.boxes import NOISES, Study
from sealed.fisher import LIMIT, Fisher
from sealed.integrator import PHYSICS
from sealed.ledger import Broken, Ledger
from sealed.outsiders import OUTSIDERS
from synthcam.dataset import camera_json
from synthcam.effect import library
from synthcam.model import settings_of
from tracker.geometry import Camera

TRUTH = {"kind": "one", "hidden": {"stribeck.rise": 0.1}}
ANSWER = {"verdict": "none", "named": []}
SIZES = {name: {f"{name}.{p.name}": p.scale for p in library()[name].parameters()} for name in PHYSICS}


TINY = {"clips": 8, "frames": 60, "noises": {"white": 1}, "ratios": (20,)}


def truth_of(hidden, clips=2, **more):
    names = list(dict.fromkeys(k.partition(".")[0] for k in hidden))
    plain = {"study": "test", "box": 0, "kind": "one", "seed": 5, "noise": "white", "claimed": 1.0, "clips": clips}
    plain |= {
        "frames": 90,
        "exchanged": True,
        "defect": {},
        "size": [640, 480],
        "source": "synthcam",
        "effects": names,
        "hidden": hidden,
    }
    return plain | {"base": {k: getattr(boxes.Model(), k) for k in boxes.FREE}} | more


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
    assert ledger.answered(3) is None
    ledger.answer(3, ANSWER)
    for other in (ANSWER, ANSWER | {"verdict": "named"}):
        with pytest.raises(Broken, match="answered before"):
            ledger.answer(3, other)
    assert ledger.answered(3) == ANSWER
    (path,) = ledger.sealed.glob("*.answer.json")
    path.write_text(json.dumps(ANSWER | {"verdict": "named"}))
    with pytest.raises(Broken, match="not the answer on record"):
        ledger.answered(3)


def test_a_box_answered_before_a_kill_is_opened_with_that_answer(tmp_path, monkeypatch):
    study, said = Study("killed", {"none": 1}, 1, **TINY), ANSWER | {"code": "before"}
    ledger = Ledger(tmp_path, study.name)
    ledger.seal(0, boxes.draw(study, 0))
    ledger.answer(0, said)
    monkeypatch.setattr(blind, "answered", lambda *_: pytest.fail("analysed again"))
    assert "none" in blind.trial(study, 0, tmp_path)
    (row,) = page.rows_in(tmp_path)
    assert (row.verdict, row.code, row.gap) == ("none", "before", {})


def test_a_fingerprint_of_all_that_answers(tmp_path, monkeypatch):
    """A change in any of the packages, or in what seals and judges, is another search."""
    monkeypatch.setattr(blind, "ROOT", tmp_path)
    seen = {blind.code()}
    for folder in ("src/discrepancy", "src/synthcam/effects", "src/tracker", "benchmarks/sealed"):
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


@pytest.mark.parametrize("name", ["nothing", *PHYSICS])
def test_two_integrators_agree_to_a_tenth_of_a_nanometre(name):
    """A fifty thousandth of the noise: whatever a box finds, it is not the other integrator."""
    hidden = SIZES.get(name, {})
    hidden = hidden | ({"friction_anisotropy.s": -0.05} if name == "friction_anisotropy" else {})
    truth = truth_of(hidden)
    for clip in boxes.clips_of(truth):
        camera = Camera.from_dict(camera_json(clip))
        one, seen = evidence._by_synthcam(clip, camera)
        other, also = evidence.integrated(truth, clip, camera)
        np.testing.assert_array_equal(seen, also)
        np.testing.assert_allclose(one[seen] * boxes.SCALE, other[seen] * boxes.SCALE, rtol=0, atol=1e-10)


@pytest.fixture(scope="module")
def tilted():
    """A design, a tilt, and the rows in view."""
    truth = truth_of({}, clips=4)
    rows = boxes.fitted(truth)
    return truth, rows


@pytest.mark.parametrize("kind", NOISES)
def test_at_its_limit_an_effect_scores_five(kind, tilted):
    """Tracks are made one way, noise and all, and the limit worked out another."""
    truth, rows = tilted
    fisher = Fisher(boxes.base_model(truth), rows, NOISES[kind])

    def hidden(strength):
        tilt = library()["plate_tilt"](x=strength, y=-strength)
        return dataclasses.replace(fisher.model, effects=(tilt,))

    limit = fisher.limit(hidden, 1e-3, 0.05)
    unit = fisher.signature(hidden(limit)) / LIMIT
    moved = fisher._tracks(hidden(limit))
    rng, z, squares = np.random.default_rng(3), [], []
    for _ in range(40):
        tracks = []
        for k, row in enumerate(rows):
            noise = evidence.noise_of(kind, truth["frames"], rng).reshape(-1, 2)
            whole = row.ball * truth["frames"] + row.frame
            tracks.append(moved[k] - fisher.plain[k] + noise[whole])
            squares.append(fisher._white(k, noise[whole]) ** 2)
        z.append(unit @ fisher._cleaned(tracks))
    assert np.mean(z) == pytest.approx(LIMIT, abs=3.5 / np.sqrt(40))
    assert np.std(z) == pytest.approx(1, abs=3.5 / np.sqrt(80))
    squares = np.concatenate(squares)
    assert squares.mean() == pytest.approx(1, abs=3.5 * np.sqrt(2 / len(squares)))


def test_limits_are_those_of_other_trials():
    """Found earlier by a program of its own for the same experiment: 30 clips, white noise of 5 um."""
    truth = truth_of({}, clips=40, exchanged=False)
    fisher = Fisher(boxes.base_model(truth), boxes.fitted(truth), NOISES["white"])
    assert len(fisher.rows) == 30
    known = {"hop.share": 3.5e-3, "mass_mismatch.excess": 2.3e-4, "plate_tilt.x": 8e-6, "scale_error.e": 4.9e-4}
    known |= {"pixel_locking.amplitude": 2.3e-3, "stribeck.rise": 7.6e-3}  # at .1 m/s
    for key, limit in known.items():
        name, _, strength = key.partition(".")

        def hidden(size, name=name, strength=strength):
            effect = dataclasses.replace(library()[name].absent(), **{strength: size})
            return dataclasses.replace(fisher.model, effects=(effect,))

        assert fisher.limit(hidden, limit / 10, 1.0) == pytest.approx(limit, rel=0.15), key


def test_a_draw_is_the_same_again_and_within_its_bounds():
    study = Study("test", {"one": 1}, 3, clips=6, frames=60)
    for box in range(study.boxes):
        truth = boxes.draw(study, box)
        assert json.dumps(truth) == json.dumps(boxes.draw(study, box))
        (about,) = truth["about"]
        assert 1 <= about["ratio"] <= 20
        assert 0 <= about["nearest"] <= 1 + 1e-9
        assert boxes.model_of(truth).effects


def test_no_box_hides_a_lamp_that_its_camera_file_tells_of():
    for filmed in (False, True):
        drawn = boxes._candidates(Study("any", {"one": 1}, 1, filmed=filmed), "one", False)
        assert set(library()) - set(drawn) >= {"unknown_lamp"}
        assert "plate_tilt" in drawn


def test_outsiders_are_in_no_library():
    assert len(OUTSIDERS) >= 8
    assert not set(OUTSIDERS) & set(library())
    assert not any(hasattr(e, "_moved") and e.VIDEO for e in OUTSIDERS.values())


SMALL = {"clips": 6, "size": (320, 240), "filmed": True}


@pytest.mark.parametrize(
    "study",
    [
        Study("nothing", {"none": 1}, 1, **TINY, integrated=0),
        Study("another integrator", {"one": 1}, 1, **TINY, integrated=1, effects=("spin_transfer_velocity",)),
        Study("outsider", {"outside": 1}, 1, **TINY, effects=("root_drag",)),
        Study("film", {"one": 1}, 1, **TINY | SMALL, effects=("velocity_restitution",)),
    ],
    ids=lambda study: study.name,
)
def test_a_box_from_sealing_to_opening(study, tmp_path, monkeypatch):
    """All but the first know five effects, and hide theirs at 20 times its limit: it tries the way, not the power."""
    if study.name != "nothing":  # it alone pays for the whole library, and for a process of its own
        only(monkeypatch, **{name: library()[name] for name in FEW})
        monkeypatch.setattr(blind, "analysed", analysis.analysed)
    blind.trial(study, 0, tmp_path)
    (row,) = page.rows_in(tmp_path)
    assert row.false == ()
    assert row.kin == (row.kind != "outside")
    assert row.declared == (row.kind == "outside")
    if row.kind == "one":
        assert row.closure > 0.9
        assert row.source == ("video" if study.filmed else "integrator")
    with pytest.raises(Broken, match="opened before"):
        blind.trial(study, 0, tmp_path)


def at_least(wanted):
    return partial(goals.at_least, "", "tracks", wanted)


def at_most(wanted):
    return partial(goals.at_most, "", "tracks", wanted)


def counted(most, of):
    return partial(goals.counted, "", "tracks", most, of)


def line(effects, named, aliases=(), verdict="named", **more):
    truth = truth_of({f"{e}.share": 1.0 for e in effects}) | {"kind": "two" if len(effects) > 1 else "one"} | more
    truth |= {"about": [{"ratio": 6.0, "nearest": 0.5} for _ in effects]}
    entries = [{"effect": n, "parameters": {f"{n}.share": 1.3}, "std": {f"{n}.share": 0.1}} for n in named]
    return {"truth": truth, "answer": {"verdict": verdict, "named": entries, "aliases": list(aliases)}}


def test_judging():
    right = judge.judge(line(["hop"], ["hop"]))
    assert right.name
    assert right.kin
    assert right.false == ()
    assert right.z == pytest.approx([3.0])
    by_class = judge.judge(line(["hop"], ["mass_mismatch"], [["mass_mismatch", "hop"]], "ambiguous"))
    assert (by_class.name, by_class.kin, by_class.false, by_class.z) == (False, True, (), ())
    wrong = judge.judge(line(["hop"], ["stribeck"]))
    assert (wrong.name, wrong.kin, wrong.false) == (False, False, ("stribeck",))
    one_of_two = judge.judge(line(["hop", "stribeck"], ["hop"]))
    assert (one_of_two.name, one_of_two.kin, one_of_two.false) == (False, False, ())
    twice = judge.judge(line(["hop", "stribeck"], ["hop", "twin"], [["twin", "hop"]]))
    assert not twice.kin  # one effect cannot answer for two claims
    outside = judge.judge(line(["hop"], [], verdict="outside_library"))
    assert (outside.name, outside.false) == (False, (judge.OUTSIDE,))
    locked = judge.judge(line([], ["pixel_locking"], kind="defect", defect={"pixel_locking": 0.01}))
    assert locked.false == ()


@pytest.mark.parametrize("name", ["rolling_resonance", "friction_streaks", "speed_delay"])
def test_a_curve_in_its_band(name):
    kind = OUTSIDERS[name]
    x = np.linspace(0.1, 0.5, 30) if name != "friction_streaks" else np.random.default_rng(0).uniform(0, 0.03, (90, 2))
    effect = kind(**{p.name: p.scale for p in kind.parameters()})
    law = effect._curve(*(x.T if x.ndim == 2 else (x,)))
    law = law + {"rolling_resonance": 0.01 + 0.1 * x, "friction_streaks": 0.2, "speed_delay": 3e-4}[name]
    half = 0.05 * np.ptp(law)

    def judged(curve):
        row = line([name], [], verdict="outside_library", kind="outside")
        row["truth"]["hidden"] = {f"{name}.{k}": v for k, v in vars(effect).items()}
        row["truth"]["base"] |= {"rolling_decel": 0.01, "rolling_drag": 0.1, "sliding_friction": 0.2}
        said = curve - curve.mean() if name == "speed_delay" else curve
        band = np.stack([said - half, said + half], axis=-1)
        row["answer"]["outside"] = [{"slot": kind.SLOT, "x": x.tolist(), "curve": said.tolist(), "band": band.tolist()}]
        return judge.judge(row)

    assert judged(law + half / 2).slot
    assert judged(law + half / 2).curve
    assert not judged(law[::-1]).curve
    assert not judged(law + 3 * half * np.sign(law - np.median(law))).curve


@pytest.mark.parametrize(("longer", "allowed"), [(3.4e-3, True), (-4e-4, True), (-5e-4, False), (3.6e-3, False)])
def test_no_box_has_a_shutter_that_opens_for_no_time_or_too_long(tilted, longer, allowed, monkeypatch):
    truth, rows = tilted
    assert rows[0].camera.exposure == 5e-4
    design = Fisher(boxes.base_model(truth), rows, NOISES["white"])
    for name, said in (("limit", 1.0), ("signature", np.ones(9)), ("likeness", {"other": 0.5})):
        monkeypatch.setattr(design, name, lambda *_, said=said: said)
    entry = boxes._entry(design, library()["exposure_blur"], {}, {"longer": longer}, 1.0, naming=False)
    assert (entry is not None) == allowed


def test_bounds_of_shares_in_closed_form():
    assert goals.bounds([True] * 20) == pytest.approx((0.05 ** (1 / 20), 1), rel=1e-12)
    assert goals.bounds([False] * 20) == pytest.approx((0, 1 - 0.05 ** (1 / 20)), rel=1e-12)
    low, high = goals.bounds([True] * 3 + [False] * 7)
    assert binom.sf(2, 10, low) == pytest.approx(0.05)
    assert binom.cdf(3, 10, high) == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("goal", "hits", "misses", "met"),
    [
        (at_least(0.8), 13, 0, "not shown"),  # .05^(1/13) = .794
        (at_least(0.8), 14, 0, "yes"),
        (at_least(0.8), 5, 4, "not shown"),
        (at_least(0.8), 4, 5, "no"),
        (at_least(1.0), 500, 0, "not shown"),
        (at_least(1.0), 499, 1, "no"),
        (at_most(0.02), 0, 148, "not shown"),  # 1 - .05^(1/148) = .02004
        (at_most(0.02), 0, 149, "yes"),
        (at_most(0.02), 4, 50, "no"),
        (counted(2, 300), 0, 299, "not shown"),
        (counted(2, 300), 2, 298, "yes"),
        (counted(2, 300), 3, 97, "no"),
        (counted(2, 300), 4, 596, "yes"),
        (counted(2, 300), 5, 595, "no"),
        (at_least(0.8), 0, 0, "not shown"),
    ],
)
def test_met_only_when_the_bound_allows_it(goal, hits, misses, met):
    assert goal([True] * hits + [False] * misses).met == met


def test_the_page(tmp_path):
    ledger = Ledger(tmp_path, "study")
    for box in range(12):
        row = line(["hop"], ["hop"] if box else ["stribeck"])
        row["answer"] |= {"cpu": 3.0, "seconds": 3.0}
        ledger.seal(box, row["truth"])
        ledger.answer(box, row["answer"])
        gap = {"base": 900.0, "augmented": 101.0, "oracle": 100.0, "points": 100.0}
        ledger.open(box, row["answer"], {"gap": gap})
    table = {g.text: g for g in goals.goals(page.rows_in(tmp_path))}
    assert table["right class from there on"].reached.startswith("91.7 ")
    assert table["right class from there on"].met == "not shown"
    gap = [g for text, g in table.items() if text.startswith("gap closed")]
    assert [g.reached for g in (*gap, table["the median box"])] == [f"{799 / 800:.4f}"] * 2
    assert [g.n for g in gap] == [12]  # the one that was called wrongly too
    html = page.write(tmp_path).read_text()
    assert html.count("data:image/png") >= 4
    assert "stribeck" in html


def test_a_model_without_a_motion_closes_nothing(tilted, tmp_path):
    """Of the clips kept out, that is; a truth that leaves the noise alone closes all."""
    truth, rows = tilted
    truth = truth | {"hidden": {"rolling_quadratic.K": 0.1}, "effects": ["rolling_quadratic"]}
    places = Fisher.places(boxes.model_of(truth), rows)
    kept = []
    for k, (r, xy) in enumerate(zip(rows, places, strict=True)):
        claimed = np.tile(25e-12 * np.eye(2), (len(xy), 1, 1))
        kept.append(SimpleNamespace(clip=k, frame=r.frame, ball=r.ball, xy=xy, covariance=claimed, launch=r.launch))
    analysis.keep(kept, tmp_path / "kept_out.npz")
    base = boxes.base_model(truth)
    said = {"base": settings_of(base), "model": settings_of(base.replace({"plate_tilt.x": 5e-3}))}
    found = oracle.gap(truth, said, tmp_path)
    assert found["augmented"] == found["base"] > 1
    assert found["oracle"] < 1e-6
    assert oracle.gap(truth, said | {"base": said["model"]}, tmp_path) == {}
