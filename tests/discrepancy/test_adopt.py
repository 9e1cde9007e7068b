"""A free law made an effect: the file bends the law as the formula or the curve says, and a search finds no more."""

import ast
import dataclasses
import json
import re
import shutil

import numpy as np
import pytest
from discrepancy_clips import collisions
from discrepancy_files import command
from discrepancy_outsiders import OUTSIDERS, each_outsider, outsider
from report_pages import undrawn

from discrepancy.adopt import ParameterValue, adopt, render_formula_effect, render_table_effect
from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.free_laws.formula import iterate_shapes
from discrepancy.free_laws.library import list_free_laws as free_laws
from discrepancy.free_laws.ranges import Axis
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.report import search_page
from synthcam.effect import LAWS, VECTOR_INPUTS
from synthcam.library import add_effects, library
from synthcam.model import BASE_PARAMETERS, Model, read_model
from synthcam.scene.scene import read_scene
from synthcam.tabulated_law import TABLE_KINDS, TabulatedLaw, table_names
from synthcam_shared.errors import InputError

CURVES = [n for n, k in TABLE_KINDS.items() if k.axis != "place" and k.parts == 1]
RANGE = (0.05, 0.45)


@pytest.fixture(scope="module")
def report_on(tmp_path_factory):
    """Give the folder of the report of a search that found a free law."""
    folder = tmp_path_factory.mktemp("reports")

    def write(law):
        if not (folder / law).exists():
            with undrawn():
                search_page.write(outsider(law), folder / law)
        return folder / law

    return write


def read(folder, name, text):
    (folder / f"{name}.py").write_text(text)
    add_effects(folder)
    return library()[name]


def instant(kind, rng):
    shapes = {w: (5, 7, 2) if w in {*VECTOR_INPUTS, "heading"} else (5, 7) for w in LAWS[kind.law]}
    known = {w: rng.uniform(*RANGE, shape) / (np.sqrt(2) if len(shape) == 3 else 1) for w, shape in shapes.items()}
    return known | {"of_a": np.array([1.0, 1.0, 0.0, 0.0, 0.0])[:, None]}


def argument(kind, known):
    what = known[kind.what]
    if kind.axis == "turn":
        return np.arctan2(what[..., 1], what[..., 0])
    return np.hypot(what[..., 0], what[..., 1]) if kind.what in VECTOR_INPUTS else what


