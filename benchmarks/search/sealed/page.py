"""One page of all boxes opened: goals, confusion, power, pairs, outsiders, the gap, coverage, time."""

from __future__ import annotations

import collections
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm

from synthcam.library import library
from synthcam_shared.report.page import PageFigure

from .boxes import FOREIGN, UNDRAWN
from .goals import goals, share, with_gap
from .judge import INADEQUATE, NAMES, OUTSIDE, STRANGE, WIDEST, Row, judge
from .ledger import lines

BLUE, RED, GREY = "#2166ac", "#b2182b", "#4d4d4d"
STYLE: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False}
EDGES = np.array([0.85, 1.2, 1.7, 2.4, 3.4, 4.8, 6.8, 9.6, 13.6, 20.01])  # of ratios
CLAIM = 4.0
OPEN = (-0.1, 0.4)  # shown of 1 - closure
MARKER = 70.0  # pt^2, the largest


def results(folder: Path) -> list[Path]:
    """The files of opened boxes, one for each study in a folder."""
    return sorted(p for p in folder.glob("*.jsonl") if not p.name.endswith(".ledger.jsonl"))


def rows_in(folder: Path) -> list[Row]:
    """All opened boxes of all studies in a folder."""
    return [judge(line) for path in results(folder) for line in lines(path)]


def write(folder: Path, rows: Sequence[Row] | None = None) -> Path:
    """Write index.html of these boxes, or of those that lie beside it; its path."""
    rows = rows_in(folder) if rows is None else rows
    with plt.rc_context(STYLE):
        figures = [PageFigure.of(figure, title, note) for title, figure, note in _figures(rows)]
        plt.close("all")
    template = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined).from_string(
        (Path(__file__).parent / "page.html").read_text(encoding="utf-8")
    )
    boxes = collections.Counter((r.study, r.kind) for r in rows)
    table = [(s, *(boxes[s, k] for k in NAMES)) for s in dict.fromkeys(r.study for r in rows)]
    path = folder / "index.html"
    text = template.render(
        goals=goals(rows),
        figures=figures,
        studies=table,
        kinds=NAMES,
        wrong=_wrong(rows),
        outsiders={kind: outsiders(rows, kind) for kind in STRANGE},
        drawn=drawn(rows),
        undrawn=UNDRAWN,
        widest=WIDEST,
        boxes=len(rows),
        codes=collections.Counter(r.code for r in rows).most_common(),
        failed=[r for r in rows if not r.worked],
    )
    path.write_text(text, encoding="utf-8")
    return path


def _figures(rows: Sequence[Row]) -> list[tuple[str, Figure, str]]:
    worked = [r for r in rows if r.worked]
    if not worked:
        return []
    out = [("What was called what", _confusion(worked), "Boxes of one hidden effect, of none, pairs and outsiders.")]
    if any(r.ratio for r in worked):
        out.append(
            ("Power", _power(worked), "Shares with binomial errors; dashed: what z = 5 x ratio promises at 4 sigma.")
        )
        out.append(("Names", _names(worked), "One hidden effect: right name and right class."))
    if with_gap(worked):
        out.append(
            (
                "The gap on clips kept out",
                _gaps(worked),
                "All in which something was found; the oracle is the true model.",
            )
        )
    if any(r.z for r in worked):
        out.append(
            ("Strengths", _coverage(worked), "Errors of rightly named strengths over their claimed standard deviation.")
        )
    if any(math.isfinite(r.cpu) for r in worked):
        out.append(("Time", _time(worked), "CPU of the search on one core, reading aside."))
    return out


def _called(r: Row) -> str:
    if not r.called:
        return "none"
    for word in (OUTSIDE, INADEQUATE):
        if word in r.called:
            return word
    if len(r.called) > 1:
        return "right pair" if r.name else "several"
    return r.called[0]


def _hidden(r: Row) -> str:
    if r.kind == "hostile":
        return " + ".join([r.world.replace("_", " "), *(["an effect"] if set(r.hidden) - set(FOREIGN) else [])])
    if r.kind in ("none", "defect"):
        return "nothing" if r.kind == "none" else "a tracker's defect"
    return "a pair" if r.kind == "two" else r.hidden[0]


