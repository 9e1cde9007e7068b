"""Spin transfer from the spins, ball by ball, with and without a hop."""

from __future__ import annotations

from matplotlib.figure import Figure

from benchmarks.paper import style
from benchmarks.paper.results import Results

NUMBER, TITLE = "A2", "Spin transfer from the spins"
SHOWS = (
    "Read late, C falls for the struck ball and rises for the striker; their mean stays at its true value, "
    "unless something takes momentum during the hit."
)
NEEDS = ("histogram", "speeds", "spins", "slow")
MODELS = True  # needs the comparison of models
PAPER = "Not in the paper, which gives C = 0.25 +- 0.02 from the spins and 0.347 +- 0.008 from the fit."
PARTS = (
    ("C_target", "struck ball", "o", style.TARGET),
    ("C_striker", "striker", "s", style.STRIKER),
    ("C_both", "mean of both", "D", "0.1"),
)


def caption(results: Results) -> str:
    said = []
    for model, word in (("base", "(a)"), ("hop", "(b)")):
        table = results.readings(model)["spins"]
        said.append(f"{word} " + ", ".join(f"{table[f'{n} 4 ms'].mean():.3f} {w}" for n, w, _, _ in PARTS))
    return (
        "C of each collision from the spins just after the hit: -w1/w0 of the struck ball, 1 - w2/w0 of the striker,"
        " and the mean of the two. As in the paper, the spins follow from the velocity after the hit (here 4 ms after"
        f" it) and the final one. {results.count('spins')} collisions, {2 * results.count('spins')} balls. (a) The"
        " paper's model, (b) with a hop. Means:"
        f" {'; '.join(said)}. Bands: the paper's two values. Reading late shifts the two balls apart and leaves their"
        " mean; the hop lowers the mean."
    )


def draw(results: Results) -> Figure:
    figure, axes = style.panels(1, 2, height=3.2, sharey=True)
    for panel, model, word in zip(axes, ("base", "hop"), ("(a) the paper's model", "(b) with a hop"), strict=True):
        table = results.readings(model)["spins"]
        panel.axhspan(0.339, 0.355, color="0.8", zorder=0, label="paper, fit")
        panel.axhspan(0.23, 0.27, color="0.9", zorder=0, label="paper, spins")
        for name, what, mark, colour in PARTS:
            panel.plot(
                table["v0"] * 100, table[f"{name} 4 ms"], mark, color=colour, label=what, **(style.POINT | {"ms": 3.6})
            )
        panel.set(xlabel="$v_0$ / (cm/s)", xlim=(8, 62), ylim=(-0.05, 0.65))
        style.letter(panel, word)
    axes[0].set_ylabel("$C$ from the spins")
    style.legend(axes[1], loc="upper right", ncols=2)
    return figure
