"""Pieces of the generated pages, as MyST Markdown."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Sequence

MARKS = re.compile(r"([\\`*_{}\[\]<>$|#~^])")


def plain(text: str) -> str:
    """Text in which nothing is markup but code between backticks."""
    pieces = re.split(r"(`{1,2}[^`]+`{1,2})", " ".join(text.split()))
    return "".join(p if p.startswith("`") else MARKS.sub(r"\\\1", p) for p in pieces)


def paragraphs(thing: object) -> list[str]:
    """The docstring of a thing, a string a paragraph."""
    doc = inspect.getdoc(thing) or ""
    return [" ".join(part.split()) for part in re.split(r"\n\s*\n", doc) if part.strip()]


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of cells that are markup already."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def fence(text: str, language: str = "text") -> str:
    """A block of code, or of what a program prints."""
    return f"```{language}\n{text.rstrip()}\n```"
