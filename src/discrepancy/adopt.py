"""Turn a free law that a search found into an effect file with its formula or its curve."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from discrepancy.free_laws.formula import CONSTANT, FormulaTerm, LawShape, iterate_shapes
from discrepancy.free_laws.library import list_free_laws as free_laws
from discrepancy.free_laws.ranges import Axis
from synthcam.effect import VECTOR_INPUTS
from synthcam.library import check_name
from synthcam.model import Model, list_model_settings, read_model, to_yaml
from synthcam.tabulated_law import REFERENCE_SPEED_M_S, SEARCH_ONLY_LAWS, TableKind, TabulatedLaw, kind_of
from synthcam_shared.errors import InputError
from synthcam_shared.outputs import as_input_error, check_writable, write_atomically

MAX_WIDTH = 110  # characters of a line
ARGUMENT_NAMES = {"friction": "mu", "restitution": "r", "spin_transfer": "c", "rolling": "loss", "push": "acceleration"}


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

    report: a folder that ``discrepancy find`` wrote.
    name: of small letters, digits and "_", and not the name of another effect or law.
    folder: for NAME.py and NAME.yaml, made if it does not exist.

    Raises InputError if the report has no free law that an effect can express, the name is taken, or the files exist.
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
    """Split terms into strengths of the effect and numbers of the base model that has them; None if impossible."""
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


# --- The text of the file: one class, like the effects of synthcam


@dataclass(frozen=True)
class ParameterValue:
    """A parameter by name, its value, and the power of the law's argument in its unit."""

    name: str
    value: float
    power: float = 0.0


def render_formula_effect(
    name: str,
    law: str,
    strengths: Sequence[tuple[FormulaTerm, ParameterValue]],
    shape: Sequence[ParameterValue],
    source: Sequence[str],
) -> str:
    """Render the text of an effect file whose law is a formula.

    law: the name of the free law in `synthcam.tabulated_law.table_names`.
    strengths: the terms that are added, each times its strength, relative to a law that is one base parameter.
    shape: the numbers of the shape.
    source: the origin of the law, in sentences.
    """
    kind, ball = kind_of(law)
    relative, x, old = len(kind.owners) == 1, _argument_code(kind), ARGUMENT_NAMES[kind.law]
    numbers = {v.name: f"self.{v.name}" for v in shape}
    added = [f"self.{v.name} * {t.code.format(x=x, **numbers)}".removesuffix(" * 1") for t, v in strengths]
    text = " + ".join(f"{v.name} {_term_text(t, x)}".strip() for t, v in strengths)
    law_text = f"{old} [1 + {text}]" if relative else f"{old} + {text}"
    unit = "1" if relative else kind.unit
    parameters = [
        f'{v.name}: float = parameter("{_unit_times(unit, kind.x_unit, -v.power)}", typical={abs(v.value) or 1.0:.3g})'
        for _, v in strengths
    ] + [_render_shape_parameter(v, kind) for v in shape]
    doc = [f"{law_text}, {_describe_argument(kind, x)}.{_ball_sentence(ball)}", *source]
    return _render_file(
        name, f"{_make_title(kind)}, by a formula", doc, parameters, _render_method(kind, ball, added, relative)
    )


def render_table_effect(name: str, held: TabulatedLaw, numbers: Mapping[str, float], source: Sequence[str]) -> str:
    """Render the text of an effect file whose law is a table for `share` 1, and the base model for `share` 0.

    numbers: the base parameters that the table replaces, as the model beside the effect has them; source: the origin of
    the law, in sentences.
    """
    kind, ball = kind_of(held.law)
    plain, x, old = held.to_settings(numbers), _argument_code(kind), ARGUMENT_NAMES[kind.law]
    value = f"CURVE({f'{kind.what}[..., 0], {kind.what}[..., 1]' if kind.axis == 'place' else x})"
    if _has_speed_part(kind):
        value = f"({value} * np.stack([np.ones_like(speed), speed / {REFERENCE_SPEED_M_S:g}], axis=-1)).sum(axis=-1)"
    base = [f"{numbers[n]!r}" + (f" * {x}" if power else "") for n, power in kind.owners]
    added = f"self.share * ({' - '.join([value, *base])})" if base else f"self.share * {value}"
    tables = [
        f"X = {_render_tuple(plain['x'])}",
        f"Y = {_render_tuple(plain['y'])}",
        f"CURVE = SmoothTable(X, Y{', turn=True' if kind.axis == 'turn' else ''})",
    ]
    stands = " and ".join(f"{n} {v:.6g}" for n, v in numbers.items())
    where = f"{kind.what}, {kind.x_unit}" if kind.axis == "place" else _describe_argument(kind, x)
    doc = [
        f"{old} as in the table Y, {kind.unit}, where share is 1: X {where}.{_ball_sentence(ball)}"
        + (f" Share 0 is a base model of {stands}." if stands else ""),
        *source,
    ]
    method = _render_method(kind, ball, [added], relative=False)
    parameters = ['share: float = parameter("1", typical=1.0, default=1.0)']
    return _render_file(name, f"{_make_title(kind)}, by a table", doc, parameters, method, tables)


