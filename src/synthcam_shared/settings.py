"""Settings in YAML: read safely and strictly, with one clear line where they are wrong."""

import errno
import gc
import re
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from synthcam_shared.errors import InputError

try:  # libyaml, where PyYAML was built with it, reads in a quarter of the time
    from yaml import CSafeLoader as SafeLoader
except ImportError:
    from yaml import SafeLoader  # type: ignore[assignment]

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]

MAX_ENTRIES = 20_000  # of one list or mapping in a YAML file
MAX_VALUES = 800_000  # of a YAML file in all; libyaml reads as many in 3 s


class Settings(BaseModel):
    """Base of all settings: frozen; unknown keys are refused, numbers must be finite, text is no number."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


AnySettings = TypeVar("AnySettings", bound=Settings)


def read_settings(path: Path, kind: type[AnySettings]) -> AnySettings:
    """Settings of one kind from a YAML file. Raises InputError: one line with file, key and what was expected."""
    return build_settings(read_yaml(path), kind, str(path))


def build_settings(values: Any, kind: type[AnySettings], where: str) -> AnySettings:
    """Settings of one kind from keys and values. Raises InputError, which begins with `where`."""
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        raise to_input_error(error, where, kind) from None


def read_yaml(path: Path) -> dict[str, Any]:
    """Keys and values of a YAML file. Raises InputError where it cannot be read or is not plain YAML."""
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path}: not text, expected a YAML file") from None
    except OSError as e:
        known = {errno.ENOENT: "no such file", errno.EISDIR: "a folder, expected a YAML file"}
        raise InputError(f"{path}: {known.get(e.errno or 0, f'cannot be read ({e.strerror})')}") from None
    try:
        loaded = parse_yaml(text)
    except yaml.YAMLError as e:
        mark = getattr(e, "problem_mark", None)
        where = f", line {mark.line + 1}" if mark else ""
        problem = getattr(e, "problem", None) or "unreadable"
        reason = problem if isinstance(e, TooLongError) else f"not plain YAML ({problem})"
        raise InputError(f"{path}{where}: {reason}") from None
    if loaded is None:
        return {}
    if not isinstance(loaded, dict):
        raise InputError(f"{path}: expected keys and values, found {type(loaded).__name__}")
    return loaded


def parse_yaml(text: str) -> Any:
    """Plain YAML, safely: no tags, no aliases, no key twice. Raises YAMLError."""
    collects = gc.isenabled()
    try:
        _check_events(text)
        gc.disable()  # or it visits all nodes again and again, which takes more time than reading
        return yaml.load(text, Loader=_Loader)
    except ValueError as e:  # a date without its month, a number of 5000 digits
        raise yaml.MarkedYAMLError(problem=str(e).partition(";")[0]) from None
    finally:
        if collects:
            gc.enable()


class TooLongError(yaml.MarkedYAMLError):
    """A YAML text has too many values to be read in a few seconds."""


def _check_events(text: str, max_depth: int = 100) -> None:
    """Refuse aliases, deep nesting and too many values at the first one, before the text is read into memory.

    This takes a tenth of the time of reading. Raises YAMLError. max_depth: of lists and mappings inside one another.
    """
    inside, counts, key, values = list[bool](), list[int](), "", 0  # whether it is a list, and its values so far
    for event in yaml.parse(text, Loader=SafeLoader):
        mark: Any = event.start_mark
        if isinstance(event, yaml.AliasEvent):
            raise yaml.MarkedYAMLError(problem="aliases are not taken", problem_mark=mark)
        if isinstance(event, yaml.CollectionEndEvent):
            inside.pop()
            counts.pop()
        if not isinstance(event, yaml.NodeEvent):
            continue
        values += 1
        if counts:
            if len(counts) == 1 and not inside[0] and counts[0] % 2 == 0 and isinstance(event, yaml.ScalarEvent):
                key = event.value
            counts[-1] += 1
            most = MAX_ENTRIES * (1 if inside[-1] else 2)
            if counts[-1] > most or values > MAX_VALUES:
                limit = f"{MAX_ENTRIES} entries" if counts[-1] > most else f"{MAX_VALUES} values in all"
                raise TooLongError(problem=f"{key or 'the whole'}: expected at most {limit}", problem_mark=mark)
        if isinstance(event, yaml.CollectionStartEvent):
            inside.append(isinstance(event, yaml.SequenceStartEvent))
            counts.append(0)
            if len(counts) > max_depth:
                raise yaml.MarkedYAMLError(problem="nested too deeply", problem_mark=mark)


class _Loader(SafeLoader):
    """Loader that refuses a key given twice and reads 1e-3 as a number (YAML 1.1 wants 1.0e-3)."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key in (k for k, _ in node.value if isinstance(k, yaml.ScalarNode)):
            if key.value in seen:
                raise yaml.MarkedYAMLError(problem=f"key {key.value} given twice", problem_mark=key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_scalar(self, node: Any) -> Any:
        text = super().construct_scalar(node)
        if isinstance(text, str) and not text.isascii():
            try:
                text.encode()
            except UnicodeEncodeError:
                problem = "half a character, a surrogate of UTF-16"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark) from None
        return text


