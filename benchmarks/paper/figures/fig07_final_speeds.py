"""Final speeds against the speed of impact."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from benchmarks.paper import kondic, style
from benchmarks.paper.results import Results

NUMBER, TITLE = "7", "Final speeds"
SHOWS = "The final speeds of both balls are proportional to the initial speed, as the paper's model predicts."
NEEDS = ("speeds",)
PAPER = (
    "Final velocity vs. initial velocity; solid lines: predictions from the fit; dotted: final velocities without"
    " surface interactions, r = 0.903."
)


def caption(results: Results) -> str:
    fitted = results.fitted
    return (
        "Speed of each ball as it begins to roll against the striker's speed before the hit,"
        f" {results.count('speeds')} filmed collisions nearly head-on. Errors are smaller than the symbols. Solid: the"
        " model with the paper's numbers, r = 0.903 +- 0.008, C = 0.347 +- 0.008. Tinted: these printed errors."
        " Dotted: without a plate, r = 0.903. The paper's"
        f" fit to the points of figures 6 and 7 gives r = {fitted.laws.r:.4f} +- {fitted.errors.r:.4f}, C ="
        f" {fitted.laws.C:.4f} +- {fitted.errors.C:.4f}. The films were made with 0.903 and 0.347. The difference"
        " comes from impact parameters up to 0.05, which the head-on equations ignore."
    )


def draw(results: Results) -> Figure:
    figure, axes = style.panels(height=3.4)
    speeds, v = results.read("speeds"), np.array([0.0, 0.65])
    lines, errors = kondic.head_on(v) * 100, kondic.head_on_errors(v) * 100
    alone = np.stack([(1 + 0.903) / 2 * v, (1 - 0.903) / 2 * v])
    for ball, word in ((1, "struck ball, $v_{1f}$"), (2, "striker, $v_{2f}$")):
        axes.plot(
            speeds["v0"] * 100,
            speeds[f"v{ball}f"] * 100,
            style.MARK[ball],
            color=style.COLOUR[ball],
            label=word,
            **style.POINT,
        )
        line, error = lines[:, ball - 1], errors[:, ball - 1]
        axes.plot(v * 100, line, "-", color=style.COLOUR[ball], lw=1.1)
        axes.fill_between(v * 100, line - error, line + error, color=style.COLOUR[ball], alpha=0.18, lw=0)
        axes.plot(v * 100, alone[ball - 1] * 100, ":", color=style.COLOUR[ball], lw=1.1)
    axes.plot([], [], "-", color=style.MODEL, label="model, paper's numbers")
    axes.plot([], [], ":", color=style.MODEL, label="no plate, $r = .903$")
    axes.set(xlabel="$v_0$ / (cm/s)", ylabel="final speed / (cm/s)", xlim=(0, 65), ylim=(0, None))
    style.legend(axes, loc="upper left")
    return figure
