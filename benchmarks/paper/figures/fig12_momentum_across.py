"""Momentum of each ball across its own slip direction."""

from __future__ import annotations

from matplotlib.figure import Figure

from benchmarks.paper.figures import fig11_momentum_along
from benchmarks.paper.results import Results

NUMBER, TITLE = "12", "Momentum across the slip"
SHOWS = "Across the direction of slip, only the hit changes the momentum."
NEEDS = ("slow", "fast")
PAPER = (
    "Momentum perpendicular to x vs. time, (a) the initially stationary, (b) the initially moving particle; very little"
    " momentum transfer takes place in this direction after the collision."
)


def caption(results: Results) -> str:
    return (
        "As figure 11, across each ball's own direction of slip (positive to the left of it): (a) the struck ball, (b)"
        " the striker; left 10 cm/s, right 37 cm/s. The hit (dotted) changes it; sliding does not, for friction acts"
        " along the slip alone. Dashed: the end of the slide."
    )


def draw(results: Results) -> Figure:
    return fig11_momentum_along.draw(results, across=True)
