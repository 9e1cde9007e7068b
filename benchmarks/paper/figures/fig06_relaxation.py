"""Relaxation times against the speed of impact."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from benchmarks.paper import kondic, style
from benchmarks.paper.results import Results

NUMBER, TITLE = "6", "Relaxation times"
NEEDS = ("speeds",)
PAPER = (
    "Relaxation time vs. impact velocity; solid lines: predictions from the fit. Without surface interactions tau is 0."
)


def caption(results: Results) -> str:
    fitted = results.fitted
    return (
        "Time from the hit to the end of sliding against the striker's speed, of 28 filmed collisions nearly head-on:"
        " the corner of each ball's velocity against time. Lines: the model with the paper's numbers (r = 0.903, mu_k"
        f" = 0.232, C = 0.347). A fit of these data as the paper makes it gives mu_k = {fitted.laws.mu:.4f} +-"
        f" {fitted.errors.mu:.4f}. Star: the 0.06 s at 10 cm/s of the paper's text and captions, which lies off its own"
        " line by 44 ms for the struck ball, 52 ms for the striker. Grey: the range of 0.05 to 0.1 s that it calls"
        " typical, which the struck balls reach from 31 cm/s on."
    )


def draw(results: Results) -> Figure:
    figure, axes = style.panels(height=3.4)
    speeds, v = results.read("speeds"), np.array([0.0, 0.65])
    lines = kondic.head_on(v)
    axes.axhspan(50, 100, color="0.94", zorder=0)
    for ball, word in ((1, "struck ball, $\\tau_1$"), (2, "striker, $\\tau_2$")):
        axes.plot(
            speeds["v0"] * 100,
            speeds[f"tau{ball}"] * 1e3,
            style.MARK[ball],
            color=style.COLOUR[ball],
            label=word,
            **style.POINT,
        )
        axes.plot(v * 100, lines[:, ball + 1] * 1e3, "-", color=style.COLOUR[ball], lw=1.1)
    axes.plot(10, 60, "*", color="k", ms=10, label="paper's text: .06 s at 10 cm/s")
    axes.set(xlabel="$v_0$ / (cm/s)", ylabel="relaxation time / ms", xlim=(0, 65), ylim=(0, 110))
    style.legend(axes, loc="upper left")
    return figure
