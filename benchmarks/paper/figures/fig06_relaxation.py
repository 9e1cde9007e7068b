"""Relaxation times against the speed of impact."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from benchmarks.paper import kondic, style
from benchmarks.paper.results import Results

NUMBER, TITLE = "6", "Relaxation times"
SHOWS = "The filmed sliding times follow the paper's own equations; the printed 0.06 s at 10 cm/s does not."
NEEDS = ("speeds",)
PAPER = (
    "Relaxation time vs. impact velocity; solid lines: predictions from the fit. Without surface interactions tau is 0."
)


def caption(results: Results) -> str:
    fitted, speeds = results.fitted, results.read("speeds")
    off = speeds[["tau1", "tau2"]].to_numpy() - kondic.head_on(speeds["v0"].to_numpy())[:, 2:]
    return (
        f"Time from the hit to the end of sliding against the striker's speed, of {len(speeds)} filmed collisions"
        " nearly head-on. A slide ends at the corner of the ball's velocity against time. Lines: the model with the"
        " paper's numbers (r = 0.903 +- 0.008, mu_k = 0.232 +- 0.023, C = 0.347 +- 0.008). Tinted: these printed"
        f" errors, taken as independent. The points scatter about the lines by {1e3 * np.nanstd(off):.1f} ms, less than"
        " a symbol's height. Slides under 11 ms cannot be read at 250 frames a second, so the strikers begin level."
        f" A fit of these data as the paper makes it gives mu_k = {fitted.laws.mu:.4f} +-"
        f" {fitted.errors.mu:.4f}. Star: the 0.06 s at 10 cm/s of the paper's text. It is off the"
        " line by 44 ms for the struck ball, 52 ms for the striker. Grey: the range of 0.05 to 0.1 s that it calls"
        " typical, which the struck balls reach from 31 cm/s on."
    )


def draw(results: Results) -> Figure:
    figure, axes = style.panels(height=3.4)
    speeds, v = results.read("speeds"), np.array([0.0, 0.65])
    lines, errors = kondic.head_on(v) * 1e3, kondic.head_on_errors(v) * 1e3
    axes.axhspan(50, 100, color="0.94", zorder=0, label="paper's text: .05 to .1 s, typical")
    for ball, word in ((1, "struck ball, $\\tau_1$"), (2, "striker, $\\tau_2$")):
        axes.plot(
            speeds["v0"] * 100,
            speeds[f"tau{ball}"] * 1e3,
            style.MARK[ball],
            color=style.COLOUR[ball],
            label=word,
            **style.POINT,
        )
        line, error = lines[:, ball + 1], errors[:, ball + 1]
        axes.plot(v * 100, line, "-", color=style.COLOUR[ball], lw=1.1)
        axes.fill_between(v * 100, line - error, line + error, color=style.COLOUR[ball], alpha=0.18, lw=0)
    axes.plot(10, 60, "*", color="k", ms=10, label="paper's text: .06 s at 10 cm/s")
    axes.set(xlabel="$v_0$ / (cm/s)", ylabel="relaxation time / ms", xlim=(0, 65), ylim=(0, 120))
    style.legend(axes, loc="upper left")
    return figure
