"""The report of a plan: plan.json and a self-contained index.html."""

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
from discrepancy.planning.limits import Limit
from discrepancy.planning.plan_result import PlanResult
from discrepancy.policy import current_policy
from discrepancy.report.figures import AFTER, BEFORE, FLOOR, OTHER, STYLE, inline
from discrepancy.report.html import plain
from synthcam_shared.report.page import render

RIVALS = 3  # of each strength, in plan.json
TICKS = (0.1, 0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 3, 5, 10)  # of a ratio


def document(found: PlanResult) -> dict[str, Any]:
    """The keys of plan.json, plain; None for what is not finite."""
    rows = [
        row | {"rivals": [dataclasses.asdict(r) for r in x.rivals[:RIVALS]]}
        for row, x in zip(found.rows(), (*found.shown, *found.hidden), strict=True)
    ]
    whole: dict[str, Any] = plain(
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


def write(found: PlanResult, folder: Path) -> None:
    """Write the report's two files into a folder, made if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "plan.json").write_text(json.dumps(document(found), indent=1, allow_nan=False) + "\n")
    page = render(
        Path(__file__).with_name("plan.html"),
        found=found,
        experiment=found.experiment(),
        figures=_drawn(found),
        sigma=current_policy().detection_limit_sigma,
        alias=current_policy().alias_cosine,
        finite=np.isfinite,
        unit=lambda x: "" if x.unit == "1" else x.unit,
        shapes=_shapes,
        short=_short,
        made="discrepancy plan",
    )
    (folder / "index.html").write_text(page, encoding="utf-8")


def _short(words: str) -> str:
    """What was changed, for a narrow place."""
    return "all launches at once" if words == ALL_LAUNCHES_CHANGED else words


def _shapes(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name.rpartition('.')[2]} {value:.3g}" for name, value in values.items())


def _drawn(found: PlanResult) -> list[dict[str, str]]:
    """title, note and address of each figure."""
    with mpl.rc_context(STYLE):
        out = []
        if found.shown:
            note = (
                "Over the realistic size of each strength: a limit left of the dashed line is one under a "
                "realistic size. Thin lines: over all shape parameters that a search tries."
            )
            out.append(inline("Limits", _limits(found.shown), note))
        if found.gains:
            note = (
                "How many times smaller the limits become: geometric mean over all strengths that show with and "
                "without the change."
            )
            out.append(inline("What changes would gain", _changes(found), note))
    return out


def _limits(shown: tuple[Limit, ...]) -> Figure:
    figure = Figure(figsize=(8, 1.1 + 0.21 * len(shown)), layout="constrained")
    ax, place = figure.subplots(), np.arange(len(shown))
    sizes = np.array([x.typical for x in shown])
    limit, naming, best, worst = (
        np.array([getattr(x, key) for x in shown]) / sizes for key in ("limit", "naming_limit", "best", "worst")
    )
    told = np.isfinite(naming)
    ax.hlines(place, best, worst, color=OTHER, lw=1)
    ax.plot(limit, place, "o", ms=5, color=AFTER, label="detection limit")
    ax.plot(naming[told], place[told], "D", ms=4, mfc="none", color=BEFORE, label="naming limit")
    ax.axvline(1, color=FLOOR, ls="--", lw=1)
    ax.set_xscale("log")
    ax.set_yticks(place, [x.strength for x in shown])
    ax.set(ylim=(len(shown) - 0.5, -0.5), xlabel="strength over its realistic size")
    ax.grid(axis="x", color="#e3e3e3", lw=0.5)
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def _changes(found: PlanResult) -> Figure:
    figure = Figure(figsize=(8, 1.1 + 0.28 * len(found.gains)), layout="constrained")
    ax, place = figure.subplots(), np.arange(len(found.gains))
    for k, (key, label, colour) in enumerate((("limit", "detection", AFTER), ("naming", "naming", BEFORE))):
        values = [getattr(g, key) - 1 for g in found.gains]
        ax.barh(place + 0.38 * (k - 0.5), values, 0.36, left=1, color=colour, label=f"{label} limits")
    ax.axvline(1, color=FLOOR, lw=1)
    ax.set_xscale("log")
    ends = [t for g in found.gains for t in (g.limit, g.naming)]
    ticks = [t for t in TICKS if min(ends) / 1.1 < t < max(ends) * 1.1]
    ax.set_xticks(ticks, [f"{t:g}" for t in ticks])
    ax.set_xticks([], minor=True)
    ax.grid(axis="x", color="#e3e3e3", lw=0.5)
    ax.set_axisbelow(True)
    ax.set_yticks(place, [_short(g.words) for g in found.gains])
    ax.set(ylim=(len(found.gains) - 0.5, -0.5), xlabel="limit now over limit with the change (more is better)")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure
