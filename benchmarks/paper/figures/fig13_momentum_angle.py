"""Momentum that is left against the angle between the final velocities."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from benchmarks.paper import kondic, style
from benchmarks.paper.figures.fig09_energy_angle import SERIES
from benchmarks.paper.results import Results

NUMBER, TITLE = "13", "Momentum against the final angle"
SHOWS = "Nearly head-on, 80 % of the momentum remains, which gives C near 0.35 whatever friction does after the hit."
NEEDS = ("angles", "histogram", "speeds")
PAPER = (
    "Momentum fraction remaining after relaxation in the direction of the initial momentum versus final angle; head-on"
    " about 20 % is lost; solid: prediction with the fitted parameters."
)


def caption(results: Results) -> str:
    near = results.read("speeds")["momentum"]
    return (
        "Share of the momentum along the striker's first direction that is left once both balls roll, against the"
        " angle between their velocities then. Points: filmed collisions as in figure 9; solid: the model with the"
        f" paper's numbers; dotted: without a plate all is left. Nearly head-on {near.mean():.3f} +- {near.std():.3f}"
        " is left, 1 - 4 C/7 by the model: this share alone gives C, whatever friction does later. The paper's 'about"
        " 20 % lost' is C = .35. The errors of single points are smaller than the symbols."
    )


def draw(results: Results) -> Figure:
    figure, axes = style.panels(height=3.2)
    b = np.sin(np.linspace(0, np.pi / 2, 400))[:-1]
    velocity = kondic.final(b)
    axes.plot(
        np.degrees(kondic.angle(velocity)), kondic.momentum(velocity, b), "-", color=style.MODEL, lw=1.1, label="model"
    )
    axes.axhline(1, color=style.MODEL, ls=":", lw=1, label="no plate")
    for (name, word, mark), colour in zip(SERIES, (style.STRIKER, style.TARGET), strict=True):
        table = results.read(name)
        axes.plot(np.degrees(table["final_angle"]), table["momentum"], mark, color=colour, label=word, **style.POINT)
    axes.plot(0, 0.8, "*", color="k", ms=10, label="paper: 80 % head-on", clip_on=False)
    axes.set(
        xlabel="angle between final velocities / degrees",
        ylabel="momentum left / initial",
        xlim=(0, 92),
        ylim=(0.75, 1.02),
    )
    style.legend(axes, loc="center right")
    return figure
