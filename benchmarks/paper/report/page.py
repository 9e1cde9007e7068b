"""The page of the reproduced paper: one HTML file and one PDF, and each figure and table as a file."""

from __future__ import annotations

import importlib
import pkgutil
from pathlib import Path
from types import ModuleType
from typing import Any

import matplotlib as mpl
import pandas as pd
from markupsafe import Markup
from matplotlib.figure import Figure

from benchmarks.paper.report import findings, pdf, tables
from benchmarks.paper.results import Results
from synthcam_shared.outputs import write_atomically
from synthcam_shared.report.page import Block, PageFigure, PageList, PageSection, write_page

FIGURES = Path(__file__).parents[1] / "figures"
COMMAND = "python -m benchmarks.paper.make"
RC: Any = {"font.size": 9, "axes.linewidth": 0.8, "svg.fonttype": "path", "pdf.fonttype": 42}
TITLE = "Two-particle granular collisions on a surface, reproduced from video"


def figures() -> list[str]:
    """List the names of all figures, which are found by their files."""
    return sorted(info.name for info in pkgutil.iter_modules([str(FIGURES)]))


def _module(name: str) -> ModuleType:
    return importlib.import_module(f"benchmarks.paper.figures.{name}")


def needs(name: str) -> tuple[str, ...]:
    """Name the series that a figure is drawn from."""
    series: tuple[str, ...] = _module(name).NEEDS
    return series


def compares(name: str) -> bool:
    """Tell whether a figure needs the comparison of models."""
    return bool(getattr(_module(name), "MODELS", False))


def draw(results: Results, name: str) -> Figure:
    """Draw one figure."""
    with mpl.rc_context(RC):
        figure: Figure = _module(name).draw(results)
    return figure


def write_figure(results: Results, name: str) -> Path:
    """Write one figure: figures/NAME.svg, NAME.png and its caption, NAME.txt."""
    folder = results.output / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    figure = draw(results, name)
    with mpl.rc_context(RC):
        for kind in ("svg", "png"):
            figure.savefig(folder / f"{name}.{kind}", dpi=150)
    module = _module(name)
    write_atomically(folder / f"{name}.txt", f"{module.SHOWS}\n\n{module.caption(results)}\n")
    return folder / f"{name}.svg"


def write(results: Results) -> Path:
    """Write index.html, paper.pdf, figures/ and tables/ in the output folder; return the path of the page."""
    command = COMMAND + (" --quick" if results.quick else "")
    blocks: list[Block] = []
    captions = []
    for name in figures():
        write_figure(results, name)
        module = _module(name)
        lead, caption = f"Figure {module.NUMBER}. {module.TITLE}. {module.SHOWS}", module.caption(results)
        html = Markup(
            "<b>{}</b><details><summary>How the figure was made</summary>{}<br><i>The paper's caption, in short: {}</i>"
            "<br><code>{}</code></details>"
        ).format(lead, caption, module.PAPER, f"{command} --figure {name}")
        blocks.append(PageFigure.of(draw(results, name), f"Figure {module.NUMBER}. {module.TITLE}", html))
        captions.append((name, [lead, caption, f"Paper: {module.PAPER}"]))
    made = tables.all_tables(results)
    for number, table in enumerate(made, 1):
        text = pd.DataFrame(list(table.rows), columns=list(table.heads)).to_csv(index=False)
        write_atomically(results.output / "tables" / f"table{number}.csv", text)
    summary = findings.summary(results)
    contradictions = findings.contradictions(results)
    lists = {
        "Other observations": findings.observations(results),
        "A hop as the missing effect: a conjecture": findings.conjecture(results),
        "Measurements that would decide": findings.decisive_measurements(results),
    }
    sections = [
        PageSection("Figures", blocks),
        PageSection(
            "Three contradictions in the paper",
            [Markup("<p><b>{}.</b> {}</p>").format(title, text) for title, text in contradictions.items()],
        ),
        *(PageSection(title, [PageList(lines, ordered=True)]) for title, lines in lists.items()),
        PageSection("Tables", made),
    ]
    quick = (
        "Quick run: a fifth of the clips and a few models, as a check that everything works. Do not use these numbers."
    )
    path = write_page(
        results.output / "index.html", TITLE, sections, command, summary, [quick] if results.quick else []
    )
    texts = {"Three contradictions in the paper": [f"{t}. {text}" for t, text in contradictions.items()], **lists}
    with mpl.rc_context(RC):
        pictures = [(lines, draw(results, name)) for name, lines in captions]
        pdf.write(results.output / "paper.pdf", TITLE, summary, pictures, texts, made)
    return path
