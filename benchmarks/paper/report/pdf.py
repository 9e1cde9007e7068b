"""The page as a PDF, by matplotlib alone: words, tables, then a figure a page with its caption."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from benchmarks.paper.report.tables import Table

PORTRAIT, LANDSCAPE = (8.27, 11.69), (11.69, 8.27)  # inches: A4
MARGIN = 0.07
LINE = 0.146  # inches
WIDE = 118  # characters a line of words
CELL = 205  # characters a line of a table


def write(
    path: Path, words: Mapping[str, Any], tables: Sequence[Table], figures: Sequence[tuple[Mapping[str, Any], Figure]]
) -> None:
    """Write it whole."""
    aside = path.with_suffix(".aside")
    with PdfPages(
        aside, metadata={"Title": "Two-particle granular collisions on a surface, reproduced from video"}
    ) as pages:
        for lines in _pages(list(_text(words)), PORTRAIT):
            pages.savefig(_page(lines, "DejaVu Sans", 7.6, PORTRAIT))
        for table in tables:
            for lines in _pages(list(_table(table)), LANDSCAPE):
                pages.savefig(_page(lines, "DejaVu Sans Mono", 5.8, LANDSCAPE))
        for about, figure in figures:
            caption = f"Figure {about['number']}. {about['title']}. {about['caption']}"
            lines = [
                *textwrap.wrap(caption, WIDE),
                "",
                *textwrap.wrap(f"Paper: {about['paper']}", WIDE),
                "",
                about["command"],
            ]
            width, height = figure.get_size_inches()
            figure.set_size_inches(width, height + 0.145 * len(lines) + 0.2)
            figure.supxlabel("\n".join(lines), x=0.02, ha="left", fontsize=7.2, linespacing=1.35)
            pages.savefig(figure)
    aside.replace(path)


def _page(lines: Sequence[str], family: str, size: float, paper: tuple[float, float]) -> Figure:
    figure = Figure(figsize=paper)
    for row, line in enumerate(lines):
        bold = line.startswith("# ")
        y = 1 - MARGIN / 1.5 - row * LINE / paper[1]
        figure.text(
            MARGIN, y, line.removeprefix("# "), family=family, fontsize=size * (1.15 if bold else 1), va="top",
            weight="bold" if bold else "normal", parse_math=False,
        )  # fmt: skip
    return figure


def _pages(lines: list[str], paper: tuple[float, float]) -> Iterator[list[str]]:
    fit = int((1 - 1.4 * MARGIN) * paper[1] / LINE)
    for start in range(0, len(lines), fit):
        yield lines[start : start + fit]


def _text(words: Mapping[str, Any]) -> Iterator[str]:
    yield "# Two-particle granular collisions on a surface, reproduced from video"
    yield ""
    yield from textwrap.wrap(str(words["outcome"]), WIDE)
    for key, title in (
        ("shown", "What is shown"),
        ("conjecture", "What is conjecture"),
        ("decide", "What would decide"),
    ):
        yield from ("", f"# {title}")
        for number, line in enumerate(words[key], 1):
            yield from textwrap.wrap(f"{number}. {line}", WIDE, subsequent_indent="    ")


def _table(table: Table) -> Iterator[str]:
    """Columns as wide as they need, cells of several lines."""
    yield f"# Table {table.number}. {table.title}"
    need = [max(len(row[c]) for row in [table.heads, *table.rows]) for c in range(len(table.heads))]
    room = CELL - 2 * len(need)
    width = list(need)
    while sum(width) > room:  # the widest gives way
        width[width.index(max(width))] -= 1
    yield from textwrap.wrap(table.note, CELL)
    yield ""
    for row in [table.heads, *table.rows]:
        cells = [textwrap.wrap(cell, w) or [""] for cell, w in zip(row, width, strict=True)]
        for line in range(max(map(len, cells))):
            yield "  ".join(
                (cell[line] if line < len(cell) else "").ljust(w) for cell, w in zip(cells, width, strict=True)
            )
        if row is table.heads:
            yield "-" * CELL
