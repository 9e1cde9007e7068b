"""REPORT of a plan: plan.json and a self-contained index.html."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from discrepancy.planning.changes import ALL_LAUNCHES_CHANGED
from discrepancy.planning.limits import StrengthLimits
from discrepancy.planning.plan_result import PlanResult
from discrepancy.policy import current_policy
from discrepancy.report.figures import COLOURS, STYLE
from synthcam_shared.json_values import replace_non_finite
from synthcam_shared.report.page import Block, PageFigure, PageSection, PageTable, make_axes, write_page

FILES = ("plan.json", "index.html")


def make_plan_document(found: PlanResult) -> dict[str, Any]:
    """Return the contents of plan.json: plain values, None for what is not finite."""
    rows = [
        row | {"rivals": [dataclasses.asdict(r) for r in x.rivals[:3]]}
        for row, x in zip(found.rows(), (*found.detectable, *found.undetectable), strict=True)
    ]
    whole: dict[str, Any] = replace_non_finite(
        found.experiment()
        | {
            "sentence": found.sentence(),
            "effects": rows,
            "pairs": [dataclasses.asdict(p) for p in found.pairs],
            "changes": [dataclasses.asdict(g) for g in found.gains],
            "wanted": [dataclasses.asdict(w) for w in found.wanted],
        }
    )
    return whole


def write_plan(found: PlanResult, folder: Path) -> None:
    """Write plan.json and index.html into a folder, which is made where it is missing."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "plan.json").write_text(json.dumps(make_plan_document(found), indent=1, allow_nan=False) + "\n")
    about = found.experiment()
    sections = [
        PageSection("Experiment", [_describe_experiment(about)]),
        *(PageSection(figure.title, [figure]) for figure in _draw_figures(found)),
        PageSection("Number of collisions needed", [_wanted_table(found)] if found.wanted else []),
        PageSection("Limits of each effect", _limit_blocks(found)),
        PageSection("Effects that the experiment cannot distinguish", [_pair_table(found)]),
        PageSection("Changes of the experiment", [_change_table(found)]),
    ]
    title = f"Detectable effects: {about['clips']['recorded']} collisions of {found.name}"
    write_page(folder / "index.html", title, sections, "discrepancy plan", [found.sentence()], about["notes"])


def _describe_experiment(about: Mapping[str, Any]) -> str:
    clips = about["clips"]
    return (
        f"{clips['usable']} of {clips['recorded']} collisions have enough positions in view. A search fits "
        f"{clips['fitted']} of them and holds the others out. Speeds from {about['v0'][0]:.2g} to {about['v0'][1]:.2g} "
        f"m/s, |b| up to {about['b']:.2f}, {about['fps']:g} frames per second, exposures of "
        f"{1e3 * about['exposure']:.3g} ms, {1e6 * about['scale']:.4g} µm per pixel. Shared parameters that are fitted "
        f"with the launches: {', '.join(about['fitted']) or 'none'}."
    )


def _wanted_table(found: PlanResult) -> PageTable:
    rows = []
    for w in found.wanted:
        counts = ["none suffices" if n is None else str(n) for n in (w.clips, w.clips_to_name)]
        simulated = ", ".join(f"{n}: {limit:.3g}" for n, limit in w.at.items())
        rows.append((w.strength, f"{w.limit:.3g}", *counts, simulated))
    heads = ["strength", "wanted limit", "collisions to detect it", "collisions to name it"]
    heads += ["limits that were simulated"]
    return PageTable(heads, rows)


def _limit_blocks(found: PlanResult) -> list[Block]:
    heads = ["strength", "unit", "realistic", "detection limit", "draws / %", "naming limit", "most similar effect"]
    heads += ["cosine", "change that lowers the naming limit most", "naming limit with it"]
    rows = []
    for x in found.detectable:
        best = found.best_change(x)
        shapes = ", ".join(f"{name.rpartition('.')[2]} {value:.3g}" for name, value in x.shapes.items())
        spread = [f"{100 * (scatter / x.limit - 1):+.0f}" for scatter in x.scatter]
        rival = [x.rivals[0].effect, f"{x.rivals[0].cosine:.3f}"] if x.rivals else ["", ""]
        change = [_shorten(best.words), f"{best.naming_limit:.3g}"] if best else ["", ""]
        name = f"{x.strength} ({shapes})" if shapes else x.strength
        naming = f"{x.naming_limit:.3g}" if np.isfinite(x.naming_limit) else "none"
        limits = [f"{x.typical:.3g}", f"{x.limit:.3g}", " to ".join(spread), naming]
        rows.append([name, _unit(x), *limits, *rival, *change])
    note = (
        "Detection limit: strength that half of such experiments show at more than "
        f"{current_policy().detection_limit_sigma:g} sigma. Naming limit: strength that differs by as much from the "
        "best fit of the most similar effect. Limits hold for the given shape parameters; they are medians over "
        "several draws of the scene."
    )
    blocks: list[Block] = [PageTable(heads, rows, note=note)]
    if found.undetectable:
        hidden = ", ".join(
            f"{x.strength} ({f'limit {x.limit:.2g} {_unit(x)}'.rstrip() if np.isfinite(x.limit) else absorbed})"
            for absorbed in ["the fit or an unknown of the camera file absorbs it"]
            for x in found.undetectable
        )
        blocks.append(f"Not detectable at any realistic strength: {hidden}.")
    return blocks


