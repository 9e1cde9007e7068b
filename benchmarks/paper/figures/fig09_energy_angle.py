"""Energy that is left against the angle between the final velocities."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from benchmarks.paper import kondic, style
from benchmarks.paper.results import Results

NUMBER, TITLE = "9", "Energy against the final angle"
SHOWS = (
    "The remaining energy depends on the final angle as the paper's model predicts; nearly head-on it is about 39 %."
)
NEEDS = ("angles", "histogram", "speeds")
PAPER = (
    "Energy loss vs. angle between final velocities; dashed: two particles without substrate, r = 0.903; solid:"
    " predictions with r=0.903, mu_k=0.232, C=0.347."
)
SERIES = (("angles", "30 cm/s", "o"), ("histogram", "10 to 60 cm/s", "s"))


def caption(results: Results) -> str:
    near = results.read("speeds")["energy"]
    return (
        "Share of the translational energy that is left once both balls roll, against the angle between their"
        " velocities then. Points: filmed collisions, at 30 cm/s with impact parameters up to .9, and those of"
        " figure 4. Solid: the model with the paper's numbers, extended to oblique hits with one C (its upper branch:"
        " grazing"
        f" hits). Dashed: without a plate, r = 0.903. Nearly head-on {near.mean():.3f} +- {near.std():.3f} is left"
        f" (mean and scatter of {len(near)}), by the model .386; the paper says about 37 %. The errors of single points"
        " are smaller than the symbols."
    )


def draw(results: Results) -> Figure:
    figure, axes = style.panels(height=3.4)
    b = np.sin(np.linspace(0, np.pi / 2, 400))[:-1]
    for label, velocity, line in (("model", kondic.final(b), "-"), ("no plate", kondic.free_space(b), "--")):
        axes.plot(
            np.degrees(kondic.angle(velocity)), kondic.energy(velocity), line, color=style.MODEL, lw=1.1, label=label
        )
    for (name, word, mark), colour in zip(SERIES, (style.STRIKER, style.TARGET), strict=True):
        table = results.read(name)
        axes.plot(np.degrees(table["final_angle"]), table["energy"], mark, color=colour, label=word, **style.POINT)
    axes.plot(0, 0.37, "*", color="k", ms=10, label="paper: 37 % head-on", clip_on=False)
    axes.set(
        xlabel="angle between final velocities / degrees", ylabel="energy left / initial", xlim=(0, 92), ylim=(0, 1.02)
    )
    style.legend(axes, loc="center right")
    return figure
