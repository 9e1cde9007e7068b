"""Acceleration against velocity of single rolling balls."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from benchmarks.paper import style
from benchmarks.paper.results import Results

NUMBER, TITLE = "1", "Rolling loss"
SHOWS = "Rolling balls slow down by the paper's law: a part that is proportional to speed, and a constant part."
NEEDS = ("rolling",)
PAPER = (
    "Acceleration due to rolling friction for a single particle on a horizontal flat surface: measured values against"
    " velocity, best-fit line."
)


def caption(results: Results) -> str:
    found = results.rolling
    return (
        f"Acceleration of single balls that roll, against their speed: {len(found.speed)} values from"
        f" {results.count('rolling')} filmed balls. Each is the change of velocity between two stretches of 40 ms."
        " Solid: least-squares line, a = -C v - D"
        f" with C = {found.drag:.4f} +- {found.drag_error:.4f} /s and D = {found.decel * 100:.3f} +-"
        f" {found.decel_error * 100:.3f} cm/s^2. Dashed: the paper's line, C = 0.135 /s, D = 1.03 cm/s^2, which the"
        " films were made with. The cross marks the typical loss of the paper, 2.5 cm/s^2, which gives mu_r ="
        " 2.5e-3."
    )


def draw(results: Results) -> Figure:
    figure, axes = style.panels(height=3.2)
    found = results.rolling
    axes.plot(
        found.speed * 100, found.acceleration * 100, "o", color=style.STRIKER, label="filmed balls", **style.POINT
    )
    v = np.array([0.0, 26.0])
    axes.plot(v, -found.drag * v - found.decel * 100, "-", color=style.STRIKER, lw=1.1, label="line through them")
    axes.plot(v, -0.135 * v - 1.03, "--", color=style.MODEL, lw=1.1, label="paper: $-0.135\\,v-1.03$")
    axes.plot((2.5 - 1.03) / 0.135, -2.5, "x", color=style.TARGET, ms=8, mew=1.6, label="paper: typical")
    axes.set(xlabel="velocity / (cm/s)", ylabel="acceleration / (cm/s$^2$)", xlim=(0, 26))
    style.legend(axes)
    return figure
