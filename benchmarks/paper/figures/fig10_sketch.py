"""The sketch of a sliding ball's velocities."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from benchmarks.paper import style
from benchmarks.paper.results import Results

NUMBER, TITLE = "10", "Velocities of a sliding ball"
SHOWS = "Friction changes the velocity of a sliding ball only along the direction of its slip."
NEEDS = ("fast",)
PAPER = "Sketch of velocities for a sliding particle."


def caption(results: Results) -> str:
    read = results.course("fast").read
    return (
        "Velocities of a sliding ball. From the side, the struck ball just after the hit, to the right x, the "
        "direction of its slip. The contact velocity v_ct = v_cm + a x w is that of the lowest point; a points from "
        "there to the centre. Friction acts against it, so that the velocity changes along x alone. From above, to "
        f"scale: the striker that came with {read['v0'] * 100:.0f} cm/s, b/2R = .25. It shows the first velocity after "
        "the hit, the velocity of rolling, and the change between the two, against the contact velocity, x."
    )


def _arrow(
    axes: Axes,
    start: tuple[float, float],
    step: tuple[float, float],
    colour: str,
    word: str,
    shift: tuple[float, float],
) -> None:
    end = start[0] + step[0], start[1] + step[1]
    axes.annotate(
        "", end, start, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
    )
    axes.annotate(word, (end[0] + shift[0], end[1] + shift[1]), color=colour, fontsize=9, ha="center", va="center")


def draw(results: Results) -> Figure:
    figure, (side, above) = style.panels(1, 2, height=2.9)
    side.add_patch(Circle((0, 1), 1, fc="0.93", ec="0.3"))
    side.plot([-2, 3], [0, 0], "k-", lw=1)
    _arrow(side, (0, 1), (1.7, 0), style.STRIKER, "$v_{cm}$", (0.25, 0.0))
    _arrow(side, (0, 0), (2.3, 0), style.TARGET, "$v_{ct}$", (0.3, 0.14))
    _arrow(side, (0, 0.02), (0, 0.98), style.MODEL, "$a$", (-0.18, -0.45))
    _arrow(side, (0, -0.16), (-1.1, 0), "k", "friction", (-0.05, -0.2))
    turn = np.linspace(0.65 * np.pi, 0.25 * np.pi, 30)
    side.plot(1.2 * np.cos(turn), 1 + 1.2 * np.sin(turn), "-", color=style.HOP, lw=1.5)
    _arrow(
        side, (1.2 * np.cos(turn[1]), 1 + 1.2 * np.sin(turn[1])), (-0.1, -0.05), style.HOP, "$\\omega$", (-0.2, 0.12)
    )
    side.set(xlim=(-2, 3.1), ylim=(-0.6, 2.6), aspect="equal")
    side.axis("off")
    style.letter(side, "from the side")
    course = results.course("fast")
    k, end = int(course.read["k"]), course.ends.velocity[1, 0] * 100
    first = (course.position[1, k + 2] - course.position[1, k + 1]) * 250 * 100
    _arrow(above, (0, 0), tuple(first), style.STRIKER, "$v_{cm}$ after the hit", (-2.6, 0.6))
    _arrow(above, (0, 0), tuple(end), style.TARGET, "$v_{cm}$, rolling", (2.0, -0.7))
    _arrow(above, tuple(first), tuple(end - first), style.MODEL, "$\\Delta v_{cm}$", (-2.4, 1.1))
    _arrow(above, (0, 0), tuple(-3.5 * course.slide[1]), style.HOP, "$\\hat{x}$", (-0.5, 0.2))
    reach = float(np.abs([*first, *end]).max())
    above.set(
        xlim=(-5, reach + 4.5), ylim=(-2, reach + 1), aspect="equal", xlabel="$v_x$ / (cm/s)", ylabel="$v_y$ / (cm/s)"
    )
    style.letter(above, "from above, striker, measured")
    return figure
