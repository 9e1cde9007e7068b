"""Turn a free law that a search found into an effect file with its formula or its curve."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from discrepancy.effect_file import ParameterValue, render_formula_effect, render_table_effect
from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.library import list_free_laws as free_laws
from discrepancy.free_laws.shapes import CONSTANT, FormulaTerm, LawShape, iterate_shapes
from synthcam.library import check_name
from synthcam.model import Model, list_model_settings, read_model, to_yaml
from synthcam.tabulated_law import SEARCH_ONLY_LAWS, TableKind, TabulatedLaw, kind_of
from synthcam_shared.errors import InputError
from synthcam_shared.outputs import as_input_error, check_writable, write_atomically


@dataclass(frozen=True)
class AdoptedEffect:
    """The files of an adopted effect."""

    name: str
    effect: Path
    model: Path
    line: str  # the line of YAML by which a model or scene has the effect
    formula: str | None  # None for a table

    def document(self) -> dict[str, Any]:
        """The result for other programs."""
        return {k: str(v) if isinstance(v, Path) else v for k, v in vars(self).items()}


def adopt(report: str | Path, name: str, folder: str | Path = "effects") -> AdoptedEffect:
    """Write an effect file from the free law in a search's report, and a model file that has it.

    The effect has the proposed formula if that suffices and the law has one axis; otherwise the curve or map.

    report: a folder that ``discrepancy find`` wrote. name: of small letters, digits and "_", and not the name of
    another effect or law. folder: for NAME.py and NAME.yaml, made if it does not exist. Raises InputError if the report
    has no free law that an effect can express, the name is taken, or the files exist.
    """
    report, folder = Path(report), Path(folder)
    check_name(name, f"--name {name}")
    entry = _read_free_law(report)
    model = read_model(report / "model.yaml")
    slot = str(entry.get("slot"))
    held = next((e for e in model.effects if isinstance(e, TabulatedLaw) and e.law == slot), None)
    if held is None:
        why = f": {SEARCH_ONLY_LAWS[slot]}" if slot in SEARCH_ONLY_LAWS else ""
        raise InputError(f"{report}: its free law is {slot}, which model.yaml does not contain{why}")
    files = folder / f"{name}.py", folder / f"{name}.yaml"
    for file in files:
        if file.exists():
            raise InputError(f"{file}: exists; expected another name or folder")
    where = f"{report / 'discrepancy.json'}: outside"
    try:
        text, values, plain, formula = _render_effect(name, model, held, entry, _describe_source(report, entry))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{where}: not in the form that `discrepancy find` writes ({error!r})") from None
    plain["effects"] = plain.get("effects", {}) | {name: values}
    plain["free"] = [*plain.get("free", []), *(f"{name}.{k}" for k in values if formula)]
    if not plain["free"]:
        del plain["free"]
    check_writable(files[0])
    with as_input_error(folder):
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(files[0], text)
        write_atomically(files[1], to_yaml(plain))
    line = f"effects: {{{name}: {{{', '.join(f'{k}: {v:.6g}' for k, v in values.items())}}}}}"
    return AdoptedEffect(name, *files, line, formula)


def _read_free_law(report: Path) -> dict[str, Any]:
    """Read the free law of a report, with its gap and clips. Raises InputError."""
    file = report / "discrepancy.json"
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        verdict, outside = document["verdict"], list(document["outside"])
    except OSError as error:
        raise InputError(f"{file}: {error.strerror or error}; expected a report of `discrepancy find`") from None
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{file}: not in the form that `discrepancy find` writes") from None
    if not (outside and isinstance(outside[0], dict)):
        raise InputError(f"{report}: its verdict is {verdict}; expected a report with a free law to adopt")
    return dict(outside[0]) | {"gap": document.get("gap"), "clips": document.get("clips")}


def _describe_source(report: Path, entry: Mapping[str, Any]) -> list[str]:
    """The origin of the law, in sentences."""
    gap, clips = entry["gap"], entry["clips"]
    return [
        f"Found by `discrepancy find` ({report.name}): {entry['law']}, {entry['sigma']:.0f} sigma in {clips['fitted']} "
        f"collisions. On {clips['kept_out']} kept out, chi^2 a point goes from {gap['before']:.3g} to "
        f"{gap['after']:.3g}; noise leaves {gap['floor']:.3g}.",
        f"Proposed: {entry['formula']}." + ("" if entry["formula_suffices"] else " The data reject it."),
    ]


def _render_effect(
    name: str, model: Model, held: TabulatedLaw, entry: Mapping[str, Any], source: list[str]
) -> tuple[str, dict[str, float], dict[str, Any], str | None]:
    """Render the effect file: its text, the effect's values, the model's settings without the table, the formula."""
    kind, ball = kind_of(held.law)
    bare = replace(model, effects=tuple(e for e in model.effects if e is not held))
    parts = entry["formula_parts"] if entry["formula_suffices"] else None
    shape = _find_shape(held.law, kind, entry, parts) if parts else None
    if shape and parts:
        numbers = [float(parts["numbers"][n]) for n, _ in shape.numbers]
        terms = [(t, float(parts["factors"][t.name])) for t in shape.terms(*numbers)]
        beside = _split_strengths(kind, ball, bare, terms)
        if beside:
            values, base = beside
            shaped = [ParameterValue(n, float(v), power) for (n, power), v in zip(shape.numbers, numbers, strict=True)]
            text = render_formula_effect(name, held.law, values, shaped, source)
            every = {v.name: v.value for _, v in values} | {v.name: v.value for v in shaped}
            return text, every, list_model_settings(bare.replace(base)), str(entry["formula"])
    numbers_of = {owner: bare.value(owner) for owner, _ in kind.owners}
    return render_table_effect(name, held, numbers_of, source), {"share": 1.0}, list_model_settings(bare), None


def _find_shape(law: str, kind: TableKind, entry: Mapping[str, Any], parts: Mapping[str, Any]) -> LawShape | None:
    """Find the shape of that name and those terms; None if it has no code."""
    own = law.removesuffix("_a").removesuffix("_b") if kind.one_ball else law
    search = next((k for k in free_laws() if k.base_name == own), None)
    if search is None or len(entry["axes"]) != 1 or kind.parts != 1:
        return None
    x = np.array(entry["x"], dtype=float)
    axis = Axis("x", kind.x_unit, float(x[0]), float(x[-1]), 50, "circle" if kind.axis == "turn" else "line", "x")
    for shape in iterate_shapes(replace(search, axes=(axis,)), [axis.grid(50)]):
        named = [t.name for t in shape.terms(*(t[0] for t in shape.tries))]
        if shape.name == parts["shape"] and set(named) == set(parts["factors"]):
            return shape
    return None


def _split_strengths(
    kind: TableKind, ball: str, model: Model, terms: list[tuple[FormulaTerm, float]]
) -> tuple[list[tuple[FormulaTerm, ParameterValue]], dict[str, float]] | None:
    """Split the terms into strengths of the effect and numbers of the base model; None if no such model exists.

    A law of one base parameter is that parameter times a sum; any other law is a sum. Constant and linear terms become
    base parameters where the law has these. For a law of one ball the effect has the difference from them.
    """
    owners = {power: name for name, power in kind.owners}
    relative, base, values = list(owners) == [0], {}, []
    if relative and CONSTANT not in {t.name for t, _ in terms}:
        return None
    lead = next((f for t, f in terms if t.name == CONSTANT), 1.0) if relative and not ball else 1.0
    lead = model.value(owners[0]) if relative and ball else lead
    if relative and not lead:
        return None
    for term, factor in terms:
        owner = owners.get({CONSTANT: 0, "linear": 1}.get(term.name, -1))  # by the power of x
        if owner and not ball:
            base[owner] = factor
            continue
        strength = factor / lead - (model.value(owner) / lead if owner else 0.0)
        values.append((term, ParameterValue(term.name, strength, term.power)))
    low_enough = all(v >= 0 for v in base.values())
    return (values, base) if values and low_enough else None
