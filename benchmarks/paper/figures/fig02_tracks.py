"""Tracks of the two balls, with the collision enlarged."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from benchmarks.paper import style
from benchmarks.paper.results import Results

NUMBER, TITLE = "2", "Tracks"
SHOWS = "The tracks bend after the hit, because the balls slide on the plate before they roll."
NEEDS = ("slow", "fast")
PAPER = (
    "Tracks of two particles colliding: one enters from the left with v = 10 cm/s and strikes a stationary one; both"
    " exit to the right. Circles every 0.02 s; inset: near the collision, with a particle diameter for scale."
)
EVERY = 5  # frames: .02 s


def caption(results: Results) -> str:
    slow, fast = results.course("slow"), results.course("fast")
    return (
        "Tracks of two balls that collide; the striker enters from the left. (a) As captioned in the paper: v0 ="
        f" {slow.v0 * 100:.1f} cm/s, b/2R = {slow.read['b']:.3f} (5.5 degrees). (b) v0 = {fast.v0 * 100:.1f} cm/s, b/2R"
        f" = .25 ({fast.read['b']:.2f} by the frame of least separation, as the paper takes it). At this speed a"
        " slide takes the 0.06 s that the paper gives for its figure. Circles:"
        " every 0.02 s. Right: near the collision, every frame; the bar is a ball's diameter, 2.38 mm. In (a) the"
        " tracks bend within a diameter of the hit, in (b) over centimetres."
    )


def draw(results: Results) -> Figure:
    figure, axes = style.panels(2, 2, height=4.9, width_ratios=[2.2, 1])
    for row, (name, word) in enumerate((("slow", "(a) 10 cm/s"), ("fast", "(b) 37 cm/s"))):
        course = results.course(name)
        k = int(course.read["k"])
        origin = course.position[0, k]
        wide, close = axes[row]
        for ball in (2, 1):
            path = (course.position[ball - 1] - origin) * 1e3
            label = {1: "struck ball", 2: "striker"}[ball]
            wide.plot(*path.T, "-", color=style.COLOUR[ball], lw=0.7)
            wide.plot(*path[::EVERY].T, "o", color=style.COLOUR[ball], label=label, **style.POINT)
            close.plot(*path.T, "o-", color=style.COLOUR[ball], ms=3, mfc="white", lw=0.7)
            close.add_patch(Circle(tuple(path[k]), 1.19, fill=False, ec=style.COLOUR[ball], lw=0.8))
        close.plot([0.6, 0.6 + 2.38], [-3.1, -3.1], "k-", lw=2)
        close.annotate("2.38 mm", (0.6 + 1.19, -3.0), ha="center", va="bottom", fontsize=7)
        close.set(xlim=(-4.5, 4.5), ylim=(-3.6, 3.6), aspect="equal")
        reach = np.nanmax(np.abs((course.position[..., 1] - origin[1]) * 1e3)) + 3
        wide.set(xlabel="x / mm", ylabel="y / mm", ylim=(-max(reach, 6), max(reach, 6)))
        close.set(xlabel="x / mm")
        style.letter(wide, word)
        style.legend(wide, loc="upper left")
    return figure