def _pair_table(found: PlanResult) -> Block:
    limit = current_policy().alias_cosine
    if not found.pairs:
        return f"None: no cosine of two signatures exceeds {limit:g}."
    rows = [(", ".join(p.effects), f"{p.cosine:.3f}", p.advice) for p in found.pairs]
    note = (
        "Cosine of the two signatures when launches and shared parameters are fitted. Above "
        f"{limit:g} a search reports both effects as candidates."
    )
    return PageTable(["effects", "cosine", "experiment that distinguishes them"], rows, note=note)


def _change_table(found: PlanResult) -> PageTable:
    heads = ["change", "detection limits fall by a factor", "naming limits fall by a factor"]
    heads += ["effects that it distinguishes", "effects that it makes similar"]
    rows = []
    for g in found.gains:
        parts, joins = (", ".join(" and ".join(pair) for pair in pairs) for pairs in (g.parts, g.joins))
        rows.append((g.words, f"{g.limit:.2f}", f"{g.naming:.2f}", parts, joins))
    note = (
        "The best first. “All launches at once”: exchanged balls, oblique hits, many speeds and headings, all over the "
        "picture. Only possible changes are tried: no exposure longer than the time between frames, and no plate so "
        "steep that a resting ball rolls."
    )
    return PageTable(heads, rows, note=note)


def _unit(limit: StrengthLimits) -> str:
    return "" if limit.unit == "1" else limit.unit


def _shorten(words: str) -> str:
    """Name a change in few words."""
    return "all launches at once" if words == ALL_LAUNCHES_CHANGED else words


@mpl.rc_context(STYLE)
def _draw_figures(found: PlanResult) -> list[PageFigure]:
    figures = []
    if found.detectable:
        caption = (
            "Limits over the realistic size of each strength. Left of the dashed line, a limit is below a realistic "
            "size. Thin lines: range over the shape parameters that a search tries."
        )
        figures.append(PageFigure.of(_limits_figure(found.detectable), "Detection and naming limits", caption))
    if found.gains:
        caption = (
            "Factor by which the limits fall: geometric mean over all strengths that are detectable with and without "
            "the change."
        )
        figures.append(PageFigure.of(_changes_figure(found), "Gain of each change", caption))
    return figures


def _limits_figure(shown: tuple[StrengthLimits, ...]) -> Figure:
    figure, ax = make_axes(figsize=(8, 1.1 + 0.21 * len(shown)))
    place = np.arange(len(shown))
    sizes = np.array([x.typical for x in shown])
    limit, naming, best, worst = (
        np.array([getattr(x, key) for x in shown]) / sizes for key in ("limit", "naming_limit", "best", "worst")
    )
    finite = np.isfinite(naming)
    ax.hlines(place, best, worst, color=COLOURS["other"], lw=1)
    ax.plot(limit, place, "o", ms=5, color=COLOURS["best"], label="detection limit")
    ax.plot(naming[finite], place[finite], "D", ms=4, mfc="none", color=COLOURS["base"], label="naming limit")
    ax.axvline(1, color=COLOURS["noise"], ls="--", lw=1)
    ax.set_xscale("log")
    ax.set_yticks(place, [x.strength for x in shown])
    ax.set(ylim=(len(shown) - 0.5, -0.5), xlabel="strength over its realistic size")
    ax.grid(axis="x", color="#e3e3e3", lw=0.5)
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def _changes_figure(found: PlanResult) -> Figure:
    figure, ax = make_axes(figsize=(8, 1.1 + 0.28 * len(found.gains)))
    place = np.arange(len(found.gains))
    for k, (key, label, colour) in enumerate(
        (("limit", "detection", COLOURS["best"]), ("naming", "naming", COLOURS["base"]))
    ):
        values = [getattr(g, key) - 1 for g in found.gains]
        ax.barh(place + 0.38 * (k - 0.5), values, 0.36, left=1, color=colour, label=f"{label} limits")
    ax.axvline(1, color=COLOURS["noise"], lw=1)
    ax.set_xscale("log")
    ends = [t for g in found.gains for t in (g.limit, g.naming)]
    ticks = [t for t in (0.1, 0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 3, 5, 10) if min(ends) / 1.1 < t < max(ends) * 1.1]
    ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
    ax.set_xticks([], minor=True)
    ax.grid(axis="x", color="#e3e3e3", lw=0.5)
    ax.set_axisbelow(True)
    ax.set_yticks(place, [_shorten(g.words) for g in found.gains])
    ax.set(ylim=(len(found.gains) - 0.5, -0.5), xlabel="limit now over limit with the change (larger is better)")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure
