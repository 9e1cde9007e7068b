"""Momentum of each ball along its own slip direction."""

from __future__ import annotations

from matplotlib.figure import Figure

from benchmarks.paper import style
from benchmarks.paper.results import Floats, Results

NUMBER, TITLE = "11", "Momentum along the slip"
SHOWS = "After the hit the struck ball loses momentum to the plate, and the striker gains some through its spin."
NEEDS = ("slow", "fast")
PAPER = (
    "Momentum parallel to x vs. time, for (a) the initially stationary particle and (b) the initially moving particle"
    " (x is different for each); collision at 0.06 s, dotted. A large part is transferred at the collision; v_x2"
    " increases after it as a result of its spin."
)
SLOW_FAST = ("slow", "fast")


def caption(results: Results) -> str:
    return (
        "Momentum over that of the striker before the hit: (a) the struck ball, (b) the striker. It is along the"
        " direction in which that ball's velocity changes by sliding, so turned that the striker's first motion counts"
        " as positive. Left 10 cm/s, right 37 cm/s. Dotted: the hit. The struck ball loses momentum to the plate. The"
        " striker gains, because it still spins as it rolled. Then both lose slowly, by rolling."
        " Thin: the level at the end of the slide."
    )


def component(results: Results, name: str, ball: int, across: bool) -> tuple[Floats, Floats]:
    """Time and momentum of a ball along its slip, or across it, over the striker's."""
    course = results.course(name)
    along = course.slide[ball - 1]
    unit = (-along[1], along[0]) if across else along
    return course.time, course.velocity[ball - 1] @ unit / course.v0


def draw(results: Results, across: bool = False) -> Figure:
    figure, axes = style.panels(2, 2, height=4.4, sharex=True, sharey=across)
    for column, name in enumerate(SLOW_FAST):
        course = results.course(name)
        for row, ball in enumerate((1, 2)):
            panel = axes[row, column]
            time, value = component(results, name, ball, across)
            panel.plot(time, value, "o-", color=style.COLOUR[ball], ms=2.8, mfc="white", lw=0.7)
            along = course.slide[ball - 1]
            unit = (-along[1], along[0]) if across else along
            end = (course.read["k"] + 250 * course.read[f"tau{ball}"]) / 250
            panel.hlines(course.ends.velocity[ball - 1, 0] @ unit / course.v0, end, 0.3, color=style.MODEL, lw=0.8)
            panel.axvline(course.contact, color=style.MODEL, ls=":", lw=1)
            panel.axvline(end, color=style.COLOUR[ball], ls="--", lw=0.8)
            panel.set(xlim=(0, 0.3))
            style.letter(panel, f"({'ab'[row]}) {('struck ball', 'striker')[row]}, {course.v0 * 100:.0f} cm/s")
            if column == 0:
                panel.set_ylabel(f"$p_{'y' if across else 'x'}\\,/\\,m v_0$")
            if row == 1:
                panel.set_xlabel("time / s")
    return figure