def _confusion(rows: Sequence[Row]) -> Figure:
    counts = collections.Counter((_hidden(r), _called(r)) for r in rows)
    first = ["nothing", "a tracker's defect", "a pair"]
    left = [h for h in first if any(c[0] == h for c in counts)]
    left += sorted({h for h, _ in counts} - set(first) - set(FOREIGN))
    left += sorted({h for h, _ in counts} & set(FOREIGN))
    last = ["right pair", "several", INADEQUATE, OUTSIDE]
    top = ["none", *sorted({c for _, c in counts} - {"none", *last}), *last]
    grid = np.array([[counts[h, c] for c in top] for h in left], dtype=float)
    shares = grid / np.maximum(grid.sum(axis=1, keepdims=True), 1)
    figure, ax = plt.subplots(figsize=(2.5 + 0.32 * len(top), 1.5 + 0.26 * len(left)), constrained_layout=True)
    ax.imshow(shares, cmap="Blues", vmin=0, vmax=1.3, aspect="auto")
    for i, j in zip(*np.nonzero(grid), strict=True):
        ax.text(j, i, f"{grid[i, j]:.0f}", ha="center", va="center", fontsize=7)
    ax.set_xticks(range(len(top)), top, rotation=90)
    ax.set_yticks(range(len(left)), left)
    ax.set(xlabel="called", ylabel="hidden")
    ax.spines[:].set_visible(False)
    return figure


def _curve(ax: Any, points: Sequence[tuple[float, bool]], label: str, colour: str, marker: str = "o") -> None:
    """Shares of hits in bins of the ratio, no line between them: a marker is as large as its bin is full."""
    x, y, e, full = [], [], [], []
    for low, high in zip(EDGES[:-1] * 0.999, EDGES[1:] * 0.999, strict=True):
        inside = [(r, h) for r, h in points if low <= r < high]
        if inside:
            p, error = share([h for _, h in inside])
            x.append(float(np.exp(np.mean(np.log([r for r, _ in inside])))))
            y.append(100 * p)
            e.append(100 * error)
            full.append(6.0 + 2.0 * len(inside))
    ax.errorbar(x, y, e, fmt="none", lw=1, color=colour, alpha=0.6)
    ax.scatter(x, y, np.minimum(full, MARKER), color=colour, marker=marker, alpha=0.8, label=f"{label} ({len(points)})")


def _axes(axes: Any, titles: Sequence[str]) -> None:
    for ax, title in zip(axes, titles, strict=True):
        ax.set(xscale="log", xlabel="strength over its limit", title=title, ylim=(0, 104))
        ax.set_xticks([1, 2, 5, 10, 20], ["1", "2", "5", "10", "20"])
        ax.minorticks_off()
        if ax.get_legend_handles_labels()[0]:
            ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2, fontsize=7)


def _power(rows: Sequence[Row]) -> Figure:
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.6), sharey=True, constrained_layout=True)
    for filmed, colour, label in ((False, BLUE, "tracks"), (True, RED, "video")):
        for ax, kind in zip(axes, ("one", "two", *STRANGE), strict=True):
            points = [(r.ratio, r.detected) for r in rows if r.kind == kind and r.filmed == filmed]
            if points:
                _curve(ax, points, f"detected, {label}", colour)
            if kind in STRANGE and points:
                said = [(r.ratio, r.declared) for r in rows if r.kind == kind and r.filmed == filmed]
                _curve(ax, said, f"declared, {label}", colour, "s")
    ratio = np.geomspace(1, 20, 100)
    axes[0].plot(ratio, 100 * norm.cdf(5 * ratio - CLAIM), "--", color=GREY, lw=1, label="promised")
    axes[0].set_ylabel("%")
    _axes(axes, ("one effect", "two, the weaker one's ratio", "outside the library", "ordinary faults"))
    return figure


def _names(rows: Sequence[Row]) -> Figure:
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), sharey=True, constrained_layout=True)
    for filmed, colour, label in ((False, BLUE, "tracks"), (True, RED, "video")):
        one = [r for r in rows if r.kind == "one" and r.filmed == filmed and r.detected]
        two = [r for r in rows if r.kind == "two" and r.filmed == filmed and r.detected]
        if one:
            _curve(axes[0], [(r.ratio, r.name) for r in one], f"name, {label}", colour)
            _curve(axes[0], [(r.ratio, r.right_class) for r in one], f"class, {label}", colour, "s")
            _curve(axes[1], [(r.naming, r.name) for r in one if r.naming >= 1], f"name, {label}", colour)
        if two:
            _curve(axes[2], [(r.ratio, r.name) for r in two], f"both names, {label}", colour)
            _curve(axes[2], [(r.ratio, r.right_class) for r in two], f"both classes, {label}", colour, "s")
    axes[0].set_ylabel("% of the detected")
    _axes(axes, ("against the detection limit", "against the naming limit", "pairs, the weaker one's ratio"))
    return figure


