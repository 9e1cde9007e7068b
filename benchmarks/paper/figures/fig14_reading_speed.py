"""Restitution by differences against speed, read at three instants, with and without a hop."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from benchmarks.paper import style
from benchmarks.paper.kondic import GRAVITY, PUBLISHED
from benchmarks.paper.readings import WINDOWS
from benchmarks.paper.results import Floats, Results

NUMBER, TITLE = "A1", "Restitution read too late"
SHOWS = "The later restitution is read after the hit, the lower it is, most of all for slow balls."
NEEDS = ("histogram", "speeds", "spins", "slow")
MODELS = True  # needs the comparison of models
PAPER = "Not in the paper, which says of these readings: 'no obvious dependence on the velocity of incoming particle'."


def closed_form(v0: Floats, late: float) -> Floats:
    """r - 2 mu g t / v0, while both balls slide: what a reading t after a head-on hit shows."""
    return np.asarray(PUBLISHED.r - 2 * PUBLISHED.mu * GRAVITY * late / v0)


def caption(results: Results) -> str:
    slopes = []
    for model, word in (("base", "without"), ("hop", "with")):
        table = results.readings(model)["histogram"]
        slopes.append(f"{np.polyfit(table['v0'], table['r 4 ms'], 1)[0]:.2f} {word} a hop")
    return (
        "Restitution by differences against the striker's speed, of the collisions of figure 4, read 4, 6 and 8 ms"
        " after the hit. (a) The paper's model, (b) the same with a hop, in the fit of table 4. Lines: r - 2 mu g t/v0"
        " of the paper's numbers, which a reading t after a head-on hit gives while both balls slide. Band: the"
        " paper's mean with its error, .85 +- .02, its scatter of .11 in lighter grey. Slopes at 4 ms:"
        f" {', '.join(slopes)}, per m/s; a scatter of .11 in 28 collisions leaves .14 open."
    )


def draw(results: Results) -> Figure:
    figure, axes = style.panels(1, 2, height=3.2, sharey=True)
    v = np.linspace(0.09, 0.62, 200)
    for panel, model, word in zip(axes, ("base", "hop"), ("(a) the paper's model", "(b) with a hop"), strict=True):
        table = results.readings(model)["histogram"]
        panel.axhspan(0.74, 0.96, color="0.95", zorder=0)
        panel.axhspan(0.83, 0.87, color="0.85", zorder=0, label="paper")
        panel.axhline(PUBLISHED.r, color="k", lw=0.8)
        for (name, late), colour in zip(
            zip(WINDOWS, (0.004, 0.006, 0.008), strict=True), (style.HOP, style.STRIKER, style.TARGET), strict=True
        ):
            panel.plot(
                table["v0"] * 100, table[f"r {name}"], "o", color=colour, label=name, **(style.POINT | {"ms": 3.4})
            )
            panel.plot(v * 100, closed_form(v, late), "-", color=colour, lw=0.8)
        panel.set(xlabel="$v_0$ / (cm/s)", ylim=(0.45, 1.0), xlim=(8, 62))
        style.letter(panel, word)
    axes[0].set_ylabel("$r$ by differences")
    style.legend(axes[0], loc="lower right")
    return figure
