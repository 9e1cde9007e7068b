"""Separation of the balls against time."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from benchmarks.paper import style
from benchmarks.paper.results import Results

NUMBER, TITLE = "3", "Separation"
SHOWS = "The separation reaches its final slope 0.06 s after the hit at 37 cm/s, but several times sooner at 10 cm/s."
NEEDS = ("slow", "fast")
PAPER = "Separation s between the centers of the particles shown in Fig. 2 vs. time."


def caption(results: Results) -> str:
    slow, fast = (results.course(name).read for name in ("slow", "fast"))
    return (
        "Distance between the balls' centres against time, for the collisions of figure 2: (a) 10 cm/s, (b) 37 cm/s."
        " Dotted: the hit. Dashed: the ends of the slides, read as corners of the velocities (struck ball, striker):"
        f" after {slow['tau1'] * 1e3:.0f} and {slow['tau2'] * 1e3:.0f} ms in (a), {fast['tau1'] * 1e3:.0f} and"
        f" {fast['tau2'] * 1e3:.0f} ms in (b). Thin: the straight line of the last 60 ms,"
        " carried back. The paper reads 0.06 s from its figure, which (b) shows and (a) does not."
    )


def draw(results: Results) -> Figure:
    figure, axes = style.panels(1, 2, height=3.1)
    for panel, name, word in zip(axes, ("slow", "fast"), ("(a) 10 cm/s", "(b) 37 cm/s"), strict=True):
        course = results.course(name)
        apart = np.hypot(*(course.position[0] - course.position[1]).T) * 1e3
        known = np.flatnonzero(np.isfinite(apart))
        late = known[known >= known[-1] - 15]
        line = np.polyfit(course.time[late], apart[late], 1)
        panel.plot(course.time, apart, "o", color=style.STRIKER, **(style.POINT | {"ms": 3}))
        after = course.time[course.time > course.contact]
        panel.plot(after, np.polyval(line, after), "-", color=style.FAINT, lw=0.9)
        panel.axvline(course.contact, color=style.MODEL, ls=":", lw=1)
        for ball in (1, 2):
            end = (course.read["k"] + 250 * course.read[f"tau{ball}"]) / 250
            panel.axvline(
                end, color=style.COLOUR[ball], ls="--", lw=0.9, label=f"{('struck ball', 'striker')[ball - 1]} rolls"
            )
        panel.set(
            xlabel="time / s", ylabel="separation / mm", ylim=(0, None), xlim=(0, min(0.3, course.time[known[-1]]))
        )
        style.letter(panel, word)
        style.legend(panel, loc="lower right")
    return figure