def _gaps(rows: Sequence[Row]) -> Figure:
    figure, axes = plt.subplots(1, 2, figsize=(8, 3), constrained_layout=True)
    for filmed, colour, label in ((False, BLUE, "tracks"), (True, RED, "video")):
        found = [r for r in with_gap(rows) if r.filmed == filmed]
        if found:
            left = np.clip([1 - r.closure for r in found], *OPEN)
            axes[0].plot([r.ratio for r in found], left, ".", color=colour, label=label)
            axes[1].hist([r.chi2_ratio for r in found], bins=np.linspace(0.97, 1.06, 40), color=colour, alpha=0.6)
    axes[0].set(xscale="log", xlabel="strength over its limit", ylabel="1 - closure (beyond: at the edge)", ylim=OPEN)
    axes[0].axhline(0.01, color=GREY, lw=1, ls="--", label="wanted")
    axes[0].legend()
    axes[1].set(xlabel="chi^2 of the augmented model over the oracle's", ylabel="boxes")
    return figure


def _coverage(rows: Sequence[Row]) -> Figure:
    figure, ax = plt.subplots(figsize=(5, 3), constrained_layout=True)
    for filmed, colour, label in ((False, BLUE, "tracks"), (True, RED, "video")):
        z = np.array([x for r in rows if r.filmed == filmed for x in r.z])
        if len(z):
            text = f"{label}: {len(z)}, sd {z.std():.2f}, {np.mean(abs(z) < 1):.0%}/{np.mean(abs(z) < 1.96):.0%}"
            ax.hist(
                np.clip(z, -5, 5),
                bins=np.linspace(-5, 5, 41).tolist(),
                density=True,
                color=colour,
                alpha=0.6,
                label=text,
            )
    x = np.linspace(-5, 5, 200)
    ax.plot(x, norm.pdf(x), color=GREY, lw=1)
    ax.set(xlabel="error over claimed standard deviation (beyond 5: at 5)", ylabel="density")
    ax.legend(fontsize=7)
    return figure


def _time(rows: Sequence[Row]) -> Figure:
    figure, ax = plt.subplots(figsize=(5, 3), constrained_layout=True)
    times = {k: [r.cpu for r in rows if r.kind == k and math.isfinite(r.cpu)] for k in NAMES}
    names = [k for k in NAMES if times[k]]
    ax.boxplot([times[k] for k in names], whis=(5, 95))
    ax.set_xticks(range(1, len(names) + 1), names)
    ax.axhline(60, color=GREY, lw=1, ls="--")
    ax.set(ylabel="CPU of a search (s)", yscale="log")
    return figure


def _wrong(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Boxes answered wrongly, for whoever wants to see why."""
    out = []
    for r in rows:
        good = r.right or r.right_class
        weak = r.kind in ("one", "two", *STRANGE) and r.ratio < 2 and not r.false
        if r.worked and not good and not weak:
            out.append({"row": r, "hidden": " + ".join(r.hidden) or r.kind, "called": " + ".join(r.called) or "none"})
    return out


def outsiders(rows: Sequence[Row], kind: str) -> list[dict[str, Any]]:
    """By outsider, from 2 x the limit: boxes, declared, right free law, curve in its band, called by a library name."""
    out = []
    for name in sorted({r.hidden[0] for r in rows if r.kind == kind}):
        own = [r for r in rows if r.worked and r.hidden == (name,) and r.ratio >= 1.9]
        if own:
            curves = [r.curve for r in own if r.curve is not None]
            told = sum(r.verdict == "inadequate" for r in own)
            out.append(
                {"name": name, "free_law": FOREIGN[name].FREE_LAW or "-", "n": len(own),
                 "declared": sum(r.declared for r in own),
                 "told": told, "right": sum(r.free_law for r in own), "library": sum(r.has_false_name for r in own),
                 "curve": f"{sum(curves)} of {len(curves)}" if curves else "-",
                 "nearest": f"{np.mean([r.nearest for r in own]):.2f}"}
            )  # fmt: skip
    return out


def drawn(rows: Sequence[Row]) -> list[tuple[str, int]]:
    """Each effect of the library and in how many boxes it was hidden."""
    counts = collections.Counter(n for r in rows for n in r.hidden)
    return [(n, counts[n]) for n in sorted(library()) if n not in UNDRAWN]
