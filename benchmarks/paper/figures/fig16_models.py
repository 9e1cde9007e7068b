"""All candidate effects against the paper's numbers."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from benchmarks.paper import style
from benchmarks.paper.models import contradictions
from benchmarks.paper.results import Results

NUMBER, TITLE = "A3", "Candidate effects"
NEEDS = ()
MODELS = True  # needs the comparison of models
PAPER = "Not in the paper."
SHOWN = ("4 ms, both", "4 ms, target")
MOST = 16


def caption(results: Results) -> str:
    table = contradictions.best_of(results.scan)
    base = table.loc[table["name"] == "base"].iloc[0]
    return (
        "How well each effect of the library, alone and beside a hop, explains eleven numbers of the paper at once:"
        f" chi^2 of the best size tried, with r, C and mu fitted. {len(table)} models, the {MOST} likeliest and the"
        " base model shown. Filled: C from the spins of both balls; open: of struck balls alone, both read 4 ms after"
        f" the hit. Solved motions with the tracker's noise. The base model has {base[SHOWN[0]]:.0f} and"
        f" {base[SHOWN[1]]:.1f}. If the paper's 50 particles are both balls of 25 collisions, only models with a hop or"
        " unequal masses reach below 10."
    )


def draw(results: Results) -> Figure:
    table = contradictions.best_of(results.scan)
    keep = (table.index < MOST) | (table["name"] == "base")
    table = table[keep].iloc[::-1]
    figure, axes = style.panels(height=0.23 * len(table) + 1.0)
    rows = np.arange(len(table))
    axes.hlines(rows, 0, np.maximum(table[SHOWN[0]], table[SHOWN[1]]), color="0.88", lw=0.8)
    axes.plot(table[SHOWN[0]], rows, "o", color=style.STRIKER, ms=5, label="spins of both balls")
    axes.plot(
        table[SHOWN[1]], rows, "o", color=style.TARGET, label="spins of struck balls", **(style.POINT | {"ms": 5})
    )
    axes.axvline(8, color=style.MODEL, ls=":", lw=1, label="8: eleven numbers less r, C, mu")
    axes.set_yticks(rows, table["name"], fontsize=8)
    axes.set(xlabel="$\\chi^2$", xlim=(0, None))
    style.legend(axes, loc="lower right")
    return figure
