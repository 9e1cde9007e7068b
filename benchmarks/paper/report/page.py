"""The page of the reproduced paper: one HTML file and one PDF, figures as vectors; each figure and table as a file."""

from __future__ import annotations

import importlib
import pkgutil
from pathlib import Path
from types import ModuleType
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from benchmarks.paper.report import pdf, said, tables
from benchmarks.paper.results import Results
from synthcam_shared.outputs import write_atomically
from synthcam_shared.report.page import embed_figure, render

HERE = Path(__file__).parent
FIGURES = HERE.parent / "figures"
COMMAND = "python -m benchmarks.paper.make"
RC: Any = {"font.size": 9, "axes.linewidth": 0.8, "svg.fonttype": "path", "pdf.fonttype": 42}


def figures() -> list[str]:
    """Names of all figures, found by their files, in their order."""
    return sorted(info.name for info in pkgutil.iter_modules([str(FIGURES)]))


def _module(name: str) -> ModuleType:
    return importlib.import_module(f"benchmarks.paper.figures.{name}")


def needs(name: str) -> tuple[str, ...]:
    """The series that a figure is drawn from."""
    series: tuple[str, ...] = _module(name).NEEDS
    return series


def compares(name: str) -> bool:
    """Whether a figure needs the comparison of models."""
    return bool(getattr(_module(name), "MODELS", False))


def drawn(results: Results, name: str) -> Figure:
    """One figure."""
    with mpl.rc_context(RC):
        figure: Figure = _module(name).draw(results)
    return figure


def one_figure(results: Results, name: str) -> Path:
    """Remake one figure: NAME.svg, NAME.png and its caption, NAME.txt, under figures/."""
    folder = results.output / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    figure = drawn(results, name)
    with mpl.rc_context(RC):
        for kind in ("svg", "png"):
            figure.savefig(folder / f"{name}.{kind}", dpi=150)
    write_atomically(folder / f"{name}.txt", _module(name).caption(results) + "\n")
    return folder / f"{name}.svg"


def write(results: Results) -> Path:
    """index.html, paper.pdf, figures/ and tables/ in the output folder; where the page is."""
    shown, command = [], COMMAND + (" --quick" if results.quick else "")
    for name in figures():
        one_figure(results, name)
        module = _module(name)
        shown.append({
            "name": name,
            "number": module.NUMBER,
            "title": module.TITLE,
            "paper": module.PAPER,
            "caption": module.caption(results),
            "command": f"{command} --figure {name}",
            "address": embed_figure(drawn(results, name)),
        })  # fmt: skip
    found = tables.all_tables(results)
    (results.output / "tables").mkdir(exist_ok=True)
    for table in found:
        write_atomically(
            results.output / "tables" / f"table{table.number}.csv", tables.frame(table).to_csv(index=False)
        )
    words = {
        "outcome": said.outcome(results),
        "shown": said.shown(results),
        "conjecture": said.conjecture(results),
        "decide": said.decide(results),
    }
    page = render(HERE / "page.html", figures=shown, tables=found, made=command, quick=results.quick, **words)
    write_atomically(results.output / "index.html", page)
    with mpl.rc_context(RC):
        pdf.write(results.output / "paper.pdf", words, found, [(s, drawn(results, s["name"])) for s in shown])
    return results.output / "index.html"
