"""Judgement of the blind trials: names, classes, outsiders, goals with their bounds, the gap."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from blind_boxes import line, truth_of
from scipy.stats import binom

from benchmarks.search.sealed import analysis, boxes, goals, judge, oracle, page
from benchmarks.search.sealed.fisher import Fisher
from benchmarks.search.sealed.ledger import Ledger
from benchmarks.search.sealed.ordinary import ORDINARY
from benchmarks.search.sealed.outsiders import OUTSIDERS
from synthcam.effect import ActiveLaws
from synthcam.library import library
from synthcam.model import list_model_settings


def at_least(wanted):
    return partial(goals.at_least, "", "tracks", wanted)


def at_most(wanted):
    return partial(goals.at_most, "", "tracks", wanted)


def at_most_count(most, of):
    return partial(goals.at_most_count, "", "tracks", most, of)


def test_judging():
    right = judge.judge(line(["hop"], ["hop"]))
    assert right.name
    assert right.right_class
    assert right.false == ()
    assert right.z == pytest.approx([3.0])
    by_class = judge.judge(line(["hop"], ["mass_mismatch"], [["mass_mismatch", "hop"]], "ambiguous"))
    assert (by_class.name, by_class.right_class, by_class.false, by_class.z) == (False, True, (), ())
    wrong = judge.judge(line(["hop"], ["stribeck"]))
    assert (wrong.name, wrong.right_class, wrong.false) == (False, False, ("stribeck",))
    one_of_two = judge.judge(line(["hop", "stribeck"], ["hop"]))
    assert (one_of_two.name, one_of_two.right_class, one_of_two.false) == (False, False, ())
    twice = judge.judge(line(["hop", "stribeck"], ["hop", "twin"], [["twin", "hop"]]))
    assert not twice.right_class  # one effect cannot answer for two claims
    outside = judge.judge(line(["hop"], [], verdict="outside_library"))
    assert (outside.name, outside.false) == (False, (judge.OUTSIDE,))
    locked = judge.judge(line([], ["pixel_locking"], kind="defect", defect={"pixel_locking": 0.01}))
    assert locked.false == ()


def reached(lines, text):
    """Hits and trials of the goal whose text begins so."""
    (goal,) = [g for g in goals.goals([judge.judge(one) for one in lines]) if g.text.startswith(text)]
    return int(goal.reached.split()[0]) if goal.n else 0, goal.n


@pytest.mark.parametrize(
    ("kind", "text"), [("outside", "outside the library, from"), ("ordinary", "an ordinary fault w")]
)
def test_an_outsider_is_declared_without_a_false_name_beside_it(kind, text):
    name = {"outside": "root_drag", "ordinary": "ball_curves"}[kind]
    lines = [
        line([name], [], verdict="outside_library", kind=kind),
        line([name], [], verdict="inadequate", kind=kind),
        line([name], ["air_drag"], verdict="outside_library", kind=kind),
        line([name], ["air_drag"], verdict="inadequate", kind=kind),
        line([name], [], verdict="none", kind=kind),
    ]
    assert reached(lines, text) == (2, 5)
    assert [judge.judge(one).declared for one in lines] == [True, True, True, True, False]
    assert [judge.judge(one).has_false_name for one in lines] == [False, False, True, True, False]
    (goal,) = [g for g in goals.goals([judge.judge(one) for one in lines]) if g.text.startswith(text)]
    assert goal.beside == "declared 4, 2 of them inadequate; with a false name 2"


def test_a_law_in_the_model_is_held_to_what_the_true_law_leaves():
    lines = []
    for held, augmented in [(True, 1049.0), (True, 1120.0), (False, 3000.0)]:
        one = line(["root_drag"], [], verdict="outside_library", kind="outside")
        one["truth"]["hidden"] = {}
        one["answer"]["outside"] = [
            {"slot": "force_speed", "in_model": held, "x": [0.0], "curve": [0.0], "band": [[0, 0]]}
        ]
        lines.append(one | {"gap": {"base": 5000.0, "augmented": augmented, "oracle": 1000.0, "points": 1000.0}})
    assert reached(lines, "the law in the model") == (1, 2)


def test_inadequate_is_false_of_nothing_and_a_miss_of_what_the_library_has():
    nothing = judge.judge(line([], [], verdict="inadequate", kind="none"))
    assert nothing.false == (judge.INADEQUATE,)
    missed = judge.judge(line(["hop"], [], verdict="inadequate"))
    assert (missed.false, missed.detected, missed.right_class, missed.right) == ((), False, False, False)
    assert not judge.judge(line(["hop"], ["hop"], verdict="inadequate")).right_class
    assert judge.judge(line([], [], verdict="inadequate", kind="defect", defect={"scale": 1e-3})).false == ()


def test_a_withdrawn_claim_is_no_claim():
    """Whatever was claimed on the way: of nothing it is not false, of what is hidden it is a miss."""
    for effects, kind in (([], "none"), (["hop"], "one")):
        row = line(effects, [], verdict="none", kind=kind)
        row["answer"]["withdrawn"] = [{"claim": "hop", "without": 1.0, "with": 1.1}]
        judged = judge.judge(row)
        assert (judged.called, judged.false, judged.withdrawn) == ((), (), ("hop",))
        assert judged.right == (kind == "none")


def test_a_class_of_everything_is_no_answer():
    everything = sorted(library())
    wide = judge.judge(line(["hop"], ["stribeck"], [everything], "ambiguous"))
    assert not wide.right_class
    assert wide.false == ("stribeck",)
    few = ["stribeck", "hop", "adhesion"]
    assert judge.judge(line(["hop"], ["stribeck"], [few], "ambiguous")).right_class
    assert goals.sizes([judge.judge(line(["hop"], ["stribeck"], [few], "ambiguous"))] * 2) == (
        "classes of 3.0 names, 3 at most"
    )


def test_at_the_limit_is_on_both_sides_of_it():
    lines = [line(["hop"], ["hop"]) for _ in range(4)]
    for one, ratio in zip(lines, (0.84, 0.86, 1.19, 1.21), strict=True):
        one["truth"]["about"][0]["ratio"] = ratio
    assert reached(lines, "detected at 1 x its limit (.85 to 1.2 of that)") == (2, 2)


def test_one_wave_counted_from_its_other_side_is_the_same_wave():
    """By the law itself: the push of both is one function of the place."""
    hidden = {"a": 2e-6, "b": -3e-6, "wavelength": 0.02, "angle": 0.4}
    found = hidden | {"angle": 0.4 - np.pi, "b": 3e-6}
    place = np.random.default_rng(0).uniform(-0.03, 0.03, (50, 2))
    instant = {"position": place, "velocity": 2 * place, "gravity": 9.81}
    waves = [ActiveLaws([library()["plate_waviness"](**values)]) for values in (hidden, found)]
    one, other = (wave("push", np.zeros((50, 2)), instant) for wave in waves)
    assert np.abs(one).max() > 1e-3
    np.testing.assert_allclose(one, other, atol=1e-12)
    row = line(["plate_waviness"], ["plate_waviness"])
    row["truth"]["hidden"] = {f"plate_waviness.{k}": v for k, v in hidden.items()}
    row["answer"]["named"][0] |= {"parameters": found, "std": dict.fromkeys(found, 1e-7)}
    assert judge.judge(row).z == pytest.approx([0, 0], abs=1e-6)
    row["answer"]["named"][0]["parameters"] = hidden | {"angle": 0.4 + 2 * np.pi}
    assert judge.judge(row).z == pytest.approx([0, 0], abs=1e-6)
    row["answer"]["named"][0]["parameters"] = found | {"b": -3e-6}
    assert judge.judge(row).z == pytest.approx([0, -60], abs=1e-6)


def test_an_outsider_that_the_library_takes_in_is_an_effect_like_any_other(monkeypatch):
    row = line(["ball_curves"], ["air_drag"], kind="ordinary")
    assert judge.judge(row).false == ("air_drag",)
    monkeypatch.setattr(ORDINARY["ball_curves"], "SAME", ("no_such_effect", "air_drag"))
    taken = judge.judge(row)
    assert (taken.kind, taken.hidden, taken.false, taken.right_class) == ("one", ("air_drag",), (), True)


@pytest.mark.parametrize("name", ["rolling_resonance", "friction_streaks", "speed_delay"])
def test_a_curve_in_its_band(name):
    kind = OUTSIDERS[name]
    x = np.linspace(0.1, 0.5, 30) if name != "friction_streaks" else np.random.default_rng(0).uniform(0, 0.03, (90, 2))
    effect = kind(**{p.name: p.typical for p in kind.parameters()})
    law = effect._curve(*(x.T if x.ndim == 2 else (x,)))
    law = law + {"rolling_resonance": 0.01 + 0.1 * x, "friction_streaks": 0.2, "speed_delay": 3e-4}[name]
    half = 0.05 * np.ptp(law)

    def judged(curve):
        row = line([name], [], verdict="outside_library", kind="outside")
        row["truth"]["hidden"] = {f"{name}.{k}": v for k, v in vars(effect).items()}
        row["truth"]["base"] |= {"rolling_decel": 0.01, "rolling_drag": 0.1, "sliding_friction": 0.2}
        said = curve - curve.mean() if name == "speed_delay" else curve
        band = np.stack([said - half, said + half], axis=-1)
        row["answer"]["outside"] = [
            {"slot": kind.FREE_LAW, "x": x.tolist(), "curve": said.tolist(), "band": band.tolist()}
        ]
        return judge.judge(row)

    assert judged(law + half / 2).free_law
    assert judged(law + half / 2).curve
    assert not judged(law[::-1]).curve
    assert not judged(law + 3 * half * np.sign(law - np.median(law))).curve


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
        (at_most_count(2, 300), 0, 299, "not shown"),
        (at_most_count(2, 300), 2, 298, "yes"),
        (at_most_count(2, 300), 3, 97, "no"),
        (at_most_count(2, 300), 4, 596, "yes"),
        (at_most_count(2, 300), 5, 595, "no"),
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
    assert table["right class from there on"].reached.startswith("11 of 12, 91.7 ")
    assert table["right class from there on"].beside == "classes of 1.0 names, 1 at most"
    assert table["right class from there on"].met == "not shown"
    gap = [g for text, g in table.items() if text.startswith("gap closed")]
    assert [g.reached for g in (*gap, table["the median box"])] == [f"{799 / 800:.4f}"] * 2
    assert [g.n for g in gap] == [12]  # the one that was called wrongly too
    html = page.write(tmp_path).read_text()
    assert html.count("data:image/svg+xml") >= 4
    assert "stribeck" in html


@pytest.mark.parametrize("spin", [(), (0.1, 0.02, 0.01)])
def test_a_model_without_a_motion_closes_nothing(spin, tmp_path):
    """The gap is that of the held-out clips; a truth that leaves only noise closes all of it.

    Also where strikers are taken to spin.
    """
    truth = truth_of({}, clips=4)
    rows = boxes.fitted(truth)
    truth = truth | {"hidden": {"rolling_quadratic.K": 0.1}, "effects": ["rolling_quadratic"]}
    places = Fisher.places(boxes.model_of(truth), rows)
    kept = []
    for k, (r, xy) in enumerate(zip(rows, places, strict=True)):
        claimed = np.tile(25e-12 * np.eye(2), (len(xy), 1, 1))
        kept.append(
            SimpleNamespace(
                clip=k, frame=r.frame, ball=r.ball, xy=xy, covariance=claimed, launch=np.append(r.launch, spin)
            )
        )
    analysis.keep(kept, tmp_path / "kept_out.npz")
    base = boxes.base_model(truth)
    said = {"base": list_model_settings(base), "model": list_model_settings(base.replace({"plate_tilt.x": 5e-3}))}
    found = oracle.gap(truth, said, tmp_path)
    assert found["augmented"] == found["base"] > 1
    assert found["oracle"] < 1e-6
    assert oracle.gap(truth, said | {"base": said["model"]}, tmp_path) == {}
