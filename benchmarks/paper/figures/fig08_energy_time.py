"""Energy of both balls against time."""

from __future__ import annotations

from matplotlib.figure import Figure

from benchmarks.paper import style
from benchmarks.paper.results import Results

NUMBER, TITLE = "8", "Energy in one collision"
SHOWS = "The impact takes about 9 % of the translational energy; sliding takes most of the rest of the loss."
NEEDS = ("slow", "fast")
PAPER = (
    "Total system energy versus time in a single collision; dotted: the collision; dashed: the final energy if the"
    " fractional loss was (1-r^2)/2."
)


def caption(results: Results) -> str:
    left = ", ".join(f"{results.course(n).read['energy']:.3f}" for n in ("slow", "fast"))
    return (
        "Translational energy of both balls over that of the striker before the hit: (a) 10 cm/s, b/2R = .096, "
        "(b) 37 cm/s, b/2R = .25. Velocities are differences of neighbouring frames. Dotted: the hit. Dashed: 1 - (1 - "
        "r^2)/2 = .908, what an impact with r = 0.903 alone would leave. Share that remains once both balls roll: "
        f"{left} in (a), (b). After the slides rolling takes a little more."
    )


def draw(results: Results) -> Figure:
    figure, axes = style.panels(1, 2, height=3.0, sharey=True)
    for panel, name, word in zip(axes, ("slow", "fast"), ("(a) 10 cm/s", "(b) 37 cm/s"), strict=True):
        course = results.course(name)
        both = (course.velocity**2).sum(axis=2) / course.v0**2
        panel.plot(course.time, both.sum(axis=0), "D-", color="0.1", ms=2.6, lw=0.7, label="both balls")
        for ball in (1, 2):
            panel.plot(
                course.time,
                both[ball - 1],
                "-",
                color=style.COLOUR[ball],
                lw=0.9,
                label=("struck ball", "striker")[ball - 1],
            )
        panel.axvline(course.contact, color=style.MODEL, ls=":", lw=1)
        panel.hlines(
            1 - (1 - 0.903**2) / 2, course.contact, 0.3, color=style.MODEL, ls="--", lw=1, label="$1-(1-r^2)/2$"
        )
        panel.set(xlabel="time / s", xlim=(0, 0.3), ylim=(0, 1.1))
        style.letter(panel, word)
    axes[0].set_ylabel("energy / initial energy")
    style.legend(axes[1], loc="upper right")
    return figure
