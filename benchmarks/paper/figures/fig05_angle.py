"""Angle between the velocities of the two balls against time."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from benchmarks.paper import kondic, style
from benchmarks.paper.results import Floats, Results

NUMBER, TITLE = "5", "Angle between the velocities"
SHOWS = "A hit at 5.5 degrees does not separate the balls at nearly 90 degrees; b/2R = 0.25 comes near."
NEEDS = ("slow", "fast")
PAPER = (
    "Angle between particle velocities; the collision at t = 0.06 s, dashed, where the particles move at nearly 90"
    " degrees to each other. The angle between the incoming velocity and n is 5.5 degrees. Oscillations are noise."
)


def caption(results: Results) -> str:
    slow, fast = (results.course(name).read for name in ("slow", "fast"))
    return (
        "Angle between the velocities of the two balls, each from neighbouring frames, from the hit (dashed) on;"
        " before it one ball rests. (a) 10 cm/s, b/2R = .096, which is the caption's 5.5 degrees; (b) 37 cm/s, b/2R ="
        " .25, the paper's typical value. Thick bars: the paper's formula for the angle just after the hit,"
        f" {np.degrees(kondic.paper_angle(np.array([0.096])))[0]:.0f} and"
        f" {np.degrees(kondic.paper_angle(np.array([0.25])))[0]:.0f} degrees. First values read:"
        f" {np.degrees(slow['angle 4 ms']):.0f} and {np.degrees(fast['angle 4 ms']):.0f} degrees. 'Nearly 90 degrees'"
        " is what (b) comes near, not a hit at 5.5 degrees. Dotted: the model's angle once both roll."
    )


def between(velocity: Floats) -> Floats:
    """Degrees, of velocities (2, frames, 2)."""
    one, two = velocity
    cross = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    return np.asarray(np.degrees(np.arctan2(np.abs(cross), (one * two).sum(axis=1))))


def draw(results: Results) -> Figure:
    figure, axes = style.panels(1, 2, height=3.0, sharey=True)
    for panel, name, b in zip(axes, ("slow", "fast"), (0.096, 0.25), strict=True):
        course = results.course(name)
        late = course.time > course.contact + 0.002
        panel.plot(
            course.time[late], between(course.velocity)[late], "o-", color=style.STRIKER, ms=3, mfc="white", lw=0.7
        )
        panel.axvline(course.contact, color=style.MODEL, ls="--", lw=1)
        first = float(np.degrees(kondic.paper_angle(np.array([b])))[0])
        panel.plot(
            [course.contact - 0.008, course.contact + 0.008],
            [first] * 2,
            "-",
            color=style.TARGET,
            lw=3,
            label=f"paper's formula: {first:.0f}$^\\circ$",
        )
        last = float(np.degrees(kondic.angle(kondic.final(np.array([b]))))[0])
        panel.axhline(last, color=style.MODEL, ls=":", lw=1, label=f"rolling: {last:.0f}$^\\circ$")
        panel.axhline(90, color=style.FAINT, lw=0.7)
        panel.set(xlabel="time / s", xlim=(0, 0.3), ylim=(0, 100))
        style.legend(panel)
        style.letter(panel, f"({'ab'[name == 'fast']}) {course.v0 * 100:.0f} cm/s, b/2R = {b:g}")
    axes[0].set_ylabel("angle / degrees")
    return figure
