"""How the figures look: the colours and marks that all reports share, sizes for print, and lettering."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tracker.report.collision_figures import STYLE

TARGET, STRIKER = STYLE[1][0], STYLE[2][0]
COLOUR = {1: TARGET, 2: STRIKER}
MARK = {1: STYLE[1][1], 2: STYLE[2][1]}
MODEL, FAINT, HOP = "0.25", "0.6", "#4d9221"
POINT: dict[str, Any] = {"ms": 4.2, "mfc": "white", "ls": "none", "mew": 1.0}


def panels(rows: int = 1, columns: int = 1, height: float = 3.4, **more: Any) -> tuple[Figure, Any]:
    """A figure as wide as the page, and its axes."""
    figure = Figure(figsize=(7.4, height), layout="constrained")
    return figure, figure.subplots(rows, columns, **more)


def letter(axes: Axes, text: str) -> None:
    """A panel's title."""
    axes.set_title(text, fontsize=9, loc="left")


def legend(axes: Axes, **more: Any) -> None:
    """A small legend."""
    axes.legend(**({"fontsize": 7.5, "framealpha": 0.9} | more))
