"""Histogram of the restitution read immediately after the hit."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from benchmarks.paper import style
from benchmarks.paper.published import R_SCATTER
from benchmarks.paper.readings import WINDOWS
from benchmarks.paper.results import WINDOW, Results
from benchmarks.paper.shaken import add_error_for_scatter

NUMBER, TITLE = "4", "Restitution by differences"
SHOWS = (
    "Restitution from position differences is below its true value of 0.903, because sliding has already "
    "changed the velocities."
)
NEEDS = ("histogram",)
PAPER = "Histogram for the coefficient of restitution, as determined immediately following a collision, for 28 samples."


def caption(results: Results) -> str:
    table = results.read("histogram")
    said = ", ".join(f"{table[f'r {w}'].mean():.3f} +- {table[f'r {w}'].std():.3f} at {w}" for w in WINDOWS)
    error, shaken = add_error_for_scatter(results, R_SCATTER)
    return (
        f"Restitution of {len(table)} collisions by differences of positions within 0.01 s of the hit, the truth being"
        " r = 0.903"
        f" in all (solid line). (a) As our tracker gives the positions: mean and scatter {said} after the hit, the mean"
        " instant of the two frames that are differenced. Sliding has by then changed both velocities. (b) The same at"
        f" {WINDOW} with the positions worsened by {error * 1e6:.0f} um rms, which gives the paper's scatter of .11:"
        f" {shaken.mean():.3f} +- {shaken.std(ddof=1):.3f}. Dashed, shaded: the paper's 0.85 +- 0.11."
    )


def draw(results: Results) -> Figure:
    figure, axes = style.panels(1, 2, height=3.0, sharex=True)
    table, bins = results.read("histogram"), np.arange(0.475, 1.2, 0.05)
    for name, colour in zip(WINDOWS, ("0.75", style.STRIKER, style.TARGET), strict=True):
        axes[0].hist(table[f"r {name}"], bins, histtype="step", color=colour, lw=1.5, label=f"read at {name}")
    axes[1].hist(
        add_error_for_scatter(results, R_SCATTER)[1],
        bins,
        color=style.STRIKER,
        alpha=0.6,
        label=f"read at {WINDOW}, cruder positions",
    )
    for panel, word in zip(axes, ("(a) our tracker", "(b) with the paper's scatter"), strict=True):
        panel.axvspan(0.74, 0.96, color="0.93", zorder=0)
        panel.axvline(0.85, color=style.MODEL, ls="--", lw=1, label="paper: .85")
        panel.axvline(0.903, color="k", lw=1, label="truth: .903")
        panel.set(xlabel="coefficient of restitution", ylabel="collisions")
        panel.set_ylim(0, 1.45 * panel.get_ylim()[1])
        style.letter(panel, word)
        style.legend(panel, loc="upper left")
    return figure