@pytest.mark.parametrize("law", CURVES)
@pytest.mark.parametrize("ball", ["", "a", "b"])
def test_every_shape_as_an_effect_is_what_was_drawn(law, ball, own):
    """The columns that formulas are fitted with, and the code that an effect has, are written apart."""
    kind, rng = TABLE_KINDS[law], np.random.default_rng(4)
    if ball and not kind.one_ball:
        return
    known = instant(kind, rng)
    x = argument(kind, known)
    order = np.argsort(x.ravel())
    search = next(k for k in free_laws() if k.base_name == law)
    circle = kind.axis == "turn"
    axis = Axis("x", kind.x_unit, *((-np.pi, np.pi) if circle else RANGE), 9, "circle" if circle else "line", "x")
    tried = 0
    for k, shape in enumerate(iterate_shapes(dataclasses.replace(search, axes=(axis,)), [x.ravel()[order]])):
        numbers = [float(t[len(t) // 2]) for t in shape.tries]
        terms = shape.terms(*numbers)
        if shape.name == "step":
            terms = [t._replace(column=np.where(abs(t.column - 0.5) < 0.6, t.column, 0)) for t in terms]
        values = [ParameterValue(t.name, float(rng.uniform(0.05, 0.1)), t.power) for t in terms]
        shaped = [ParameterValue(n, v, p) for (n, p), v in zip(shape.numbers, numbers, strict=True)]
        name = f"made_{k}"
        folder = own / name
        folder.mkdir()
        whose = f"{law}_{ball}" if ball else law
        made = read(folder, name, render_formula_effect(name, whose, list(zip(terms, values, strict=True)), shaped, []))
        effect = made(**{v.name: v.value for v in [*values, *shaped]})
        added = np.empty(x.size)
        added[order] = sum(v.value * t.column for t, v in zip(terms, values, strict=True))
        added = added.reshape(x.shape) * {"": 1.0, "a": known["of_a"], "b": 1 - known["of_a"]}[ball]
        old = rng.uniform(0.1, 0.2, (*x.shape, 2) if kind.law == "push" else x.shape)
        ((bent, bend, asks),) = effect.bends
        found = bend(old, *[known[a] for a in asks])
        if kind.law == "push":
            expected = old + (added / x)[..., None] * known["velocity"]
        else:
            expected = old * (1 + added) if len(kind.owners) == 1 else old + added
        assert bent == kind.law
        far = np.abs(x - numbers[0]) > 0.03 if shape.name == "step" else np.full(x.shape, True)
        np.testing.assert_allclose(found[far], expected[far], rtol=1e-6)
        tried += 1
    assert tried > 5


@pytest.mark.parametrize("law", list(table_names()))
def test_every_table_as_an_effect_is_the_table(law, own):
    own_kind = TABLE_KINDS.get(law) or TABLE_KINDS[law[:-2]]
    rng = np.random.default_rng(5)
    x = {"line": np.linspace(*RANGE, 9), "turn": np.linspace(-np.pi, np.pi, 9)[:-1]}.get(own_kind.axis)
    if x is None:
        side = np.linspace(0, 0.5, 4)
        x = np.stack([s.ravel() for s in np.meshgrid(side, side)], axis=1)
    y = rng.uniform(0.1, 0.3, (len(x), 2) if own_kind.parts == 2 else len(x))
    base = {n: getattr(Model(), n) for n in BASE_PARAMETERS}
    held = TabulatedLaw.of(law, x, y, base)
    text = render_table_effect("made", held, {n: base[n] for n, _ in own_kind.owners}, ["Found somewhere."])
    effect = read(own, "made", text)
    known = instant(own_kind, rng)
    shape = known[own_kind.what].shape[:2]
    old = rng.uniform(0.1, 0.2, (*shape, 2) if own_kind.law == "push" else shape)
    results = []
    for one in (effect(), held):
        ((bent, bend, asks),) = one.bends
        assert bent == own_kind.law
        results.append(bend(old, *[known[a] for a in asks]))
    np.testing.assert_allclose(*results, atol=1e-12)
    assert np.abs(results[0] - old).max() > 1e-3
    assert not effect(share=0.0).active


@each_outsider
def test_the_model_with_the_effect_foretells_collisions_kept_out_as_the_true_law_does(law, report_on, own):
    new = adopt(report_on(law), "slick_patch", own)
    add_effects(own)
    model, found = read_model(new.model), outsider(law)
    assert [e.name() for e in model.effects] == ["slick_patch"]
    assert bool(new.formula) == (law != "friction_place")
    there = fit_model(found.data.held_out, model, (), found.data.noise, found.gap_fits.before.launches)
    before, after = found.gap_fits.before, found.gap_fits.after
    assert before.chi2 - there.chi2 > 0.97 * (before.chi2 - after.chi2)
    assert read_scene(new.model).draw().model.laws.has_effect_on(TABLE_KINDS[law].law)


def test_the_formula_is_that_of_what_was_hidden(report_on, own):
    """0.903 - 0.004 (1 + tanh((v - 0.2) / 0.03)) / 2, its strength and shape free in the model."""
    new = adopt(report_on("restitution_speed"), "late_drop", own)
    add_effects(own)
    model = read_model(new.model)
    assert set(model.free) == {"late_drop.size", "late_drop.at", "late_drop.width"}
    assert model.restitution * model.value("late_drop.size") == pytest.approx(-0.004, rel=0.2)
    assert model.value("late_drop.at") == pytest.approx(0.2, abs=0.02)
    seen = collisions(dataclasses.replace(Model(), effects=(OUTSIDERS["restitution_speed"],)), 12, 7)
    fit = fit_model(seen, model, (*BASE_PARAMETERS, *model.free), Noise(NoiseComponent(1.0)))
    assert fit.chi2 / (fit.points - fit.parameters) < 1.1


@pytest.mark.parametrize(
    ("law", "name", "class_name", "words", "argument"),
    [
        ("restitution_speed", "late_drop", "LateDrop", "r that depends on the normal speed", "normal_speed"),
        pytest.param(
            *("spin_transfer_speed", "late_grip", "LateGrip", "C that depends on the contact speed", "contact_speed"),
            marks=pytest.mark.gate,
        ),
    ],
)
def test_the_file_is_python_that_says_what_it_is(law, name, class_name, words, argument, report_on, own):
    text = adopt(report_on(law), name, own).effect.read_text()
    tree = ast.parse(text)
    (kind,) = (n for n in tree.body if isinstance(n, ast.ClassDef))
    assert kind.name == class_name
    said = ast.get_docstring(kind)
    assert "Found by `discrepancy find`" in said
    assert re.search(rf"{words}, \d+ sigma in \d+ collisions", " ".join(said.split()))
    assert all(word in said for word in ("size", "at", "width", f"{argument} in m/s"))
    assert max(map(len, text.splitlines())) <= 120
    assert 'parameter("m/s", typical=' in text


def test_the_command_writes_and_says_the_line(report_on, own, capsys):
    words = ["adopt", report_on("restitution_speed"), "--name", "late_drop", "-o", own / "mine", "--json"]
    assert command(*words) == 0
    said = json.loads(capsys.readouterr().out)
    assert sorted(p.name for p in (own / "mine").iterdir()) == ["late_drop.py", "late_drop.yaml"]
    assert said["line"].startswith("effects: {late_drop: {size: -0.00")
    assert command(*words) == 2
    assert "late_drop.py: exists; expected another name" in capsys.readouterr().err
    assert command("find", "none.csv", "--model", said["model"], "--effects", own / "mine", "-o", own / "x") == 2
    assert "none.csv: no such file" in capsys.readouterr().err  # so the model was read


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("../x", "expected a name of lower-case letters"),
        ("x y", "expected a name of lower-case letters"),
        ("stribeck", "an effect of this name exists already"),
        ("friction_speed", "this is the name of a law"),
    ],
)
def test_a_name_that_cannot_be(name, said, report_on, own):
    with pytest.raises(InputError, match=f"--name {re.escape(name)}: .*{said}"):
        adopt(report_on("restitution_speed"), name, own / "new")
    assert not (own / "new").exists()


def changed(report, folder, **keys):
    shutil.copytree(report, folder)
    document = json.loads((folder / "discrepancy.json").read_text())
    (folder / "discrepancy.json").write_text(json.dumps(document | keys))
    return folder


def test_what_is_no_report_or_has_no_law_is_one_line(report_on, own):
    report = report_on("restitution_speed")
    outside = json.loads((report / "discrepancy.json").read_text())["outside"][0]
    cases = {
        "discrepancy.json: No such file": own / "none",
        "its verdict is named; expected a report with a free law": changed(
            report, own / "a", outside=[], verdict="named"
        ),
        "its free law is lag_speed, which model.yaml does not contain: of the instrument": changed(
            report, own / "b", outside=[outside | {"slot": "lag_speed"}]
        ),
        "outside: not in the form that `discrepancy find` writes": changed(
            report, own / "c", outside=[{"slot": outside["slot"]}]
        ),
        "discrepancy.json: not in the form": changed(report, own / "d", outside=3),
    }
    (own / "e").mkdir()
    (own / "e/discrepancy.json").write_text("{")
    cases["e/discrepancy.json: not in the form"] = own / "e"
    for said, folder in cases.items():
        with pytest.raises(InputError, match=said) as error:
            adopt(folder, "some_name", own / "new")
        assert "\n" not in str(error.value)
    assert not (own / "new").exists()


def test_a_hostile_report_writes_no_code(report_on, own):
    """Its words end up in a docstring, whatever they are."""
    report = report_on("restitution_speed")
    outside = json.loads((report / "discrepancy.json").read_text())["outside"][0]
    words = 'r """\n\nBAD = 1\n"""\\'
    hostile = changed(report, own / "f", outside=[outside | {"law": words, "formula": words}])
    tree = ast.parse(adopt(hostile, "some_name", own / "new").effect.read_text())
    kinds = [type(n) for n in tree.body]
    assert set(kinds) <= {ast.Expr, ast.ImportFrom, ast.Import, ast.ClassDef}
    assert "BAD" in ast.get_docstring(tree.body[-1])
