"""Check the arguments of public functions, and name arguments in their errors where commands name options."""

from __future__ import annotations

import functools
import inspect
import os
import re
from collections.abc import Callable, Mapping
from numbers import Integral, Real
from typing import Any, ParamSpec, TypeVar

from synthcam_shared.errors import CALLED_BY_COMMAND, InputError

Given = ParamSpec("Given")
Returned = TypeVar("Returned")


def check_arguments(function: Callable[Given, Returned]) -> Callable[Given, Returned]:
    """Raise InputError, and no other error, for arguments of another type than the function's signature says.

    Annotations of plain types and classes are checked; others are the function's own business. The InputErrors of the
    function name `--option` as "argument option", unless a command called it.
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def checked(*args: Given.args, **kwargs: Given.kwargs) -> Returned:
        for name, value in signature.bind(*args, **kwargs).arguments.items():
            expected = f"{signature.parameters[name].annotation}"
            kinds = _kinds(expected, function)
            if kinds and not isinstance(value, kinds):
                raise InputError(f"{name}: of type {type(value).__name__}, expected {expected.replace('pd.', '')}")
        try:
            return function(*args, **kwargs)
        except InputError as error:
            text = name_arguments(str(error))
            if text == str(error):
                raise
            raise type(error)(text) from None

    return checked


def check_keywords(given: Mapping[str, Any], known: Mapping[str, Any]) -> None:
    """Raise InputError for a keyword that is none of the known ones, the annotations of a TypedDict, or of its type."""
    for name, value in given.items():
        if name not in known:
            raise InputError(f"{name}: unknown, expected one of {', '.join(sorted(known))}")
        expected = known[name].__forward_arg__
        if not isinstance(value, _kinds(expected, check_keywords)):
            raise InputError(f"{name}: of type {type(value).__name__}, expected {expected}")


def name_arguments(text: str) -> str:
    """Name arguments in an error's text where it names options, but not in commands between backquotes."""
    if CALLED_BY_COMMAND.get():
        return text
    parts = re.sub(r"^--([a-z]+):", r"\1:", text).split("`")
    option = re.compile(r"(?<![\w-])--([a-z]+)")
    return "`".join(part if k % 2 else option.sub(r"argument \1", part) for k, part in enumerate(parts))


def _kinds(annotation: str, function: Callable[..., Any]) -> tuple[Any, ...]:
    """The classes of an annotation such as `str | Path | None`; none where it has parts of another form."""
    names: dict[str, Any] = getattr(function, "__globals__", {})
    found: list[Any] = []
    known = {
        "str": str,
        "int": Integral,
        "float": Real,
        "bool": (bool, Integral),
        "Path": os.PathLike,
        "None": type(None),
        "Sequence[str]": (list, tuple),
    }
    for part in annotation.split(" | "):
        kind = known.get(part, names.get(part))
        if part == "pd.DataFrame":
            kind = getattr(names.get("pd"), "DataFrame", None)
        if kind is Any or not isinstance(kind, type | tuple):
            return ()
        found += kind if isinstance(kind, tuple) else [kind]
    return tuple(found)
