"""Figures of the benchmark page: errors by setting, errors against one property, published values, defects."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import NullFormatter

from synthcam_shared.report.page import make_axes
from tracker.benchmark.report.leaderboard import Entries, Entry
from tracker.benchmark.suite.definition import SuiteDefinition
from tracker.report.quantities import QUANTITIES

COLOURS = ("#14508c", "#c1440e", "#4d9221", "#7b3294", "#b8860b", "#008080", "#d6438a", "#555555", "#6b8e23", "#8b4513")
LIMIT_LINE: Any = {"color": "0.3", "lw": 0.8, "ls": ":"}
MIN_FOUND = 0.5  # share of balls found, less false detections, under which a part counts as lost
FIGURE_WIDTH_IN = 10.2
DEFECTS = {"locking": "locked to pixels", "glint": "glint taken for centre", "lost": "frames lost"}


def name_tracker(entry: Entry) -> str:
    """Name the tracker of an entry in the figures."""
    return str(entry["tracker"]["name"])


def label_tracker(entry: Entry) -> str:
    """Name a tracker in figures so that matplotlib shows it: "$" would begin a formula, "_" hide it in a legend."""
    name = name_tracker(entry).replace("$", r"\$")
    return f"\u200b{name}" if name.startswith("_") else name


def _style(k: int) -> dict[str, Any]:
    return {"color": COLOURS[k % len(COLOURS)], "marker": "osD^vP*X<>"[k % 10], "ms": 4, "lw": 1.2}


def draw_headline(entries: Entries, definition: SuiteDefinition, worst: float = 30.0) -> Figure:
    """Draw rmse over bound, a row for each tracker and a column for each setting; worst: has the darkest colour."""
    columns = definition.headline
    colours, norm = colormaps["RdYlGn_r"], LogNorm(1.0, worst)

    def cell_of(entry: Entry, part: str) -> tuple[str, Any, str]:
        text, value = make_cell(entry["parts"].get(part))
        dark = value is not None and not 1.4 < value < worst / 2
        colour = "#c9c9c9" if value is None else colours(norm(np.clip(value, 1.0, worst)))
        return text, colour, "white" if dark else "black"

    figure, axes = _draw_cells(entries, list(columns), cell_of, (1.25, 1.0), 0.755)
    for i, entry in enumerate(entries):
        score = entry["score"]
        axes.text(-0.85, i, f"{score:.0f}" if score is not None else "–", ha="center", va="center", weight="bold")
    axes.set(xlim=(-1.3, len(columns) - 0.5))
    axes.set_xticks([-0.85, *range(len(columns))], ["score", *columns.values()], rotation=35, ha="left", fontsize=9)
    return figure


def _draw_cells(
    entries: Entries,
    columns: Sequence[str],
    cell_of: Callable[[Entry, str], tuple[str, Any, str]],
    margins: tuple[float, float],
    width: float,
) -> tuple[Figure, Axes]:
    """Draw a table with a row for each tracker; margins: height without rows, and above them, in; width: a share.

    cell_of: text, colour and colour of the text for an entry and a column.
    """
    height = 0.42 * len(entries) + margins[0]
    figure = Figure(figsize=(FIGURE_WIDTH_IN, height))
    axes = figure.add_axes((0.2, 0.02, width, 1 - margins[1] / height))
    for i, entry in enumerate(entries):
        for j, column in enumerate(columns):
            text, colour, ink = cell_of(entry, column)
            axes.add_patch(Rectangle((j - 0.48, i - 0.46), 0.96, 0.92, color=colour))
            axes.text(j, i, text, ha="center", va="center", fontsize=8, color=ink)
    axes.set(ylim=(len(entries) - 0.5, -0.5))
    axes.set_yticks(range(len(entries)), [label_tracker(e) for e in entries], fontsize=9)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    return figure, axes


def make_cell(part: Mapping[str, Any] | None, reference_px: float = 0.05) -> tuple[str, float | None]:
    """Write a cell of the first figure of the benchmark: its text and colour; None where a part is lost or was not run.

    reference_px: error that counts as the limit where there is no bound.
    """
    if part is None:
        return "not run", None
    found, jaccard = part["found"] or 0.0, part["jaccard"] or 0.0
    if not part["n"] or jaccard < MIN_FOUND:
        false = part["false"] / max(part["n"] + part["missed"], 1)
        return (f"{false:.0f} false\na ball" if false > 1 - found else f"{100 * found:.0f} %\nfound"), None
    if part["ratio"] is None:
        value = part["rmse_px"] / reference_px
        text = f"{part['rmse_px']:.2g} px"
    else:
        value, text = part["ratio"], f"{part['ratio']:.3g}" if part["ratio"] < 10 else f"{part['ratio']:.0f}"
    return (f"{text}\n{100 * found:.0f} %" if found < 0.99 else text), value


def draw_errors_by_setting(entries: Entries, definition: SuiteDefinition) -> Figure:
    """Draw the figure of errors against each axis of the suite, the gap between balls, and the pixel's phase."""
    axes = list(definition.axes())
    near = [e for e in entries if e["gap"]]
    phases = [name for name in definition.parts_of("phase") if any(e["phase"].get(name) for e in entries)]
    count = len(axes) + bool(near) + len(phases)
    rows = -(-count // 3)
    figure, grid = make_axes(rows, 3, figsize=(FIGURE_WIDTH_IN, 2.75 * rows + 0.5), squeeze=False)
    panels = list(grid.ravel())
    for panel, (_, axis, points) in zip(panels, axes, strict=False):
        _axis_panel(panel, entries, axis, points)
    rest = iter(panels[len(axes) :])
    if near:
        _gap_panel(next(rest), entries)
    for part in phases:
        _phase_panel(next(rest), entries, part, definition.headline.get(part, part))
    named = panels[0].get_legend_handles_labels()
    if count == len(panels):
        figure.legend(*named, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    else:
        panels[count].legend(*named, loc="center left", fontsize=9, frameon=False)
    for panel in rest:
        panel.set_axis_off()
    return figure


def _axis_panel(panel: Axes, entries: Entries, axis: Mapping[str, Any], points: list[tuple[Any, str]]) -> None:
    named = any(isinstance(value, str) for value, _ in points)
    x = np.arange(len(points)) if named else np.array([value for value, _ in points], float)
    every = [e["parts"][part] for e in entries for _, part in points if part in e["parts"]]
    whole = all(figures["ratio"] is not None or not figures["n"] for figures in every)
    key = "ratio" if whole else "rmse_px"
    nothing = {"ratio": None, "rmse_px": None, "jaccard": None}
    for k, entry in enumerate(entries):
        parts = [entry["parts"].get(part, nothing) for _, part in points]
        y = np.array([np.nan if p[key] is None else p[key] for p in parts], float)
        kept = np.array([(p["jaccard"] or 0.0) >= MIN_FOUND for p in parts])
        panel.plot(x, np.where(kept, y, np.nan), label=label_tracker(entry), **_style(k))
        panel.plot(x[~kept], y[~kept], ls="", marker="x", ms=5, color=COLOURS[k % len(COLOURS)], alpha=0.6)
    if axis.get("log"):
        panel.set_xscale("log")
        panel.set_xticks(x.tolist(), [f"{v:g}" for v, _ in points], minor=False)
        panel.set_xticks([], minor=True)
    if named:
        panel.set_xticks(x.tolist(), [str(v) for v, _ in points], rotation=25, ha="right")
    panel.set_yscale("log")
    if key == "ratio":
        panel.axhline(1.0, **LIMIT_LINE)
    _label_axes(panel, axis["title"], axis["label"], "rmse / bound" if key == "ratio" else "rmse, px")


def _gap_panel(panel: Axes, entries: Entries) -> None:
    for k, entry in enumerate(entries):
        curve = entry["gap"]
        panel.plot([p["gap"] for p in curve], [p["ratio"] for p in curve], label=label_tracker(entry), **_style(k))
    panel.axhline(1.0, **LIMIT_LINE)
    panel.set(xscale="log", yscale="log")
    panel.set_xticks([0.05, 0.1, 0.2, 0.5, 1, 2], ["0.05", "0.1", "0.2", "0.5", "1", "2"])
    panel.set_xticks([], minor=True)
    _label_axes(panel, "Balls about to touch", "gap between them, diameters", "rmse / bound")


def _phase_panel(panel: Axes, entries: Entries, part: str, word: str) -> None:
    for k, entry in enumerate(entries):
        curve = np.array(entry["phase"].get(part) or np.empty((0, 3)), float).reshape(-1, 3)
        panel.plot(curve[:, 0], 1e3 * curve[:, 1], label=label_tracker(entry), **_style(k) | {"ms": 3})
    panel.axhline(0.0, **LIMIT_LINE)
    panel.set_yscale("symlog", linthresh=10.0)
    _label_axes(panel, f"Locking to pixels ({word})", "glint within its pixel, px", "mean error, 0.001 px")


def _label_axes(panel: Axes, title: str, x: str, y: str) -> None:
    panel.set_title(title, fontsize=10)
    panel.set_xlabel(x, fontsize=8)
    panel.set_ylabel(y, fontsize=8)
    panel.tick_params(labelsize=7)


def draw_crowds(entries: Entries, definition: SuiteDefinition) -> Figure:
    """Draw identities, errors, contacts and temperature in crowds against each axis of the suite's crowds."""
    axes = list(definition.crowd_axes())
    measures = {
        "hota": "HOTA",
        "ratio": "rmse / bound",
        "contacts_found": "contacts found",
        "temperature_error": "error of temperature",
    }
    width = FIGURE_WIDTH_IN * max(len(axes), 1) / 2
    figure, grid = make_axes(
        len(measures), max(len(axes), 1), figsize=(width, 2.1 * len(measures) + 0.5), sharex="col", squeeze=False
    )
    for column, (axis, points) in zip(grid.T, axes, strict=False):
        x = [value for value, _ in points]
        for panel, (key, word) in zip(column, measures.items(), strict=True):
            for k, entry in enumerate(entries):
                found = [(entry.get("crowds", {}).get(part) or {}).get(key) for _, part in points]
                y = np.array([np.nan if value is None else value for value in found], float)
                panel.plot(x, y, label=label_tracker(entry), **_style(k))
            if low := {"ratio": 0.8, "temperature_error": 0.005}.get(key):
                panel.set_yscale("log")
                panel.yaxis.set_major_formatter("{x:g}")
                panel.yaxis.set_minor_formatter(NullFormatter())
                panel.set_ylim(low, max(15.0 * low, panel.get_ylim()[1]))
            else:
                panel.set_ylim(-0.03, 1.05)
            if key == "ratio":
                panel.axhline(1.0, **LIMIT_LINE)
            _label_axes(panel, axis["title"] if key == "hota" else "", "", word)
        column[-1].set_xlabel(axis["label"], fontsize=8)
    named = grid[0, 0].get_legend_handles_labels()
    figure.legend(*named, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure


def draw_published_quantities(entries: Entries, part: str, names: Sequence[str]) -> Figure:
    """Draw a table with a row for each tracker and a column for each quantity: error ± published error bar."""

    def cell_of(entry: Entry, name: str) -> tuple[str, Any, str]:
        return *make_publication_cell(entry["quantities"].get(part, {}), name), "black"

    figure, axes = _draw_cells(entries, names, cell_of, (0.95, 0.75), 0.79)
    axes.set(xlim=(-0.5, len(names) - 0.5))
    heads = [f"{QUANTITIES[name].formula} / {QUANTITIES[name].error_unit}" for name in names]
    axes.set_xticks(range(len(names)), heads, fontsize=9)
    return figure


def make_publication_cell(found: Mapping[str, Any], name: str) -> tuple[str, Any]:
    """Text and colour: green within 2 error bars, yellow, red from 4 on; grey where nothing is published."""
    figures = found.get(name) or {}
    off, std = figures.get("published"), figures.get("published_std")
    if off is None or std is None:
        return f"none of {found['clips']}" if found.get("clips") else "not run", "#c9c9c9"
    factor, z = QUANTITIES[name].error_factor, abs(off) / std
    colour = "#a6d96a" if z < 2 else "#ffe08a" if z < 4 else "#f08a5d"
    return f"{_plain(off * factor, '+')} ± {_plain(std * factor)}", colour


def _plain(value: float, sign: str = "") -> str:
    """Two digits, or whole numbers from 100 on."""
    return f"{value:{sign}.0f}" if abs(value) >= 100 else f"{value:{sign}.2g}"


def draw_defects(entries: Entries, names: Sequence[str], kind: str) -> Figure | None:
    """Draw the shift of each quantity by each defect, in error bars of one collision; None without any defect."""
    kept = [e for e in entries if e["defects"]]
    if not kept:
        return None
    figure, panels = make_axes(
        1, len(names), figsize=(FIGURE_WIDTH_IN, 0.36 * len(kept) + 1.1), sharey=True, squeeze=False
    )
    panels = panels[0]
    colours = dict(zip(DEFECTS, ("#14508c", "#c1440e", "#777777"), strict=True))
    for panel, name in zip(panels, names, strict=True):
        for j, (defect, word) in enumerate(DEFECTS.items()):
            known = [(e["defects"][defect].get(f"{name}{kind}") or {}).get("in_errors") for e in kept]
            values = np.array([0.0 if value is None else value for value in known])
            places = np.arange(len(kept)) + 0.26 * (j - 1)
            panel.barh(places, np.maximum(values, 1e-3), 0.24, left=0.0, color=colours[defect], label=word)
            for place, value in zip(places, known, strict=True):
                if value is None:  # with this defect no collision gives the quantity
                    panel.text(0.0115, place, "no result", color=colours[defect], fontsize=7, va="center_baseline")
        panel.set_xscale("log")
        panel.set_xlim(0.01, max(1.5, 1.3 * panel.get_xlim()[1]))
        panel.set_xticks([], minor=True)  # over less than a decade their labels would overlap
        panel.axvline(1.0, **LIMIT_LINE)
        panel.set_title(QUANTITIES[name].formula, fontsize=10)
        panel.set_xlabel("shift, error bars of one collision", fontsize=8)
        panel.tick_params(labelsize=8)
    panels[0].set_yticks(range(len(kept)), [label_tracker(e) for e in kept], fontsize=9)
    panels[0].invert_yaxis()
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8, frameon=False
    )
    return figure
