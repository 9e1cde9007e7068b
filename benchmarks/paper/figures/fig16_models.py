"""All candidate effects against the paper's numbers."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from benchmarks.paper import style
from benchmarks.paper.models import contradictions
from benchmarks.paper.results import Results

NUMBER, TITLE = "A3", "Candidate effects"
SHOWS = (
    "If C = 0.25 is a mean over both balls, only models with a hop or with unequal balls agree with the "
    "paper's numbers."
)
NEEDS = ()
MODELS = True  # needs the comparison of models
PAPER = "Not in the paper."
SHOWN = ("4 ms, both", "4 ms, target")
PAIRS = 8


def chosen(results: Results) -> pd.DataFrame:
    """The models shown, in the order of the first way of reading: all single effects, the likeliest pairs."""
    table = contradictions.best_of(results.scan).sort_values(SHOWN[0], ignore_index=True)
    pair = table["name"].str.contains(" + ", regex=False)
    return table[~pair | (pair.cumsum() <= PAIRS)]


def caption(results: Results) -> str:
    table = contradictions.best_of(results.scan)
    base = table.loc[table["name"] == "base"].iloc[0]
    return (
        "How well each effect of the library, alone and with a hop, explains eleven numbers of the paper (table 5)."
        " chi^2 is that of the best size tried, with r, C and mu fitted. All single effects, and the"
        f" {PAIRS} likeliest of the pairs with a hop; {len(table)} models were tried. Filled: C from the spins of both"
        " balls; open: of struck balls alone; velocities read 4 ms after the hit. Solved motions with the tracker's"
        f" noise. The base model has {base[SHOWN[0]]:.0f} and {base[SHOWN[1]]:.1f}. If the paper's C is"
        " the mean over both balls of each collision, only models with a hop or unequal balls come under 20."
    )


def draw(results: Results) -> Figure:
    table = chosen(results).iloc[::-1]
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
    style.legend(axes, loc="upper right")
    return figure