def _render_file(
    name: str, title: str, doc: Sequence[str], parameters: Sequence[str], method: str, tables: Sequence[str] = ()
) -> str:
    """Render the whole file."""
    plain = [
        " ".join(d.split()).replace("\\", "/").replace('"', "'") for d in doc
    ]  # the text of a report cannot end the docstring
    text = "\n\n    ".join(textwrap.fill(d, MAX_WIDTH, subsequent_indent="    ") for d in plain)
    imports = "import numpy as np\n\n" if "np." in method else ""
    uses = "from synthcam.effect import Effect, parameter\n" + (
        "from synthcam.table import SmoothTable\n" if tables else ""
    )
    head = "\n" + "\n".join(tables) + "\n" if tables else ""
    own = "\n".join(f"    {p}" for p in parameters)
    class_name = "".join(part.title() for part in name.split("_"))
    return (
        f'"""{title}."""\n\nfrom dataclasses import dataclass\nfrom typing import Any\n\n{imports}{uses}{head}\n\n'
        f'@dataclass(frozen=True)\nclass {class_name}(Effect):\n    """{text}\n    """\n\n{own}\n\n{method}'
    )


def _render_method(kind: TableKind, ball: str, added: Sequence[str], relative: bool) -> str:
    """Render the method that changes the law. added: code of the terms, relative to the law or absolute."""
    old, sum_ = ARGUMENT_NAMES[kind.law], _join_terms(added)
    asks = [kind.what, *["speed"] * _has_speed_part(kind), *["of_a"] * bool(ball)]
    whose = {"a": "of_a", "b": "(1 - of_a)", "": ""}[ball]
    sized = [f"speed = np.hypot({kind.what}[..., 0], {kind.what}[..., 1])"] if _is_vector_size(kind) else []
    if kind.law == "push" and kind.axis == "line":
        lines = [
            f"force = {whose} * ({sum_})" if whose else f"force = {sum_}",
            f"return np.asarray({old} + (force / np.maximum(speed, 1e-9))[..., None] * velocity)",
        ]
    elif kind.law == "push" and kind.axis == "turn":
        lines = [
            f"force = {sum_}",
            "across = np.stack([-velocity[..., 1], velocity[..., 0]], axis=-1)",
            f"return np.asarray({old} + force[..., :1] * velocity + force[..., 1:] * across)",
        ]
    elif kind.law == "push":
        share = f"np.asarray({whose})[..., None] * " if whose else ""
        lines = [f"return np.asarray({old} + {share}{sum_})"]
    else:
        sum_ = f"{whose} * ({sum_})" if whose else sum_
        lines = [f"return {old} * (1 + {sum_})" if relative else f"return {old} + {sum_}"]
    lines = sized + lines
    own = "".join(f", {a}: Any" for a in asks)
    return f"    def {kind.law}(self, {old}: Any{own}) -> Any:\n" + "".join(f"        {line}\n" for line in lines)


def _join_terms(added: Sequence[str]) -> str:
    """Join terms to a sum, on several lines if it is long."""
    one = " + ".join(added)
    return one if len(one) < MAX_WIDTH - 40 else "(\n            " + "\n            + ".join(added) + "\n        )"


def _has_speed_part(kind: TableKind) -> bool:
    """True for a sum of a constant and a term proportional to the speed."""
    return kind.law == "rolling" and kind.parts == 2


def _ball_sentence(ball: str) -> str:
    return f" Of ball {ball} alone." if ball else ""


def _argument_code(kind: TableKind) -> str:
    """Code of x."""
    if kind.axis == "turn":
        return f"np.arctan2({kind.what}[..., 1], {kind.what}[..., 0])"
    return "speed" if _is_vector_size(kind) else kind.what


def _is_vector_size(kind: TableKind) -> bool:
    """True if x is the length of a vector."""
    return kind.axis == "line" and kind.what in VECTOR_INPUTS


def _describe_argument(kind: TableKind, x: str) -> str:
    if kind.axis == "turn":
        return f"th the direction of the {kind.what.replace('_', ' ')}, rad"
    return x if kind.x_unit == "1" else f"{x} in {kind.x_unit}"


def _term_text(term: FormulaTerm, x: str) -> str:
    """A term's code in the form of a formula."""
    out = term.code.format_map(_Bare(x="th" if "arctan2" in x else x)).replace("np.", "").replace("maximum(", "max(")
    return "" if out == "1" else out.replace(" ** ", "^").replace("**", "^").replace(" * ", " ")


class _Bare(dict[str, str]):
    """Leaves unknown names unchanged."""

    def __missing__(self, key: str) -> str:
        return key


def _make_title(kind: TableKind) -> str:
    word = {"push": "force over mass", "rolling": "rolling loss"}.get(kind.law, kind.law.replace("_", " "))
    return f"{word.capitalize()} that depends on the {kind.what.replace('_', ' ')}"


def _render_shape_parameter(v: ParameterValue, kind: TableKind) -> str:
    # a tenth to ten times its value; exponents and negative numbers from -10 to 10
    low, high = (v.value / 10, v.value * 10) if v.name != "power" and v.value > 0 else (-10.0, 10.0)
    unit = _unit_times("1", kind.x_unit, v.power)
    return f'{v.name}: float = parameter("{unit}", typical={v.value:.6g}, low={low:.6g}, high={high:.6g}, fixed=True)'


def _unit_times(unit: str, x_unit: str, power: float) -> str:
    """A unit times another to a power."""
    if not power or x_unit in ("1", "rad"):
        return unit
    if power > 0:
        times = x_unit if power == 1 else f"({x_unit})^{power:g}"
        return times if unit == "1" else f"{unit} {times}"
    less = f"({x_unit})" if power == -1 else f"({x_unit})^{-power:.3g}"
    return f"{unit}/{less}"


def _render_tuple(values: Sequence[object]) -> str:
    text = ", ".join(repr(tuple(v) if isinstance(v, list) else v) for v in values)
    return "(\n" + textwrap.fill(f"{text},", MAX_WIDTH, initial_indent="    ", subsequent_indent="    ") + "\n)"
