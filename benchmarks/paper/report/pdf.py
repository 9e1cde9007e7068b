"""The paper's page as a PDF, by matplotlib alone."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from synthcam_shared.report.page import PageTable

PORTRAIT, LANDSCAPE = (8.27, 11.69), (11.69, 8.27)  # inches: A4
MARGIN = 0.07
LINE = 0.0195  # inches, times the size of the font in points
WIDE = 118  # characters a line of words
CELL = 205  # characters a line of a table
TEXT_SIZE, TABLE_SIZE = 7.6, 5.8  # points


def write(
    path: Path,
    title: str,
    summary: Sequence[str],
    figures: Sequence[tuple[Sequence[str], Figure]],
    texts: Mapping[str, Sequence[str]],
    tables: Sequence[PageTable],
) -> None:
    """Write the PDF: summary, a page for each figure with its lines of caption, texts by heading, tables."""
    aside = path.with_suffix(".aside")
    with PdfPages(aside, metadata={"Title": title}) as pages:
        first = [f"# {title}", "", *(line for text in summary for line in [*textwrap.wrap(text, WIDE), ""])]
        pages.savefig(_page(first, "DejaVu Sans", TEXT_SIZE, PORTRAIT))
        for caption, figure in figures:
            lines = [line for text in caption for line in [*textwrap.wrap(text, WIDE), ""]]
            width, height = figure.get_size_inches()
            figure.set_size_inches(width, height + 0.145 * len(lines) + 0.2)
            figure.supxlabel("\n".join(lines), x=0.02, ha="left", fontsize=7.2, linespacing=1.35)
            pages.savefig(figure)
        for lines in _pages(list(_text(texts)), TEXT_SIZE, PORTRAIT):
            pages.savefig(_page(lines, "DejaVu Sans", TEXT_SIZE, PORTRAIT))
        for table in tables:
            for lines in _pages(list(_table(table)), TABLE_SIZE, LANDSCAPE):
                pages.savefig(_page(lines, "DejaVu Sans Mono", TABLE_SIZE, LANDSCAPE))
    aside.replace(path)


def _page(lines: Sequence[str], family: str, size: float, paper: tuple[float, float]) -> Figure:
    figure = Figure(figsize=paper)
    for row, line in enumerate(lines):
        bold = line.startswith("# ")
        y = 1 - MARGIN / 1.5 - row * LINE * size / paper[1]
        figure.text(
            MARGIN, y, line.removeprefix("# "), family=family, fontsize=size * (1.15 if bold else 1), va="top",
            weight="bold" if bold else "normal", parse_math=False,
        )  # fmt: skip
    return figure


def _pages(lines: list[str], size: float, paper: tuple[float, float]) -> Iterator[list[str]]:
    fit = int((1 - 1.4 * MARGIN) * paper[1] / (LINE * size))
    for start in range(0, len(lines), fit):
        yield lines[start : start + fit]


def _text(texts: Mapping[str, Sequence[str]]) -> Iterator[str]:
    for title, lines in texts.items():
        yield from ("", f"# {title}")
        for number, line in enumerate(lines, 1):
            yield from textwrap.wrap(f"{number}. {line}", WIDE, subsequent_indent="    ")


def _table(table: PageTable) -> Iterator[str]:
    """Lines of a table with columns as wide as they need; the widest are wrapped."""
    yield f"# {table.title}"
    need = [max(len(row[c]) for row in [table.heads, *table.rows]) for c in range(len(table.heads))]
    room = CELL - 2 * len(need)
    width = list(need)
    while sum(width) > room:  # the widest column is wrapped
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