_Loader.add_implicit_resolver("!number", re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"), list("-+0123456789"))
_Loader.add_constructor("!number", lambda _, node: float(node.value))


def did_you_mean(word: str, known: Iterable[str], section: str = "", written: Mapping[str, str] | None = None) -> str:
    """Suggest the known key that is most similar to a wrong one in settings, for the end of a message.

    written: the spelling of each known word, if it differs.
    """
    near = get_close_matches(word.lower(), known, n=1, cutoff=0.5 if len(word) <= 3 else 0.6)
    return f"; did you mean {section}{written[near[0]] if written else near[0]}?" if near else ""


def _suggest_key(key: str, file: type[BaseModel]) -> str:
    """As `did_you_mean`: a key of the same section, or else the same word in another section."""
    section, dot, last = key.rpartition(".")
    known = list(_dotted_keys(file))
    beside = [k.removeprefix(section + dot) for k in known if k.rpartition(".")[0] == section]
    elsewhere = (f"; did you mean {k}?" for k in known if k.rpartition(".")[2] == last)
    return did_you_mean(last, beside, section + dot) or next(elsewhere, "")


def _dotted_keys(file: type[BaseModel], below: str = "") -> Iterator[str]:
    """Every key of a file with its sections, as launch.v0."""
    for name, field in file.model_fields.items():
        yield below + name
        for kind in (field.annotation, *get_args(field.annotation)):
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                yield from _dotted_keys(kind, f"{below}{name}.")


def _expectation(error: ErrorDetails) -> str:
    """Describe what pydantic expected, in words that need no knowledge of its types."""
    limits = error.get("ctx", {})
    kind = error["type"]
    if kind == "value_error":
        return str(limits["error"])
    words = {
        "float_type": "expected a number",
        "int_type": "expected a whole number",
        "int_from_float": "expected a whole number",
        "finite_number": "expected a finite number",
        "string_type": "expected a text",
        "bool_type": "expected true or false",
        "list_type": "expected a list",
        "model_type": "expected keys and values",
        "dict_type": "expected keys and values",
        "literal_error": "expected {expected}",
        "greater_than": "expected a number above {gt}",
        "greater_than_equal": "expected a number of {ge} or more",
        "less_than": "expected a number below {lt}",
        "less_than_equal": "expected a number of {le} or less",
        "too_short": "expected {min_length} or more values",
        "too_long": "expected {max_length} values or fewer",
    }
    if kind in words:
        return words[kind].format(**{k: f"{v:g}" if isinstance(v, float) else v for k, v in limits.items()})
    return f"{error['msg'][0].lower()}{error['msg'][1:]}"


def to_input_error(error: ValidationError, where: str, file: type[BaseModel]) -> InputError:
    """Turn pydantic's first complaint about settings into one line: file, dotted key, what was expected."""
    first = error.errors()[0]
    keys = [p for p in first["loc"] if not re.fullmatch(r"(literal|list)\[.*\]|[A-Z]\w*Settings", str(p))]
    key = ".".join(repr(p)[1:-1] if isinstance(p, str) else str(p) for p in keys) or "the whole"
    if first["type"] == "extra_forbidden":
        return InputError(f"{where}: {key}: unknown key{_suggest_key(key, file)}")
    either = [
        first,
        *(e for e in error.errors()[1:] if len(keys) < len(first["loc"]) and e["loc"][: len(keys)] == tuple(keys)),
    ]
    expected = " or ".join(dict.fromkeys(map(_expectation, either))).replace(" or expected ", " or ")
    if first["type"] == "missing":
        return InputError(f"{where}: {key}: required key is missing")
    found = repr(first["input"])
    found = found if len(found) < 60 else found[:57] + "..."
    return InputError(f"{where}: {key}: {expected}, found {found}")
